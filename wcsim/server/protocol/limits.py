"""What the system may refuse a process while it runs: room on a disk, and open files."""

import contextlib
import errno
import os
import resource
from typing import Final

from wcsim.errors import ConfigError

NO_ROOM: Final = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))
_NO_FILES: Final = frozenset((errno.EMFILE, errno.ENFILE))
_REQUESTED_FILES: Final = 4096
_OWN_FILES: Final = 40  # that a world or its launcher opens for itself
_FILES_A_CLIENT: Final = 4


def explain_resource_limit_error(error: BaseException) -> str:
    """What to do about an error that the system's limits cause; "" for any other error."""
    number = getattr(error, "errno", None)
    if number in NO_ROOM:
        return (
            f"the disk is full ({error}); make room, then continue (a training: wcsim resume RUN)"
        )
    if number in _NO_FILES:
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        return (
            f"a process may open {soft} files, which is too few ({error}); "
            "try again after: ulimit -n 1024"
        )
    return ""


def write_stderr_line(text: str) -> None:
    """Write a line to standard error, which may be a file on a full disk, without an error.

    Python's own buffer would fail again at the exit, and change the exit code.
    """
    with contextlib.suppress(OSError):
        os.write(2, f"{text}\n".encode(errors="replace"))


def ensure_open_file_limit(clients: int) -> None:
    """Raise the limit of open files for a launcher, its world and its clients as far as allowed.

    Raises:
        ConfigError: It is still too low.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = _OWN_FILES + _FILES_A_CLIENT * clients
    # A negative limit means none.
    if 0 <= soft < _REQUESTED_FILES:
        soft = _REQUESTED_FILES if hard < 0 else min(hard, _REQUESTED_FILES)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    if 0 <= soft < needed:
        raise ConfigError(
            f"a process may open {soft} files; expected {needed} or more for {clients} clients: "
            "ulimit -n 1024"
        )
