"""A clock of the time in which a process was awake: while a signal stops it, it does not wait."""

from typing import Final

LEAP_S: Final = 0.5


class SuspendSafeClock:
    """Time that advances by at most `LEAP_S` between two readings, beyond the steps of a world."""

    def __init__(self, real_s: float) -> None:
        """Start at 0; `real_s` is the machine's monotonic clock."""
        self.now_s = 0.0
        self._last_real_s = real_s

    def look(self, real_s: float, stepped_s: float = 0.0) -> float:
        """Advance to the machine's time; returns the time awake.

        Args:
            real_s: The machine's monotonic clock.
            stepped_s: The part since the last reading in which the world stepped.
        """
        rest_s = max(0.0, real_s - self._last_real_s - stepped_s)
        self._last_real_s = real_s
        self.now_s += stepped_s + min(rest_s, LEAP_S)
        return self.now_s
