"""Versions of installed packages, and of the physics engine, which has two names."""

from __future__ import annotations

from importlib import metadata
from typing import Final

_FORK: Final = "pybullet-arm64"  # PyBullet for Python 3.12 and later: its own packages end at 3.11
_SAME_BYTES: Final = {"3.2.8": "3.2.7"}  # of the fork, and of PyBullet itself: scenes have the same hashes with both


def version_of(package: str) -> str:
    """The version of a distribution, "" where it is not installed.

    The one of "pybullet" is that of the engine: a fork that gives the same bytes counts as the release that it repeats.
    """
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        if package != "pybullet":
            return ""
    fork = version_of(_FORK)
    return _SAME_BYTES.get(fork, fork and f"{_FORK}-{fork}")
