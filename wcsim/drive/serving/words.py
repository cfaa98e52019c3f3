"""What waits to be said to a drive that does not hear yet: of each kind the newest alone, one slow wish at a time.

Of sticks those stay too that say what the newest does not: that the button was pressed, or the stick let go of.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Final

from wcsim.drive import messages as m
from wcsim.drive.playing.play_messages import StepBy
from wcsim.drive.stick_watch import rests

_MOST: Final = 256  # of steps, which add up
_PLACES: Final = (m.NewPlace, m.Again, m.Open)  # each makes void what was wanted of those up to it


class Words:
    """Messages in order; one that says as much as one before it takes its place, at the end."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting = deque[m.PageMessage](maxlen=_MOST)
        self._busy = False  # with a slow wish

    def put(self, message: m.PageMessage) -> None:
        """Say this too."""
        with self._lock:
            for before in [each for each in self._waiting if _says_as_much(message, each)]:
                self._waiting.remove(before)
            self._waiting.append(message)

    def take(self) -> list[m.PageMessage]:
        """All that waits; while a slow wish is being done, what comes before the next one."""
        said = list[m.PageMessage]()
        with self._lock:
            while self._waiting and not (self._busy and self._waiting[0].slow):
                said.append(self._waiting.popleft())
                self._busy = self._busy or said[-1].slow
        return said

    def done(self) -> None:
        """The slow wish is done."""
        with self._lock:
            self._busy = False


def _says_as_much(message: m.PageMessage, before: m.PageMessage) -> bool:
    """Whether the one before need not be heard any more: a page that is gone leaves nothing to do behind it."""
    if isinstance(message, m.End | m.Gone):
        return isinstance(message, m.End) or not isinstance(before, m.Ready | m.End)
    if isinstance(message, m.Stick) and isinstance(before, m.Stick):
        still_pressed = message.overrule or not before.overrule
        return still_pressed and (rests(message.x, message.y) or not rests(before.x, before.y))
    if isinstance(message, _PLACES) and isinstance(before, _PLACES):
        return _PLACES.index(type(before)) <= _PLACES.index(type(message))
    return type(message) is type(before) and not isinstance(message, StepBy)
