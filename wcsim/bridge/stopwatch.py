"""Wall time by stage, for the benches; nothing in the world ever reads it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """Adds up the wall time spent in each named stage."""

    def __init__(self) -> None:
        self._spent_s: dict[str, float] = {}

    @contextmanager
    def measure(self, stage: str) -> Iterator[None]:
        """Count the time of the enclosed block for `stage`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._spent_s[stage] = self._spent_s.get(stage, 0.0) + time.perf_counter() - start

    def take(self) -> tuple[tuple[str, float], ...]:
        """Seconds by stage since the last call, largest first."""
        spent, self._spent_s = self._spent_s, {}
        return tuple(sorted(spent.items(), key=lambda item: -item[1]))
