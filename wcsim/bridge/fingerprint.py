"""Which versions a result to the last bit holds for."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version

PACKAGES = ("libsumo", "pybullet", "numpy")


def fingerprint() -> str:
    """Versions of what computes a trace, and whether the C library is pinned to code that every x86-64 CPU runs."""
    pinned = "pinned" if "hwcaps" in os.environ.get("GLIBC_TUNABLES", "") else "unpinned"
    libc = "-".join(platform.libc_ver())
    return " ".join([*(f"{name}-{version(name)}" for name in PACKAGES), libc, platform.machine(), pinned])
