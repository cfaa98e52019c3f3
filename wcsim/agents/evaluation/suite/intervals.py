"""How well a count, a share or a mean over episodes is known.

95 % intervals, and a test of pairs.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from wcsim.core import seeding
from wcsim.types import F64

# Of so many coins one in 32 shows one side alone, of five one in 16: fewer prove nothing at 95 %.
FEWEST: Final = 6
_DRAWS: Final = 2000

Interval = tuple[float, float]


def wilson(count: int, of: int) -> Interval | None:
    """Wilson's 95 % interval of a share, which has a width where none or all were counted too.

    None of nothing.

    >>> [round(bound, 3) for bound in wilson(20, 20)]
    [0.839, 1.0]
    """
    from scipy.stats import binomtest

    if of == 0:
        return None
    low, high = binomtest(count, of).proportion_ci(method="wilson")
    return float(low), float(high)


def bootstrapped(
    values: Sequence[float] | Sequence[Sequence[float]] | F64,
    weights: Sequence[float] | None = None,
) -> Interval | None:
    """The 95 % interval of a weighted mean over episodes, by drawing episodes anew.

    Of several trainings, (trainings, episodes), these are drawn first: a nested bootstrap.
    None without any weight, and of fewer episodes than `FEWEST`. The draws are the same for the
    same numbers of episodes.
    """
    value = np.atleast_2d(np.asarray(values, np.float64))
    trainings, episodes = value.shape
    weight = np.ones(episodes) if weights is None else np.asarray(weights, np.float64)
    if episodes < FEWEST or weight.sum() <= 0.0:
        return None
    rng = seeding.make_rng(0, "bootstrap", episodes)
    drawn = rng.integers(0, episodes, (_DRAWS, episodes))
    chosen = rng.integers(0, trainings, (_DRAWS, trainings, 1))
    total = weight[drawn].sum(1)
    sums = (value * weight)[chosen, drawn[:, None]].sum(2).mean(1)
    means = np.where(total > 0.0, sums / np.maximum(total, 1e-12), np.nan)
    low, high = np.nanpercentile(means, (2.5, 97.5)).tolist()
    return float(low), float(high)


def mcnemar(only_first: int, only_second: int) -> float:
    """Exact two-sided p-value of McNemar's test.

    As many or more one-sided pairs if neither were better.

    >>> round(mcnemar(1, 9), 4)
    0.0215
    """
    from scipy.stats import binomtest

    pairs = only_first + only_second
    return float(binomtest(only_first, pairs).pvalue) if pairs else 1.0


def is_decided(only_first: int, only_second: int) -> bool:
    """Whether one-sided pairs show a difference at 95 %, however often one looks at them.

    Their mixture likelihood ratio, by a Beta(0.5, 0.5) prior, must reach 20 (Ville's inequality).

    >>> is_decided(9, 1), is_decided(11, 1)
    (False, True)
    """
    from scipy.special import betaln

    pairs = only_first + only_second
    log_ratio = betaln(only_first + 0.5, only_second + 0.5) - betaln(0.5, 0.5)
    return bool(log_ratio + pairs * math.log(2.0) >= math.log(20.0))
