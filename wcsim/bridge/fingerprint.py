"""Which versions a result to the last bit holds for."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("libsumo", "pybullet", "numpy")
VECTOR_UNITS = ("avx2", "fma", "avx512f")  # numpy's sines and cosines differ in the last bit between these


def fingerprint() -> str:
    """Versions of what computes a trace, the CPU's vector units, and whether the C library is pinned to common code."""
    pinned = "pinned" if "hwcaps" in os.environ.get("GLIBC_TUNABLES", "") else "unpinned"
    libc = "-".join(platform.libc_ver())
    versions = (f"{name}-{version(name)}" for name in PACKAGES)
    return " ".join([*versions, libc, platform.machine(), *_vector_units(), pinned])


def _vector_units() -> tuple[str, ...]:
    try:
        flags = Path("/proc/cpuinfo").read_text(encoding="utf-8").partition("flags")[2].partition("\n")[0].split()
    except OSError:
        return ("unknown-cpu",)
    return tuple(unit for unit in VECTOR_UNITS if unit in flags)
