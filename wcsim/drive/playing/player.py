"""Where a film stands, and how fast it goes: no sockets, no film, and the clock is told."""

from __future__ import annotations

from typing import Final

SLOWEST, FASTEST = 0.25, 8.0
_LATE_S: Final = 0.5  # a player that was kept from its turn for longer does not make up for it


class Player:
    """The number of the frame that is shown.

    >>> player = Player()
    >>> player.advance(0.0, first=0, count=100, tick_s=0.1), player.advance(0.25, first=0, count=100, tick_s=0.1)
    (False, True)
    >>> player.at
    2
    """

    def __init__(self, *, live: bool = False) -> None:
        """Begin with the first frame, or with whatever is the newest."""
        self.at, self.paused, self.pace, self.live = 0, False, 1.0, live
        self.jumped = True  # since the picture before
        self._now_s: float | None = None
        self._owed_s = 0.0  # of the film

    def advance(self, now_s: float, *, first: int, count: int, tick_s: float) -> bool:
        """Let time go to `now_s`; whether another frame is shown. Frames are there from `first` to `count` - 1."""
        gone_s = 0.0 if self._now_s is None else min(max(0.0, now_s - self._now_s), _LATE_S)
        self._now_s, before = now_s, self.at
        if count <= first:
            return False
        if self.live:
            self.at = count - 1
        elif not self.paused:
            self._owed_s += gone_s * self.pace
            ticks = int(self._owed_s / tick_s + 1e-9)
            self._owed_s = self._owed_s - ticks * tick_s if self.at + ticks < count else 0.0
            self.at += ticks
        self.at = min(max(self.at, first), count - 1)
        return self.at != before

    def seek(self, to: int, *, first: int, count: int) -> None:
        """Show this frame, or the nearest that is there."""
        self.live, self._owed_s, self.jumped = False, 0.0, True
        self.at = min(max(to, first), max(first, count - 1))

    def step(self, by: int, *, first: int, count: int) -> None:
        """Stand still, so many frames farther on, or back."""
        self.paused = True
        self.seek(self.at + by, first=first, count=count)

    def go_live(self) -> None:
        """Show the newest frame from now on, as it comes."""
        self.live, self.paused, self.jumped = True, False, True

    def pause(self, on: bool) -> None:
        """Stand still, or go on from here."""
        self.paused, self._owed_s = on, 0.0
        self.live = False

    def set_pace(self, times: float) -> None:
        """Go so much faster than it was."""
        self.pace = min(max(times, SLOWEST), FASTEST)
