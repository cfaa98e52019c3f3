"""Time by stage, for the benches; nothing in the world ever reads it."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType


class Stopwatch:
    """Adds up the time spent in each named stage, without that in stages inside of it."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        """Measure wall time, or by another clock."""
        self._clock = clock
        self._spent_s: dict[str, float] = {}
        # Of the stages that are open now: the time of the stages inside of them.
        self._inner_s: list[float] = []

    def measure(self, stage: str) -> _Stage:
        """Count the time of the block that is entered with it for `stage`."""
        return _Stage(self._clock, self._spent_s, self._inner_s, stage)

    def take(self) -> tuple[tuple[str, float], ...]:
        """Seconds by stage since the last call, largest first."""
        spent = sorted(self._spent_s.items(), key=lambda item: -item[1])
        self._spent_s.clear()
        return tuple(spent)


class _Stage:
    """One block; a generator would cost three times as much, and a tick has dozens of them."""

    __slots__ = ("_clock", "_inner_s", "_spent_s", "_stage", "_start_s")

    def __init__(
        self,
        clock: Callable[[], float],
        spent_s: dict[str, float],
        inner_s: list[float],
        stage: str,
    ) -> None:
        self._clock, self._spent_s, self._inner_s, self._stage = clock, spent_s, inner_s, stage

    def __enter__(self) -> None:
        self._inner_s.append(0.0)
        self._start_s = self._clock()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        whole_s = self._clock() - self._start_s
        own_s = whole_s - self._inner_s.pop()
        self._spent_s[self._stage] = self._spent_s.get(self._stage, 0.0) + own_s
        if self._inner_s:
            self._inner_s[-1] += whole_s
