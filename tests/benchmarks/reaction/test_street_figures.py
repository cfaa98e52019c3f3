import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.reaction.street_figures import GapsTaken, StreetFigures, critical_gap_s, crowd_figures, spread_of
from tests.bridge.reaction.roads import actor, walker

GAPS = st.lists(st.floats(0.1, 20.0), min_size=1, max_size=30)


@given(values=st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=50))
def test_a_median_lies_in_its_interval_and_so_do_the_percentiles_in_order(values):
    spread = spread_of(values)
    assert spread.n == len(values)
    assert list(spread.percentiles) == sorted(spread.percentiles)
    assert spread.median_ci[0] - 1e-9 <= spread.percentiles[2] <= spread.median_ci[1] + 1e-9


def test_of_nothing_nothing_is_told():
    assert spread_of([]).told == "- (0)"
    assert spread_of([1.0, 2.0]).median_ci == (-math.inf, math.inf)


def test_only_stops_that_have_ended_count_and_speeds_are_those_of_moving():
    figures = StreetFigures(every_s=1.0)
    for mps in (1.0, 1.2, 0.0, 0.1, 0.0, 1.4, 0.0, 1.0, 0.0, 0.0):
        figures.add((walker(0.0, 0.0, name="p:1", speed=mps), walker(3.0, 0.0, name="p:2", speed=0.0)))
    found = figures.values()
    assert found["stops of people, s"] == [3.0]
    assert found["pedestrian, m/s"] == [pytest.approx(1.1)] and found["car, m/s"] == []
    assert found["people per square metre"] == pytest.approx([1.0 / (25.0 * math.pi)] * 20)


def test_a_crowd_is_measured_around_the_chair():
    people = np.full((3, 2, 4), np.nan)
    people[:, 0] = [(-3.0, 0.0, 1.0, 0.0), (-1.0, 0.3, 0.5, 0.3), (1.0, 0.4, 1.0, -0.4)]
    people[1:, 1] = [(-1.0, 1.3, 1.0, 0.0), (-9.0, 9.0, 1.0, 0.0)]
    free_m = np.array([[np.nan, np.nan], [0.4, np.nan], [np.nan, np.nan]])
    found = crowd_figures(people, np.zeros((3, 2)), free_m)
    to_chair, apart, slowing, sidestep, gap, density = found.values()
    assert to_chair == pytest.approx([math.hypot(1.0, 0.3), math.hypot(1.0, 1.3)])
    assert apart == [1.0] and slowing == [0.5] and sidestep == [0.4] and gap == [0.4]
    assert density == pytest.approx([n / (25.0 * math.pi) for n in (1, 2, 1)])


def test_who_waits_beside_lets_gaps_go_by_and_takes_one():
    gaps = GapsTaken()
    passes_s, turns_s = (1.0, 4.0, 6.0, 15.0), 9.0
    for tick in range(200):
        now_s = 0.1 * tick
        main = [actor(name=f"v:{i}", x=10.0 * (now_s - at_s), y=1.6, speed=10.0) for i, at_s in enumerate(passes_s)]
        y, mps = (-10.0, 0.0) if now_s < turns_s else (min(-6.0 + 3.0 * (now_s - turns_s), 0.0), 3.0)
        side = [actor(name="v:side", x=5.0, y=y, yaw=0.5 * math.pi, speed=mps)]
        if now_s < 14.0:  # queues behind, and takes the same gap
            y, mps = (-16.0, 0.0) if now_s < 12.0 else (8.0 * (now_s - 14.0), 8.0)
            side.append(actor(name="v:behind", x=5.0, y=y, yaw=0.5 * math.pi, speed=mps))
        gaps.add((*main, *side), now_s)
    taken, refused = gaps.taken_refused_s()
    assert taken == pytest.approx([9.0, 9.0], abs=0.25)
    assert refused == pytest.approx([3.0, 2.0], abs=0.25)


@given(taken=GAPS, refused=GAPS, by=st.floats(0.5, 2.0))
def test_a_critical_gap_scales_with_time_and_is_one_of_the_gaps(taken, refused, by):
    critical_s = critical_gap_s(taken, refused)
    assert critical_s in {*taken, *refused}
    assert math.isnan(critical_gap_s([], refused))
    assert critical_gap_s([by * s for s in taken], [by * s for s in refused]) == pytest.approx(by * critical_s)
