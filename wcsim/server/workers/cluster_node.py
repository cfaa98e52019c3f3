"""What a node of a cluster does, in a process of Ray: say what it is, take in files, work, answer.

Files travel by their names below a folder, each compressed, and become files again in the folder of a piece.
"""

from __future__ import annotations

import os
import platform
import shutil
import socket
import sys
import time
import traceback
from collections.abc import Mapping
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Final

import zstandard

from wcsim.core.own_folder import temporary_folder
from wcsim.core.reading import escaped, unzstd
from wcsim.core.sources import code_digest, version_of
from wcsim.errors import ConfigError, DiskFullError, WcsimError, WorkersError
from wcsim.server.workers.machines import Parcel, Work, WorkEnd

MOST_BYTES: Final = 512 << 20  # of the files of a parcel, and of what comes back
_MOST_FILES: Final = 10_000
_LEVEL: Final = 3
_PACKAGES: Final = (
    *(
        "wcsim",
        "libsumo",
        "eclipse-sumo",
        "pybullet",
        "torch",
        "numpy",
        "numba",
        "opencv-python-headless",
    ),
    *("shapely", "networkx", "zstandard", "gymnasium", "onnxruntime"),
)
_LEAST_SHM_MIB: Final = 256
_SHM: Final = Path("/dev/shm")  # noqa: S108 - it is only looked at


def facts_here() -> dict[str, str]:
    """What this machine has: versions by package and "Python", "code" of wcsim, "host", "cpu", "shm_mib"."""
    return {
        **{
            name: version_of(name).partition("+")[0] for name in _PACKAGES
        },  # torch 2.13.0+cpu is 2.13.0
        "Python": ".".join(platform.python_version_tuple()[:2]),
        "code": code_digest(),
        "host": socket.gethostname(),
        "cpu": _cpu(),
        "shm_mib": str(shutil.disk_usage(_SHM).total >> 20 if os.path.isdir(_SHM) else 0),  # noqa: PTH112
    }


def why_refused(node: Mapping[str, str], here: Mapping[str, str]) -> str:
    """What a node has other than this machine and must not, "" for nothing."""
    found = node.get("wcsim"), node.get("code", "")
    if found != (here["wcsim"], here["code"]):
        return (
            f"it has wcsim {found[0]}, code {found[1][:12]}; expected wcsim {here['wcsim']}, code "
            f"{here['code'][:12]}, as here: install the same there, then `ray stop` and `ray start` it again"
        )
    asked = (*_PACKAGES, "Python")
    other = [
        f"{name} {node[name] or 'none'} (here {here[name] or 'none'})"
        for name in asked
        if node[name] != here[name]
    ]
    if other:
        return f"it has {', '.join(other)}; expected the same as here: install from the same constraints.txt"
    return ""


def notes_on(node: Mapping[str, str], here: Mapping[str, str]) -> tuple[str, ...]:
    """What is worth a line, and no reason to refuse a node."""
    notes = []
    if int(node["shm_mib"]) < _LEAST_SHM_MIB:
        notes.append(
            f"{_SHM} has {node['shm_mib']} MiB; expected {_LEAST_SHM_MIB}: Ray then stores its objects on "
            "disk, which is slower; start the container with --shm-size=1g"
        )
    if node["cpu"] != here["cpu"]:
        notes.append(
            f"its processor is different ({node['cpu']}; here {here['cpu']}): the last bits of its data may differ"
        )
    return tuple(notes)


def _cpu() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def packed(parcel: Parcel) -> dict[str, bytes]:
    """The files of a parcel by name, each a zstd frame. Raises ConfigError for too many or too large ones, OSError."""
    size = sum((parcel.folder / name).stat().st_size for name in parcel.names)
    if size > MOST_BYTES or len(parcel.names) > _MOST_FILES:
        raise ConfigError(
            f"{escaped(parcel.folder)} has {len(parcel.names)} files of {size >> 20} MiB; expected at most "
            f"{_MOST_FILES} of {MOST_BYTES >> 20} MiB, as they travel to other machines: drive it without --cluster"
        )
    compressor = zstandard.ZstdCompressor(level=_LEVEL)
    return {name: compressor.compress((parcel.folder / name).read_bytes()) for name in parcel.names}


def _unpack(files: Mapping[str, bytes], folder: Path) -> None:
    """Write files below a folder. Raises ValueError for names that lead elsewhere, or too many bytes or files."""
    if len(files) > _MOST_FILES:
        raise ValueError(f"{len(files)} files; expected at most {_MOST_FILES}")
    folder.mkdir(parents=True, exist_ok=True)
    left = MOST_BYTES
    for name, content in files.items():
        place = PurePosixPath(name)
        if place.is_absolute() or ".." in place.parts:
            raise ValueError(
                f"a file is called {escaped(name, 80)!r}; expected a name below its folder"
            )
        data = unzstd(content, left)
        left -= len(data)
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_bytes(data)


def do_work(
    worker: str, work: Work, parcels: tuple[Parcel, ...], *contents: Mapping[str, bytes]
) -> WorkEnd:
    """Do a piece of work in this process, which Ray has started; `contents` are those of the parcels, from Ray's store.

    Where it is lost, another machine may do better.
    """
    key, began_s = work.key, time.monotonic()
    end = partial(WorkEnd, worker=worker, key=key, facts={"pid": os.getpid()})
    try:
        with temporary_folder() as own:
            places = {}
            for number, (parcel, files) in enumerate(zip(parcels, contents, strict=True)):
                folder = (
                    own / f"parcel-{number}" / (parcel.folder.name or "folder")
                )  # as a town may be called by it
                _unpack(files, folder)
                places[parcel.address] = str(folder / parcel.inner)
            data = work.call(work.piece, lambda address: places.get(address, address))
        took = {"bytes": len(data), "work_s": round(time.monotonic() - began_s, 3)}
        return end(data=data, facts={"pid": os.getpid(), **took})
    except (
        OSError,
        MemoryError,
        DiskFullError,
    ) as error:  # of this machine: another one may have room
        return end(lost=f"{type(error).__name__}: {error}")
    except WcsimError as error:
        return end(error=error)
    except Exception as error:
        sys.stderr.write(
            f"wcsim: {key} failed: {traceback.format_exc()}\n"
        )  # into Ray's log of this process
        told = f"{type(error).__name__}: {error}"[:300]
        return end(
            error=WorkersError(f"{key} failed on {worker}: {told}; see Ray's log on that machine")
        )
