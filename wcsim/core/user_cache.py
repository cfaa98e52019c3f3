"""Where this user's wcsim keeps what it can make again. Loads nothing of wcsim, for whoever only asks."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

KERNELS = "kernels"  # the folder in it for machine code


def user_cache() -> Path:
    """$XDG_CACHE_HOME/wcsim or ~/.cache/wcsim; where that cannot be written, this user's own temporary folder.

    So a user without a home, as services and containers have them, builds a street once, and not in each process.
    """
    wanted = _wanted()
    if wanted is not None and _can_be_written(wanted):
        return wanted
    return _temporary() or wanted or Path(os.devnull) / "wcsim"  # the last two only say that nothing can be kept


def home() -> Path | None:
    """The user's home, None for a user who has none, as for a number that the machine has no name for."""
    try:
        return Path.home()
    except RuntimeError:
        return None


def _wanted() -> Path | None:
    base, own = os.environ.get("XDG_CACHE_HOME", ""), home()
    if base:
        return Path(base) / "wcsim"
    return None if own is None else own / ".cache" / "wcsim"


def _can_be_written(folder: Path) -> bool:
    """Whether it can, or can be made."""
    place = folder.absolute()
    while not os.path.lexists(place) and place != place.parent:
        place = place.parent
    return place.is_dir() and os.access(place, os.W_OK | os.X_OK)


def _temporary() -> Path | None:
    """A folder for this user alone; None where somebody else was there first, for machine code is read from it."""
    try:
        folder = Path(tempfile.gettempdir()) / f"wcsim-cache-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if own else None
