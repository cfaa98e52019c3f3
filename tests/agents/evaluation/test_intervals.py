"""Intervals of rare events."""

import pytest

from wcsim.agents.evaluation.intervals import at_most, garwood
from wcsim.errors import ConfigError


@pytest.mark.parametrize(
    ("events", "low", "high"),
    [(0, 0.0, 3.689), (1, 0.0253, 5.572), (5, 1.623, 11.668), (20, 12.217, 30.888), (100, 81.364, 121.627)],
)
def test_bounds_are_those_of_tables(events, low, high):
    assert garwood(events) == pytest.approx((low, high), abs=1e-3)


def test_many_events_give_an_interval_that_shrinks_towards_them():
    low, high = garwood(10_000)
    assert low == pytest.approx(10_000 - 1.96 * 100, rel=1e-3)
    assert high == pytest.approx(10_000 + 1.96 * 100, rel=1e-3)


def test_a_higher_confidence_is_a_wider_interval():
    assert garwood(7, 0.99)[0] < garwood(7, 0.9)[0] < 7 < garwood(7, 0.9)[1] < garwood(7, 0.99)[1]


def test_probabilities_of_all_numbers_add_up():
    assert at_most(200, 50.0) == pytest.approx(1.0)
    assert at_most(0, 0.0) == 1.0


@pytest.mark.parametrize(("events", "confidence"), [(-1, 0.95), (3, 1.0), (3, 0.0)])
def test_what_is_no_count_is_refused(events, confidence):
    with pytest.raises(ConfigError, match="expected 0 or more"):
        garwood(events, confidence)
