"""The folder of a running world: its socket, its shared memory, the orders of its processes.

It is removed with its owner. It lies in memory where the machine has such a place; temporary files
lie in folders of the same kind elsewhere.

A process owns a folder while it holds the lock of a file in it. The kernel releases a lock when its
holder ends, and shows it to processes that cannot see each other's numbers, as in containers that
share the place.
"""

import contextlib
import fcntl
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Final

from wcsim.errors import DiskFullError

WORK_PREFIX: Final = "wcsim-work-"  # of temporary files
LOCK: Final = ".lock"
_PREFIX: Final = "wcsim-ring-"
_SHARED: Final = Path("/dev/shm")  # noqa: S108 - the folder made in it is new, and its owner's alone
_LONGEST_HOME: Final = 64  # bytes, of the 107 that the path of a socket may have
# What follows the prefix; the process number is for people to read.
_NUMBERED: Final = re.compile(r"(\d+)-\w+")
_FLAGS: Final = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


class LockedTempFolder:
    """A new folder that only its user can enter; `close` removes it."""

    def __init__(self, home: Path | None = None, prefix: str = _PREFIX) -> None:
        """Make a folder, after removing those of dead owners; it appears with its lock held.

        Raises DiskFullError when there is no room.
        """
        home = _default_home() if home is None else home
        _remove_stale(home, prefix)
        try:
            new = Path(tempfile.mkdtemp(prefix=f".{prefix}", dir=home))  # noqa: TID251 - here alone
            self._lock = os.open(
                new / LOCK, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600
            )
            with contextlib.suppress(OSError):  # a file system without locks
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            number = new.name.removeprefix(f".{prefix}")
            self.path = new.rename(new.with_name(f"{prefix}{os.getpid()}-{number}"))
        except OSError as error:
            raise DiskFullError(
                f"{home}: a folder cannot be created ({error.strerror}); make room"
            ) from None

    def close(self) -> None:
        """Remove the folder; open pictures of it can still be read. A second call does nothing."""
        if self._lock >= 0:
            _remove(self.path)
            os.close(self._lock)
            self._lock = -1


def is_abandoned_folder(folder: Path) -> bool:
    """Whether the owner of a world's folder has ended, so that none restarts it; else False."""
    try:
        lock = os.open(folder / LOCK, _FLAGS)
    except OSError as error:
        return isinstance(error, FileNotFoundError) and not os.path.lexists(folder)
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        os.close(lock)
    return True


@contextmanager
def create_runtime_folder(home: Path | None = None, prefix: str = _PREFIX) -> Iterator[Path]:
    """A new folder that only its user can enter, while open."""
    with contextlib.closing(LockedTempFolder(home, prefix)) as folder:
        yield folder.path


def create_temporary_folder() -> AbstractContextManager[Path]:
    """A new folder for temporary files, while open; those of killed processes are removed first."""
    return create_runtime_folder(Path(tempfile.gettempdir()), WORK_PREFIX)


def world_endpoint_from_folder(folder: Path) -> str:
    """The address of the world of a workplace."""
    return f"ipc://{folder / 'world'}"


def _remove_stale(home: Path, prefix: str = _PREFIX) -> int:
    """Remove this user's folders whose owners have ended; returns how many."""
    removed = 0
    for folder in home.glob(f"{prefix}*"):
        try:
            status = folder.lstat()
        except OSError:
            continue
        is_own = status.st_uid == os.getuid() and not stat.S_ISLNK(status.st_mode)
        if is_own and _NUMBERED.fullmatch(folder.name.removeprefix(prefix)):
            removed += _remove_if_stale(folder)
    return removed


def _remove_if_stale(folder: Path) -> bool:
    """Remove a folder whose lock can be taken; whether it is gone now.

    An empty one without a lock is left of a removal that was cut short; the owner of a full one
    without a lock is unknown.
    """
    try:
        lock = os.open(folder / LOCK, _FLAGS)
    except OSError:
        with contextlib.suppress(OSError):
            folder.rmdir()
            return True
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # Another process may have removed the folder meanwhile, and made it again.
        if os.fstat(lock).st_ino != os.lstat(folder / LOCK).st_ino:
            return False
        _remove(folder)
    except OSError:
        return False
    finally:
        os.close(lock)
    return True


def _remove(folder: Path) -> None:
    """Remove a folder whose lock is held.

    The lock goes last, so that no process takes half a folder for another's. It stays where
    something else does, so that the next sweep tries again.
    """
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(folder)):
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            elif entry.name != LOCK:
                with contextlib.suppress(OSError):
                    Path(entry.path).unlink()
        if [entry.name for entry in os.scandir(folder)] in ([LOCK], []):
            (folder / LOCK).unlink(missing_ok=True)
            folder.rmdir()


def _default_home() -> Path:
    """The first place that can be written and leaves room for the path of a socket."""
    temporary = Path(tempfile.gettempdir())
    for place in (_SHARED, temporary, Path("/tmp")):  # noqa: S108 - as above
        if os.access(place, os.W_OK | os.X_OK) and len(str(place)) <= _LONGEST_HOME:
            return place
    return temporary
