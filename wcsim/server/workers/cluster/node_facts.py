"""What must be the same on all machines of a run, so that a piece of work is the same wherever it is done."""

from __future__ import annotations

import os
import platform
import shutil
import socket
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Final

from wcsim.core.sources import code_digest
from wcsim.errors import ConfigError

_PACKAGES: Final = (
    *("wcsim", "libsumo", "eclipse-sumo", "pybullet", "torch", "numpy", "numba", "opencv-python-headless"),
    *("shapely", "networkx", "zstandard", "gymnasium"),
)
_EXTRAS: Final = ("onnxruntime",)  # asked for where this machine has them
LEAST_SHM_BYTES: Final = 256 << 20
_SHM: Final = Path("/dev/shm")  # noqa: S108 - it is only looked at


@dataclass(frozen=True, slots=True, kw_only=True)
class _NodeFacts:
    """A machine, as a process of it sees it."""

    host: str
    python: str
    versions: tuple[tuple[str, str], ...]  # of packages, sorted
    code: str  # SHA-256 of wcsim's own
    cpu: str
    shm_bytes: int


def facts_here() -> _NodeFacts:
    """Those of this machine."""
    return _NodeFacts(
        host=socket.gethostname(),
        python=platform.python_version(),
        versions=tuple(sorted((name, _version(name)) for name in (*_PACKAGES, *_EXTRAS))),
        code=code_digest(),
        cpu=_cpu(),
        shm_bytes=shutil.disk_usage(_SHM).total if os.path.isdir(_SHM) else 0,  # noqa: PTH112
    )


def facts_of(found: Any) -> _NodeFacts:
    """What a node has said of itself, in a shape that no version need share. Raises ConfigError for anything else."""
    if isinstance(found, str):
        raise ConfigError(found)
    try:
        return _NodeFacts(**found)
    except TypeError:
        raise ConfigError("it has another version of wcsim; install the same one as here") from None


def why_refused(node: _NodeFacts, here: _NodeFacts) -> str:
    """What a node has other than this machine and must not, "" for nothing."""
    there, ours = dict(node.versions), dict(here.versions)
    if there.get("wcsim") != ours["wcsim"] or node.code != here.code:
        return (
            f"it has wcsim {there.get('wcsim')}, code {node.code[:12]}; expected wcsim {ours['wcsim']}, code "
            f"{here.code[:12]}, as here: install the same there, then `ray stop` and `ray start` it again"
        )
    asked = [name for name in ours if ours[name] or name not in _EXTRAS]
    differ = [name for name in asked if there.get(name, "") != ours[name]]
    other = [f"{name} {there.get(name) or 'none'} (here {ours[name] or 'none'})" for name in differ]
    if node.python.split(".")[:2] != here.python.split(".")[:2]:
        other.append(f"Python {node.python} (here {here.python})")
    if other:
        return f"it has {', '.join(other)}; expected the same as here: install from the same constraints.txt"
    return ""


def notes_on(node: _NodeFacts, here: _NodeFacts) -> tuple[str, ...]:
    """What is worth a line, and no reason to refuse a node."""
    notes = []
    if node.shm_bytes < LEAST_SHM_BYTES:
        notes.append(
            f"{_SHM} has {node.shm_bytes >> 20} MiB; expected {LEAST_SHM_BYTES >> 20}: Ray then stores its objects on "
            "disk, which is slower; start the container with --shm-size=1g"
        )
    if node.cpu != here.cpu:
        notes.append(f"its processor is different ({node.cpu}; here {here.cpu}): the last bits of its data may differ")
    return tuple(notes)


def _version(package: str) -> str:
    try:
        return metadata.version(package).partition("+")[0]  # torch 2.13.0+cpu is 2.13.0
    except metadata.PackageNotFoundError:
        return ""


def _cpu() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()
