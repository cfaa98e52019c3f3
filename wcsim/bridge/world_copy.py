"""A copy of the world (`os.fork`), where it stands, that says how the street would go on.

It never comes back. That is the same as a replay to this tick, at the price of the ticks after it
alone.
"""

import os
from collections.abc import Callable
from typing import Final

from wcsim.bridge.world import World
from wcsim.errors import PhysicsError

_MOST_SAID: Final = 2000
_DONE, _FAILED = b"+", b"-"


def in_copy(world: World, ask: Callable[[World], bytes]) -> bytes:
    """What `ask` finds in a copy of the world; the world itself does not move.

    Args:
        world: It stands between two ticks.
        ask: Drives the copy on, and says what came of it.

    Raises:
        PhysicsError: The copy ended without an answer.
    """
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reader)
            with os.fdopen(writer, "wb") as answers:
                answers.write(_answer(world, ask))
        finally:
            os._exit(0)  # nothing of the parent's may be closed, flushed or removed here
    os.close(writer)
    with os.fdopen(reader, "rb") as answers:
        answer = answers.read()
    os.waitpid(pid, 0)
    if answer[:1] != _DONE:
        said = answer[1:].decode(errors="replace") or "no answer"
        raise PhysicsError(f"the copy of the world returned {said}; expected an answer: try again")
    return answer[1:]


def _answer(world: World, ask: Callable[[World], bytes]) -> bytes:
    try:
        return _DONE + ask(world)
    except Exception as error:  # it is told where it is understood: in the process that was copied
        return _FAILED + f"{type(error).__name__}: {error}"[:_MOST_SAID].encode()
