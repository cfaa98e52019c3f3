"""Files as one compressed piece of bytes that is known by the hash of what is in it, and back."""

from __future__ import annotations

import hashlib
import io
import shutil
import stat
import tempfile
import zipfile
from pathlib import Path, PurePosixPath
from typing import Final

import zstandard

from wcsim.core.reading import escaped, unzstd
from wcsim.errors import ConfigError
from wcsim.server.workers.worker_api import Parcel

MOST_BYTES: Final = 512 << 20
_LEVEL: Final = 3
_PARCELS: Final = "parcels"


def digest_of(folder: Path, names: tuple[str, ...]) -> str:
    """SHA-256 (hex) over a folder's name, and the names and the bytes of files in it. Raises OSError."""
    text = hashlib.sha256(f"{_name_of(folder.name)}\n".encode())
    for name in sorted(names):
        with (folder / name).open("rb") as file:
            text.update(f"{name} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return text.hexdigest()


def packed(parcel: Parcel) -> bytes:
    """The files of a parcel. Raises ConfigError when they are too many bytes to be sent."""
    size = sum((parcel.folder / name).stat().st_size for name in parcel.names)
    if size > MOST_BYTES:
        raise ConfigError(
            f"{escaped(parcel.folder)} has {size >> 20} MiB; expected at most {MOST_BYTES >> 20} MiB, as it travels to "
            "other machines: drive it without --cluster"
        )
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as held:
        for name in sorted(parcel.names):
            held.writestr(zipfile.ZipInfo(name), (parcel.folder / name).read_bytes())
    return zstandard.ZstdCompressor(level=_LEVEL).compress(out.getvalue())


def unpack(data: bytes, folder: Path) -> None:
    """Write files into a folder that is there, which may hold folders.

    Raises ValueError for a name that leads elsewhere, a link, or too many bytes.
    """
    plain = unzstd(data, 2 * MOST_BYTES)
    with zipfile.ZipFile(io.BytesIO(plain)) as held:
        for file in held.infolist():
            path = PurePosixPath(file.filename)
            if path.is_absolute() or ".." in path.parts:
                raise ValueError(f"{file.filename!r} points outside its folder")
            if stat.S_ISLNK(file.external_attr >> 16):  # the mode of a file, as Unix packs it
                raise ValueError(f"{file.filename!r} is a link; expected files only")
            place = folder / path
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(held.read(file))


def kept_folder(cache: Path, digest: str, name: str) -> Path:
    """Where a parcel with that hash is kept; its folder has the name that it had, as a town may be called by it.

    The name is in the hash: towns that differ in it alone are kept beside each other.
    """
    return cache / _PARCELS / digest / _name_of(name)


def _name_of(name: str) -> str:
    return name or "folder"  # the root has none


def is_kept(folder: Path, digest: str) -> bool:
    """Whether a folder holds what the hash says, and nothing else."""
    names = tuple(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return folder.is_dir() and digest_of(folder, names) == digest


def keep(data: bytes, folder: Path) -> None:
    """Put a parcel where it is kept, whole or not at all, whoever else does the same. Raises OSError."""
    home = folder.parent
    home.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(dir=home.parent, prefix=".begun-"))
    try:
        place = beside / folder.name
        place.mkdir()
        unpack(data, place)
        for old in (home,) if home.exists() else ():  # it was changed by somebody, or cut short
            shutil.rmtree(old)
        beside.replace(home)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
