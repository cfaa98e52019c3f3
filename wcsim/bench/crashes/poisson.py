"""How well a rate is known from a number of rare events."""

from __future__ import annotations

import math
from collections.abc import Callable

from wcsim.errors import ConfigError

_HALVINGS = 80  # each halves the interval in which the answer lies


def garwood(events: int, confidence: float = 0.95) -> tuple[float, float]:
    """The exact (Garwood) interval of the mean of a Poisson distribution from which `events` were counted once.

    Raises ConfigError for a negative number of events, or a confidence that is not between 0 and 1.

    >>> [round(bound, 3) for bound in garwood(5)]
    [1.623, 11.668]
    """
    if events < 0 or not 0.0 < confidence < 1.0:
        raise ConfigError(f"events={events}, confidence={confidence}; expected 0 or more, and a share between 0 and 1")
    tail = 0.5 * (1.0 - confidence)
    far = events + 20.0 * math.sqrt(events + 1.0) + 40.0 * abs(math.log(tail))
    high = _solved(lambda mean: at_most(events, mean) > tail, far)
    low = 0.0 if events == 0 else _solved(lambda mean: 1.0 - at_most(events - 1, mean) < tail, far)
    return low, high


def at_most(events: int, mean: float) -> float:
    """The probability of `events` or fewer when `mean` are expected.

    >>> round(at_most(0, 1.0), 6)
    0.367879
    """
    if mean <= 0.0:
        return 1.0
    return math.fsum(math.exp(k * math.log(mean) - mean - math.lgamma(k + 1.0)) for k in range(events + 1))


def _solved(below: Callable[[float], bool], far: float) -> float:
    """Where `below` turns from true to false between 0 and `far`."""
    low, high = 0.0, far
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) else (low, middle)
    return 0.5 * (low + high)
