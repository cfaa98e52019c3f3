"""What the system may refuse a process while it runs: room on a disk, and open files."""

from __future__ import annotations

import contextlib
import errno
import os
import resource

from wcsim.errors import ConfigError

NO_ROOM = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))
_NO_FILES = frozenset((errno.EMFILE, errno.ENFILE))
_WANTED_FILES = 4096
_FILES, _FILES_A_CLIENT = 40, 4  # that a world or its launcher opens by itself, and for each client


def told_limit(error: BaseException) -> str:
    """What to do about an error of the system that is one of a limit; "" for any other."""
    number = getattr(error, "errno", None)
    if number in NO_ROOM:
        return (
            f"the disk is full ({error}); make room, then continue (a training: wcsim resume RUN)"
        )
    if number in _NO_FILES:
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        return f"a process may open {soft} files, which is too few ({error}); try again after: ulimit -n 1024"
    return ""


def last_words(text: str) -> None:
    """A line on standard error, which may be a file on a disk that is full: the exit code counts all the same.

    What Python keeps in a buffer would fail again in its end, with another code.
    """
    with contextlib.suppress(OSError):
        os.write(2, f"{text}\n".encode(errors="replace"))


def require_files(clients: int) -> None:
    """See that a launcher, its world and its clients may open all they need; the limit is raised as far as allowed.

    Raises:
        ConfigError: They may not.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = _FILES + _FILES_A_CLIENT * clients
    if 0 <= soft < _WANTED_FILES:
        soft = _WANTED_FILES if hard < 0 else min(hard, _WANTED_FILES)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    if 0 <= soft < needed:
        raise ConfigError(
            f"a process may open {soft} files; expected {needed} or more for {clients} clients: ulimit -n 1024"
        )
