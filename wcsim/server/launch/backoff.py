"""When a process that died is started again, and when it is given up."""

from __future__ import annotations

from dataclasses import dataclass

_MOST_DOUBLINGS = 64  # beyond any wait, and still a number


@dataclass(frozen=True, slots=True, kw_only=True)
class RestartRules:
    """How patient a launcher is with a process."""

    first_s: float = 0.5  # before the first restart; twice as long before each further one without progress
    longest_s: float = 30.0
    deaths: int = 5  # without progress; then it is given up


class Restarts:
    """Counts the deaths of one process.

    >>> restarts = Restarts(RestartRules())
    >>> [restarts.died(progressed=False) for _ in range(5)]
    [0.5, 1.0, 2.0, 4.0, None]
    >>> restarts.died(progressed=True)
    0.5
    >>> patient = Restarts(RestartRules(deaths=10_000))
    >>> [patient.died(progressed=False) for _ in range(2_000)][-1]
    30.0
    """

    def __init__(self, rules: RestartRules) -> None:
        self.rules = rules
        self.deaths = 0  # in all
        self.in_vain = 0  # without progress, in a row

    def died(self, progressed: bool) -> float | None:
        """The process has died: seconds until it is to be started again, None when that is of no use any more."""
        self.deaths += 1
        self.in_vain = 1 if progressed else self.in_vain + 1
        if self.in_vain >= self.rules.deaths:
            return None
        return min(self.rules.first_s * 2.0 ** min(self.in_vain - 1, _MOST_DOUBLINGS), self.rules.longest_s)
