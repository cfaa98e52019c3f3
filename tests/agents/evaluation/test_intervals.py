"""Intervals of rare events."""

import numpy as np
import pytest

from wcsim.agents.evaluation.suite.intervals import FEWEST, bootstrapped, is_decided, mcnemar, wilson


@pytest.mark.parametrize(
    "count, of, low, high",
    [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (81, 263, 0.2553, 0.3662)],
)
def test_shares_have_the_bounds_of_tables_and_a_width_at_their_ends(count, of, low, high):
    assert wilson(count, of) == pytest.approx((low, high), abs=1e-4) and wilson(0, 0) is None


def test_pairs_that_differ_decide_by_their_number_however_many_there_are():
    assert mcnemar(0, 0) == mcnemar(3, 3) == 1.0
    assert mcnemar(0, 5) == mcnemar(5, 0) == pytest.approx(2 / 2**5)
    assert mcnemar(4900, 5100) == pytest.approx(0.0466, abs=1e-3)  # as the normal distribution has it


def test_a_weighted_mean_lies_in_its_interval_which_shrinks_with_more_episodes():
    values, weights = [0.2, 0.9, 0.4, 0.6] * 10, [1.0, 3.0, 0.0, 2.0] * 10
    low, high = bootstrapped(values, weights)
    assert 0.2 <= low < (0.2 + 2.7 + 1.2) / 6.0 < high <= 0.9
    assert bootstrapped(values, weights) == (low, high)
    more_low, more_high = bootstrapped(values * 9, weights * 9)
    assert more_high - more_low == pytest.approx((high - low) / 3.0, rel=0.15)
    assert bootstrapped([0.5], [0.0]) is None and bootstrapped([]) is None


def test_a_few_episodes_have_no_interval_however_equal_they_are():
    assert [bootstrapped([0.846] * count) for count in (1, FEWEST - 1)] == [None, None]
    assert bootstrapped([0.846] * FEWEST) == pytest.approx((0.846, 0.846))


def test_trainings_that_differ_widen_an_interval_and_equal_ones_do_not():
    same, apart = [[0.2, 0.8] * 20] * 3, [[0.0] * 40, [0.5] * 40, [1.0] * 40]
    assert bootstrapped(same) == bootstrapped(same[0])
    low, high = bootstrapped(apart)
    assert low == 0.0 and high == 1.0


def test_who_looks_after_every_pair_is_fooled_in_one_test_of_twenty():
    rng = np.random.default_rng(1)
    fooled = 0
    for coins in rng.random((400, 200)) < 0.5:
        heads = np.cumsum(coins)
        fooled += any(is_decided(int(heads[n]), n + 1 - int(heads[n])) for n in range(0, 200, 5))
    assert 0 < fooled <= 20
    assert not is_decided(0, 0) and is_decided(0, 9) and is_decided(90, 40)
