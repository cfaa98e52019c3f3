"""A copy of the world (`os.fork`), where it stands, to find how the street would go on.

It is the same as a replay to this tick, at the price of the ticks after it alone. One thread of a
process is in its copy, so the world has to draw its pictures by one (`world.draw_threads=1`).

A copy would share the places in open files: SUMO reads a large file of routes bit by bit, and what
the copy has read would be missing in the original. So a copy opens them anew, and writes nothing.
"""

import fcntl
import os
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeVar

from wcsim.bridge.world import World
from wcsim.errors import PhysicsError

_LONGEST_MESSAGE: Final = 2000
_DONE, _FAILED = b"+", b"-"
_STANDARD: Final = 3  # streams, which lead where those of the original do

T = TypeVar("T")


def in_copy(world: World, explore: Callable[[World], bytes]) -> bytes:
    """What `explore` finds in a copy of the world; the world itself does not move.

    Args:
        world: It stands between two ticks.
        explore: Drives the copy on, and returns the result.

    Raises:
        PhysicsError: The copy ended without an answer.
    """
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            _open_files_anew()
            os.close(reader)
            with os.fdopen(writer, "wb") as answers:
                try:
                    answer = _DONE + explore(world)
                # It is reported in the process that was copied, where it is understood.
                except Exception as error:
                    message = f"{type(error).__name__}: {error}"[:_LONGEST_MESSAGE]
                    answer = _FAILED + message.encode()
                answers.write(answer)
        # Nothing of the parent's may be closed, flushed or removed here.
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as answers:
        answer = answers.read()
    os.waitpid(pid, 0)
    if answer[:1] != _DONE:
        message = answer[1:].decode(errors="replace") or "no answer"
        raise PhysicsError(
            f"the copy of the world returned {message}; expected an answer: try again"
        )
    return answer[1:]


def go_on_in_copy(begin: Callable[[], T]) -> T | None:
    """Make a copy of this process that goes on by itself.

    Returns:
        In the copy, what `begin` returns; it has to end by `os._exit`, as nothing of the original's
        may be closed, flushed or removed there. None in the original.
    """
    pid = os.fork()
    if pid:
        os.waitpid(pid, 0)
        return None
    # The copy is nobody's child, so that nobody has to wait for its end.
    if os.fork():
        os._exit(0)
    _open_files_anew()
    return begin()


def _open_files_anew() -> None:
    """Give this process places of its own in the files that it reads, and no others."""
    for path in list(Path("/proc/self/fd").iterdir()):
        number = int(path.name)
        # The folder's own descriptor is closed by now.
        with suppress(OSError):
            if number < _STANDARD or not stat.S_ISREG(os.fstat(number).st_mode):
                continue
            reads = fcntl.fcntl(number, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY
            # By this path also a file that was removed.
            own = os.open(path, os.O_RDONLY) if reads else os.open(os.devnull, os.O_WRONLY)
            if reads:
                os.lseek(own, os.lseek(number, 0, os.SEEK_CUR), os.SEEK_SET)
            os.dup2(own, number, inheritable=False)
            os.close(own)
