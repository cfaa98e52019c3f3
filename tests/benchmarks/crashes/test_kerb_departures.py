"""Falls off a kerb, in the street of `tests/support/samples.py`: kerbs at |y| = 4, a crossing at 38 < x < 42."""

import itertools

import numpy as np
import pytest

from benchmarks.crashes.kerb_departures import KerbFall, away_m, nearest_way
from tests.support.samples import strip_street
from wcsim.types import WalkGraph, WayKind

STREET = strip_street()


def falls(*way, steps=40):
    """How often a chair falls that drives along corners of a way."""
    watch = KerbFall(STREET.grid, STREET.walk)
    legs = [np.linspace(a, b, steps) for a, b in itertools.pairwise(way)]
    return [watch.see(point) for point in np.concatenate(legs)].count(True)


def test_leaving_the_pavement_over_the_kerb_is_one_fall():
    assert falls((10.0, 5.5), (10.0, 0.0)) == 1
    assert falls((10.0, -5.5), (10.0, 5.5)) == 1
    assert falls((10.0, 5.5), (10.0, 3.0), (10.0, 5.5), (10.0, 3.0)) == 2


def test_a_verge_is_left_as_a_pavement_is():
    assert falls((10.0, 8.0), (10.0, 6.0), (10.0, 3.0)) == 1


@pytest.mark.parametrize("x", [37.5, 40.0, 42.5])
def test_at_a_crossing_nobody_falls(x):
    assert falls((x, 5.5), (x, -5.5)) == 0


def test_a_flush_edge_is_no_fall_where_there_is_no_crossing():
    """The kerb is 2 cm high at x = 37.76, 12 cm at x = 10."""
    bare = WalkGraph(nodes_W_m=STREET.walk.nodes_W_m, edges=())
    seen = {x: [KerbFall(STREET.grid, bare)] for x in (37.76, 10.0)}
    fell = {x: [watch.see(np.array([x, y])) for y in (5.0, 4.3, 4.1, 3.8, 3.0)] for x, (watch,) in seen.items()}
    assert not any(fell[37.76]) and any(fell[10.0])


def test_who_is_on_the_road_already_or_stays_on_the_pavement_does_not_fall():
    assert falls((0.0, 0.0), (30.0, 3.0)) == 0
    assert falls((0.0, 5.0), (70.0, 5.0)) == 0
    assert falls((10.0, 0.0), (10.0, 5.5)) == 0


def test_the_way_that_is_nearest_is_named():
    (crossing,) = [edge for edge in STREET.walk.edges if edge.kind is WayKind.CROSSING]
    assert nearest_way(STREET.walk, 40.0, 0.0) == crossing.sumo_id
    assert away_m(crossing, 43.0, 0.0) == pytest.approx(3.0)
    assert nearest_way(STREET.walk, 5.0, 5.5) != crossing.sumo_id
