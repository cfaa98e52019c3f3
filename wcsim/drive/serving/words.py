"""What waits to be said to a drive that does not hear yet: bounded, and of what repeats the newest alone.

Of sticks those stay too that say what the newest does not: that the button was pressed, or the stick let go of.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Final

from wcsim.drive import messages as m
from wcsim.drive.stick_watch import rests

_MOST: Final = 256
_REPEATS: Final = (m.Stick, m.Ready, m.SetView)


class Words:
    """Messages in order; one of a kind that repeats takes the place of the one before, at the end."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting = deque[m.PageMessage](maxlen=_MOST)

    def put(self, message: m.PageMessage) -> None:
        """Say this too."""
        with self._lock:
            if isinstance(message, _REPEATS):
                for before in [each for each in self._waiting if _says_as_much(message, each)]:
                    self._waiting.remove(before)
            self._waiting.append(message)

    def take(self) -> list[m.PageMessage]:
        """All that waits; nothing waits then."""
        with self._lock:
            said = list(self._waiting)
            self._waiting.clear()
        return said


def _says_as_much(message: m.PageMessage, before: m.PageMessage) -> bool:
    """Whether one of a kind that repeats says all that the one before it is to be heard for."""
    if isinstance(message, m.Stick) and isinstance(before, m.Stick):
        still_pressed = message.overrule or not before.overrule
        return still_pressed and (rests(message.x, message.y) or not rests(before.x, before.y))
    return type(message) is type(before)
