"""A clock of the time in which a process was awake: one that was stopped for an hour has not waited for anybody."""

from __future__ import annotations

LEAP_S = 0.5


class AwakeClock:
    """Time that goes on by at most half a second from one look to the next, beyond what a step of the world took."""

    def __init__(self, real_s: float) -> None:
        """Begin at 0; `real_s` is the machine's monotonic clock."""
        self.now_s = 0.0
        self._seen_s = real_s

    def look(self, real_s: float, stepped_s: float = 0.0) -> float:
        """Take in the machine's time; `stepped_s` of it since the last look was a step's. Returns the time awake."""
        rest_s = max(0.0, real_s - self._seen_s - stepped_s)
        self._seen_s = real_s
        self.now_s += stepped_s + min(rest_s, LEAP_S)
        return self.now_s
