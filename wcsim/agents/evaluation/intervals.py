"""How well a figure is known: rates of rare events, means over episodes, two policies over the same episodes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from wcsim.core import seeding
from wcsim.types import F64

_HALVINGS = 80  # each halves the interval in which the answer lies
_DRAWS = 2000
FEWEST = 6  # of so many coins one in 32 shows one side alone, of five one in 16: fewer tell nothing at 95 %
_TAIL = 0.5 * (1.0 - 0.95)  # of a distribution on each side of the interval
_NORMAL_95 = 1.959964  # 95 % of a normal distribution lie within so many standard deviations

Interval = tuple[float, float]


def garwood(events: int) -> Interval:
    """The exact (Garwood) 95 % interval of the mean of a Poisson distribution from which `events` were counted once.

    >>> [round(bound, 3) for bound in garwood(5)]
    [1.623, 11.668]
    """
    far = events + 20.0 * math.sqrt(events + 1.0) + 40.0 * abs(math.log(_TAIL))
    high = _solved(lambda mean: at_most(events, mean) > _TAIL, far)
    low = 0.0 if events == 0 else _solved(lambda mean: 1.0 - at_most(events - 1, mean) < _TAIL, far)
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


def wilson(count: int, of: int) -> Interval | None:
    """Wilson's 95 % interval of a share, which has a width where none or all were counted too; None of nothing.

    >>> [round(bound, 3) for bound in wilson(20, 20)]
    [0.839, 1.0]
    """
    if of == 0:
        return None
    share, spread = count / of, _NORMAL_95**2 / of
    middle, half = share + 0.5 * spread, math.sqrt(spread * (share * (1.0 - share) + 0.25 * spread))
    return max(0.0, (middle - half) / (1.0 + spread)), min(1.0, (middle + half) / (1.0 + spread))


def bootstrapped(values: Sequence[float] | F64, weights: Sequence[float] | F64 | None = None) -> Interval | None:
    """The 95 % interval of a weighted mean over episodes, by drawing episodes anew.

    None without any weight, and of fewer than `FEWEST`. The draws are the same for the same numbers of episodes.
    """
    value = np.asarray(values, np.float64)
    weight = np.ones(len(value)) if weights is None else np.asarray(weights, np.float64)
    if len(value) < FEWEST or weight.sum() <= 0.0:
        return None
    drawn = seeding.generator(0, "bootstrap", len(value)).integers(0, len(value), (_DRAWS, len(value)))
    total = weight[drawn].sum(1)
    means = np.where(total > 0.0, (value * weight)[drawn].sum(1) / np.maximum(total, 1e-12), np.nan)
    low, high = np.nanpercentile(means, (2.5, 97.5)).tolist()
    return float(low), float(high)


def mcnemar(only_first: int, only_second: int) -> float:
    """Exact two-sided p-value of McNemar's test: as many or more one-sided pairs if neither were better.

    >>> round(mcnemar(1, 9), 4)
    0.0215
    """
    pairs = only_first + only_second
    if pairs == 0:
        return 1.0
    ways, term = 0, 1  # whole numbers: no float holds the powers of two of a long list
    for k in range(min(only_first, only_second) + 1):
        ways += term
        term = term * (pairs - k) // (k + 1)
    return min(1.0, 2 * ways / (1 << pairs))
