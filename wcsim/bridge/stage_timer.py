"""Time by stage, for the benches; nothing in the world ever reads it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Stopwatch:
    """Adds up the time spent in each named stage: wall time, or that of another clock."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._spent_s: dict[str, float] = {}

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Count the time of the enclosed block for `stage`."""
        start_s = self._clock()
        try:
            yield
        finally:
            self._spent_s[stage] = self._spent_s.get(stage, 0.0) + self._clock() - start_s

    def take(self) -> tuple[tuple[str, float], ...]:
        """Seconds by stage since the last call, largest first."""
        spent, self._spent_s = self._spent_s, {}
        return tuple(sorted(spent.items(), key=lambda item: -item[1]))
