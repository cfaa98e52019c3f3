"""What a node of a cluster does, in a process of Ray: report facts, take in files, work, answer.

Files travel by their names below a folder, each compressed. They are written to a temporary folder
of their piece.
"""

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

from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import decompress_zstd, escape
from wcsim.core.sources import hash_package_code, read_package_version
from wcsim.errors import ConfigError, DiskFullError, WcsimError, WorkersError
from wcsim.server.workers.machines import WorkInputFiles, WorkPiece, WorkResult

MOST_BYTES: Final = 512 << 20
"""Of the input files of a piece, and of its result."""
_MOST_FILES: Final = 10_000
_COMPRESSION_LEVEL: Final = 3
_PACKAGES: Final = (
    "wcsim",
    "libsumo",
    "eclipse-sumo",
    "pybullet",
    "torch",
    "numpy",
    "numba",
    "opencv-python-headless",
    "shapely",
    "networkx",
    "zstandard",
    "gymnasium",
    "onnxruntime",
)
_LEAST_SHM_MIB: Final = 256
_SHM: Final = Path("/dev/shm")  # noqa: S108 - it is only looked at
_ERROR_CHARACTERS: Final = 300


def collect_machine_info() -> dict[str, str]:
    """What this machine has.

    Versions by package and "Python", "code" of wcsim, "host", "cpu", "shm_mib".
    """
    return {
        # torch 2.13.0+cpu is 2.13.0.
        **{name: read_package_version(name).partition("+")[0] for name in _PACKAGES},
        "Python": ".".join(platform.python_version_tuple()[:2]),
        "code": hash_package_code(),
        "host": socket.gethostname(),
        "cpu": _cpu(),
        "shm_mib": str(shutil.disk_usage(_SHM).total >> 20 if os.path.isdir(_SHM) else 0),  # noqa: PTH112
    }


def find_node_mismatch(node: Mapping[str, str], here: Mapping[str, str]) -> str:
    """What a node has other than this machine and must not, "" for nothing."""
    version = node.get("wcsim")
    code = node.get("code", "")
    if (version, code) != (here["wcsim"], here["code"]):
        return (
            f"it has wcsim {version}, code {code[:12]}; expected wcsim {here['wcsim']}, code "
            f"{here['code'][:12]}, as here: install the same there, then `ray stop` and "
            "`ray start` it again"
        )
    different = [
        f"{name} {node[name] or 'none'} (here {here[name] or 'none'})"
        for name in (*_PACKAGES, "Python")
        if node[name] != here[name]
    ]
    if different:
        return (
            f"it has {', '.join(different)}; expected the same as here: install from the same "
            "constraints.txt"
        )
    return ""


def find_node_warnings(node: Mapping[str, str], here: Mapping[str, str]) -> tuple[str, ...]:
    """What is worth a line, and no reason to refuse a node."""
    notes = []
    if int(node["shm_mib"]) < _LEAST_SHM_MIB:
        notes.append(
            f"{_SHM} has {node['shm_mib']} MiB; expected {_LEAST_SHM_MIB}: Ray then stores its "
            "objects on disk, which is slower; start the container with --shm-size=1g"
        )
    if node["cpu"] != here["cpu"]:
        notes.append(
            f"its processor is different ({node['cpu']}; here {here['cpu']}): the last bits of its "
            "data may differ"
        )
    return tuple(notes)


def _cpu() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def compress_input_files(files: WorkInputFiles) -> dict[str, bytes]:
    """Input files by name, each a zstd frame.

    Raises:
        ConfigError: They are too many or too large.
        OSError: One cannot be read.
    """
    size = sum((files.folder / name).stat().st_size for name in files.names)
    if size > MOST_BYTES or len(files.names) > _MOST_FILES:
        raise ConfigError(
            f"{escape(files.folder)} has {len(files.names)} files of {size >> 20} MiB; expected "
            f"at most {_MOST_FILES} of {MOST_BYTES >> 20} MiB, as they travel to other machines: "
            "drive it without --cluster"
        )
    compressor = zstandard.ZstdCompressor(level=_COMPRESSION_LEVEL)
    return {name: compressor.compress((files.folder / name).read_bytes()) for name in files.names}


def _unpack(contents: Mapping[str, bytes], folder: Path) -> None:
    """Write files below a folder.

    Raises:
        ValueError: A name leads elsewhere, or there are too many bytes or files.
    """
    if len(contents) > _MOST_FILES:
        raise ValueError(f"{len(contents)} files; expected at most {_MOST_FILES}")
    folder.mkdir(parents=True, exist_ok=True)
    left = MOST_BYTES
    for name, content in contents.items():
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts:
            raise ValueError(
                f"a file is called {escape(name, 80)!r}; expected a name below its folder"
            )
        data = decompress_zstd(content, left)
        left -= len(data)
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)


def run_work_piece(
    worker: str, work: WorkPiece, needed: tuple[WorkInputFiles, ...], *contents: Mapping[str, bytes]
) -> WorkResult:
    """Do a piece of work in this process, which Ray has started.

    Args:
        worker: Its name.
        work: The piece.
        needed: The input files.
        contents: Those of each of `needed`, from Ray's store.
    """
    key = work.key
    start_s = time.monotonic()
    pid = os.getpid()
    end = partial(WorkResult, worker=worker, key=key, facts={"pid": pid})
    try:
        with create_temporary_folder() as own:
            paths = {}
            for number, (files, content) in enumerate(zip(needed, contents, strict=True)):
                # The folder keeps its name: a town may be called by it.
                folder = own / f"parcel-{number}" / (files.folder.name or "folder")
                _unpack(content, folder)
                paths[files.address] = str(folder / files.inner)
            data = work.call(work.piece, lambda address: paths.get(address, address))
        work_s = round(time.monotonic() - start_s, 3)
        return end(data=data, facts={"pid": pid, "bytes": len(data), "work_s": work_s})
    except (OSError, MemoryError, DiskFullError) as error:
        # This machine is at fault, and another one may have room.
        return end(lost=f"{type(error).__name__}: {error}")
    except WcsimError as error:
        return end(error=error)
    except Exception as error:
        # Into Ray's log of this process.
        sys.stderr.write(f"wcsim: {key} failed: {traceback.format_exc()}\n")
        text = f"{type(error).__name__}: {error}"[:_ERROR_CHARACTERS]
        return end(
            error=WorkersError(f"{key} failed on {worker}: {text}; see Ray's log on that machine")
        )
