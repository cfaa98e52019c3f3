"""Which versions a result to the last bit holds for."""

from __future__ import annotations

import os
import platform
from pathlib import Path

from wcsim.core.sources import version_of

PACKAGES = ("libsumo", "pybullet", "numpy", "numba", "shapely", "networkx")
_CPU_KIND = ("vendor_id", "cpu family", "model")
"""Two kinds of the same vector units still differ in the last bit: numpy, its linear algebra and numba go by kind."""


def fingerprint() -> str:
    """The version of wcsim, and `engines_fingerprint`: for what has to be made again to the last bit."""
    return f"wcsim-{version_of('wcsim')} {engines_fingerprint()}"


def engines_fingerprint() -> str:
    """Versions of what computes a trace, the kind of CPU, and whether the C library is pinned to common code.

    Without wcsim's own, which a golden trace must outlive.
    """
    pinned = "pinned" if "hwcaps" in os.environ.get("GLIBC_TUNABLES", "") else "unpinned"
    libc = "-".join(platform.libc_ver())
    versions = (f"{name}-{version_of(name)}" for name in PACKAGES)
    return " ".join([*versions, libc, platform.machine(), _cpu_kind(), pinned])


def _cpu_kind() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return "unknown-cpu"
    named = [line.partition(":") for line in lines]
    first = {name.strip(): value.strip() for name, _, value in reversed(named)}
    return "-".join(first.get(name, "?") for name in _CPU_KIND)
