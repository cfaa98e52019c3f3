"""A copy of the world (`os.fork`), where it stands, to find how the street would go on.

The copy ends with its answer. That is the same as a replay to this tick, at the price of the ticks
after it alone.
"""

import os
from collections.abc import Callable
from typing import Final

from wcsim.bridge.world import World
from wcsim.errors import PhysicsError

_LONGEST_MESSAGE: Final = 2000
_DONE, _FAILED = b"+", b"-"


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
