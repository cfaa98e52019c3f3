"""Where shared memory lies: a folder of its own for each world, in memory where the machine has such a place."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
from pathlib import Path

PREFIX = "wcsim-ring-"
_SHARED = Path("/dev/shm")  # noqa: S108 - the folder made in it is new, and its owner's alone
_NAME = re.compile(re.escape(PREFIX) + r"(\d+)-\w+")


def make_ring_folder(owner_pid: int = 0) -> Path:
    """A new folder that only its user can enter, named after the process that will remove it (this one when 0)."""
    return Path(tempfile.mkdtemp(prefix=f"{PREFIX}{owner_pid or os.getpid()}-", dir=_home()))


def remove_ring_folder(folder: Path) -> None:
    """Remove a folder; whoever still reads pictures of it keeps them. A second call does nothing."""
    shutil.rmtree(folder, ignore_errors=True)


def remove_stale_rings() -> int:
    """Remove this user's folders whose processes have died; returns how many."""
    removed = 0
    for folder in _home().glob(f"{PREFIX}*"):
        match = _NAME.fullmatch(folder.name)
        if match and _mine(folder) and not _lives(int(match.group(1))):
            remove_ring_folder(folder)
            removed += 1
    return removed


def _home() -> Path:
    usable = _SHARED.is_dir() and os.access(_SHARED, os.W_OK | os.X_OK)
    return _SHARED if usable else Path(tempfile.gettempdir())


def _mine(folder: Path) -> bool:
    with contextlib.suppress(OSError):
        return folder.lstat().st_uid == os.getuid()
    return False


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
