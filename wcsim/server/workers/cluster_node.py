"""What a node of a cluster does with a piece of work, in a process of Ray: fetch files, work, answer.

Files travel as one compressed piece of bytes, known by the hash of what is in it, and become files again.
"""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import signal
import stat
import sys
import tempfile
import time
import traceback
import zipfile
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final

import zstandard

from wcsim.core.files import alone
from wcsim.core.reading import escaped, unzstd
from wcsim.errors import ConfigError, WcsimError
from wcsim.server.workers.machines import find_in_work, work_folder
from wcsim.server.workers.worker_api import Call, Parcel
from wcsim.towns.cache.folder import cache_folder

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


def _unpack(data: bytes, folder: Path) -> None:
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


def _kept_folder(cache: Path, digest: str, name: str) -> Path:
    """Where a parcel with that hash is kept; its folder has the name that it had, as a town may be called by it.

    The name is in the hash: towns that differ in it alone are kept beside each other.
    """
    return cache / _PARCELS / digest / _name_of(name)


def _name_of(name: str) -> str:
    return name or "folder"  # the root has none


def _is_kept(folder: Path, digest: str) -> bool:
    """Whether a folder holds what the hash says, and nothing else."""
    names = tuple(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return folder.is_dir() and digest_of(folder, names) == digest


def _keep(data: bytes, folder: Path) -> None:
    """Put a parcel where it is kept, whole or not at all, whoever else does the same. Raises OSError."""
    home = folder.parent
    home.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(dir=home.parent, prefix=".begun-"))
    try:
        place = beside / folder.name
        place.mkdir()
        _unpack(data, place)
        for old in (home,) if home.exists() else ():  # it was changed by somebody, or cut short
            shutil.rmtree(old)
        beside.replace(home)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


Fetch = Callable[[Any], bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class SentParcel:
    """A parcel on its way; what is in it is fetched only by a node that does not have it."""

    address: str
    digest: str
    name: str  # of its folder
    inner: str
    kept: bool
    ref: tuple[Any, ...]  # the object of Ray's that holds it; in a tuple, so that Ray does not fetch it unasked


@dataclass(frozen=True, slots=True, kw_only=True)
class SentWork:
    """A piece of work on its way."""

    run: str  # whose it is: a word that no other run has
    key: str
    attempt: str  # a word of its own each time that the piece is given out
    call: Call
    piece: Any
    parcels: tuple[SentParcel, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What came of it: `data`, or an `error` that is final, or `lost`: another machine may do better."""

    data: bytes = b""
    error: WcsimError | None = None
    fault: str = ""  # an error that nobody had reckoned with
    lost: str = ""
    pid: int = 0
    fetched_bytes: int = 0
    fetch_s: float = 0.0
    work_s: float = 0.0


def do_work(sent: SentWork, fetch: Fetch | None = None) -> Reply:
    """Do a piece of work in this process, which Ray has started; `fetch` stands in for Ray's store."""
    _say(f"{sent.key} starts")
    with ExitStack() as leaving:
        began_s = time.monotonic()
        try:
            own = leaving.enter_context(work_folder())
            (own / _pid_name(sent.run, sent.key, sent.attempt)).write_text(str(os.getpid()), encoding="utf-8")
            places, fetched = _received(sent.parcels, fetch or _from_ray, own)
            fetch_s = time.monotonic() - began_s
            data = sent.call(sent.piece, lambda address: places.get(address, address))
        except WcsimError as error:
            _say(f"{sent.key} failed: {error}")
            return Reply(error=error, pid=os.getpid())
        except (OSError, MemoryError) as error:
            _say(f"{sent.key} is lost: {error}")
            return Reply(lost=f"{type(error).__name__}: {error}", pid=os.getpid())
        except Exception as error:
            _say(f"{sent.key} failed: {traceback.format_exc()}")
            return Reply(fault=f"{type(error).__name__}: {error}", pid=os.getpid())
        work_s = time.monotonic() - began_s - fetch_s
        _say(f"{sent.key} is done, {len(data)} bytes after {work_s:.1f} s")
        return Reply(data=data, pid=os.getpid(), fetched_bytes=fetched, fetch_s=fetch_s, work_s=work_s)


def kill_worker(run: str, key: str, attempt: str) -> bool:
    """Kill the process of this machine that is at a piece, even one that was stopped. Whether there was one."""
    with suppress(OSError, ValueError):
        found = find_in_work(_pid_name(run, key, attempt))
        pid = 0 if found is None else int(found.read_text(encoding="utf-8"))
        if pid and b"ray::" in Path(f"/proc/{pid}/cmdline").read_bytes():  # its number may be somebody else's by now
            os.kill(pid, signal.SIGKILL)
            return True
    return False


def _received(parcels: tuple[SentParcel, ...], fetch: Fetch, own: Path) -> tuple[dict[str, str], int]:
    """Where each parcel lies here, in a folder of this piece's own unless it is kept; how many bytes came for them."""
    places, fetched = {}, 0
    for number, parcel in enumerate(parcels):
        if parcel.kept:
            folder = _kept_folder(cache_folder(), parcel.digest, parcel.name)
            with alone(folder.parents[1] / f"{folder.parent.name}.lock"):  # a town comes once to a machine
                if not _is_kept(folder, parcel.digest):
                    data = fetch(parcel.ref[0])
                    fetched += len(data)
                    _keep(data, folder)
        else:
            folder = own / f"parcel-{number}" / (parcel.name or "folder")
            folder.mkdir(parents=True)
            data = fetch(parcel.ref[0])
            fetched += len(data)
            _unpack(data, folder)
        places[parcel.address] = str(folder / parcel.inner) if parcel.inner else str(folder)
    return places, fetched


def _from_ray(ref: Any) -> bytes:
    import ray

    data: bytes = ray.get(ref)
    return data


def _pid_name(run: str, key: str, attempt: str) -> str:
    return f"{run}-{hashlib.sha256(key.encode()).hexdigest()[:16]}-{attempt}.pid"  # a key may be a long path


def _say(text: str) -> None:
    """Into Ray's log of this worker, where a key finds it."""
    sys.stderr.write(f"wcsim: {text}\n")
    sys.stderr.flush()
