"""What a node of a cluster does with a piece of work, in a process of Ray: fetch files, work, answer.

Files travel as one compressed piece of bytes, known by the hash of what is in it, and become files again.
"""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import sys
import tempfile
import time
import traceback
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import zstandard

from wcsim.core.files import alone
from wcsim.core.reading import escaped, unzstd
from wcsim.errors import ConfigError, DiskFullError, WcsimError, WorkersError
from wcsim.server.workers.machines import Parcel, Work, WorkEnd, work_folder
from wcsim.towns.cache.folder import cache_folder

MOST_BYTES: Final = 512 << 20
_LEVEL: Final = 3
_PARCELS: Final = "parcels"


def digest_of(folder: Path, names: tuple[str, ...]) -> str:
    """SHA-256 (hex) over a folder's name, and the names and the bytes of files in it. Raises OSError."""
    text = hashlib.sha256(f"{_name_of(folder)}\n".encode())
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
    """Write files below a folder that is there. Raises ValueError for too many bytes."""
    with zipfile.ZipFile(io.BytesIO(unzstd(data, 2 * MOST_BYTES))) as held:
        held.extractall(folder)  # it lets no name lead elsewhere, and makes no links


def _name_of(folder: Path) -> str:
    """What a folder is called wherever it travels to, as a town may be called by it."""
    return folder.name or "folder"  # the root has none


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
        if home.exists():  # it was changed by somebody, or cut short
            shutil.rmtree(home)
        beside.replace(home)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


Fetch = Callable[[Any], bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class SentParcel:
    """A parcel on its way; what is in it is fetched only by a node that does not have it."""

    parcel: Parcel
    digest: str
    ref: tuple[Any, ...]  # the object of Ray's that holds it; in a tuple, so that Ray does not fetch it unasked


def do_work(worker: str, work: Work, parcels: tuple[SentParcel, ...], fetch: Fetch | None = None) -> WorkEnd:
    """Do a piece of work in this process, which Ray has started; `fetch` stands in for Ray's store.

    Where it is lost, another machine may do better.
    """
    key = work.key
    end = partial(WorkEnd, worker=worker, key=key, facts={"pid": os.getpid()})
    _say(f"{key} starts")
    with ExitStack() as leaving:
        began_s = time.monotonic()
        try:
            places, fetched = _received(parcels, fetch or _from_ray, leaving.enter_context(work_folder()))
            fetch_s = time.monotonic() - began_s
            data = work.call(work.piece, lambda address: places.get(address, address))
        except (OSError, MemoryError, DiskFullError) as error:  # of this machine: another one may have room
            _say(f"{key} is lost: {error}")
            return end(lost=f"{type(error).__name__}: {error}")
        except WcsimError as error:
            _say(f"{key} failed: {error}")
            return end(error=error)
        except Exception as error:
            _say(f"{key} failed: {traceback.format_exc()}")
            told = f"{type(error).__name__}: {error}"[:300]
            return end(error=WorkersError(f"{key} failed on {worker}: {told}; see Ray's log on that machine"))
        work_s = time.monotonic() - began_s - fetch_s
        _say(f"{key} is done, {len(data)} bytes after {work_s:.1f} s")
        took = {"fetch_s": round(fetch_s, 3), "work_s": round(work_s, 3)}
        return end(data=data, facts={"pid": os.getpid(), "bytes": len(data), "fetched_bytes": fetched, **took})


def _received(parcels: tuple[SentParcel, ...], fetch: Fetch, own: Path) -> tuple[dict[str, str], int]:
    """Where each parcel lies here, in a folder of this piece's own unless it is kept; how many bytes came for them."""
    places, fetched = {}, 0
    for number, sent in enumerate(parcels):
        parcel, name = sent.parcel, _name_of(sent.parcel.folder)
        if parcel.kept:
            home = cache_folder() / _PARCELS / sent.digest
            folder = home / name  # towns that differ in their name alone are kept beside each other: it is in the hash
            with alone(home.with_name(f"{home.name}.lock")):  # a town comes once to a machine
                if not _is_kept(folder, sent.digest):
                    data = fetch(sent.ref[0])
                    fetched += len(data)
                    _keep(data, folder)
        else:
            folder = own / f"parcel-{number}" / name
            folder.mkdir(parents=True)
            data = fetch(sent.ref[0])
            fetched += len(data)
            _unpack(data, folder)
        places[parcel.address] = str(folder / parcel.inner) if parcel.inner else str(folder)
    return places, fetched


def _from_ray(ref: Any) -> bytes:
    import ray

    data: bytes = ray.get(ref)
    return data


def _say(text: str) -> None:
    """Into Ray's log of this worker, where a key finds it."""
    sys.stderr.write(f"wcsim: {text}\n")
    sys.stderr.flush()
