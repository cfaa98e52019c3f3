"""The versions for which a result holds to the last bit."""

import os
import platform
from pathlib import Path
from typing import Final

from wcsim.core.sources import read_package_version

PACKAGES: Final = ("libsumo", "pybullet", "numpy", "numba", "shapely", "networkx")
# CPUs with the same vector units still differ in the last bit: numpy, its linear algebra and numba
# choose their code by the kind of CPU.
_CPU_KIND: Final = ("vendor_id", "cpu family", "model")


def make_software_fingerprint() -> str:
    """`make_engine_fingerprint` and the version of wcsim, for what is made to the last bit."""
    return f"wcsim-{read_package_version('wcsim')} {make_engine_fingerprint()}"


def make_engine_fingerprint() -> str:
    """Versions of what computes a trace, the kind of CPU, and whether the C library is pinned.

    A pinned one uses code that all CPUs have. The version of wcsim is left out: a golden trace must
    outlive it.
    """
    pinned = "pinned" if "hwcaps" in os.environ.get("GLIBC_TUNABLES", "") else "unpinned"
    libc = "-".join(platform.libc_ver())
    versions = (f"{name}-{read_package_version(name)}" for name in PACKAGES)
    return " ".join([*versions, libc, platform.machine(), _cpu_kind(), pinned])


def _cpu_kind() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return "unknown-cpu"
    # Reversed, so that of all cores the first one's values stay.
    pairs = [line.partition(":") for line in reversed(lines)]
    first = {name.strip(): value.strip() for name, _, value in pairs}
    # A virtual machine may tell the model of an older CPU, without units that are there.
    newer = ["amx"] if "amx_tile" in first.get("flags", "").split() else []
    return "-".join([*(first.get(name, "?") for name in _CPU_KIND), *newer])
