"""A route as a line: projection, points beside it, corners."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.users.kinematics import polyline
from wcsim.errors import ConfigError
from wcsim.types import Route
from wcsim.users.route_line import RoutePolyline

ROUTE = polyline((0, 0), (10, 0), (10, 10), (20, 10))
PATH = RoutePolyline(ROUTE)


@given(st.floats(0.5, 29.5), st.floats(-0.4, 0.4))
def test_projecting_a_point_beside_the_route_finds_it_again(arc_m, left_m):
    if min(abs(arc_m - 10), abs(arc_m - 20)) < 0.5:
        return
    x, y = PATH.at(arc_m, left_m)
    place = PATH.project(x, y, arc_m)
    assert place.arc_m == pytest.approx(arc_m, abs=1e-9)
    assert place.left_m == pytest.approx(left_m, abs=1e-9)


def test_length_heading_and_both_ends():
    assert PATH.length_m == pytest.approx(30.0)
    assert PATH.heading(15.0) == pytest.approx(math.pi / 2)
    assert PATH.at(-2.0) == pytest.approx((-2.0, 0.0))
    assert PATH.at(33.0) == pytest.approx((23.0, 10.0))


def test_a_route_that_returns_is_not_mixed_up():
    there_and_back = RoutePolyline(polyline((0, 0), (20, 0), (20, 0.5), (0, 0.5)))
    assert there_and_back.project(5.0, 0.3, 5.0).arc_m == pytest.approx(5.0)
    assert there_and_back.project(5.0, 0.2, 35.0).arc_m == pytest.approx(35.5)


def test_a_point_far_away_is_found_on_the_whole_route():
    assert PATH.project(19.0, 10.2, 0.0).arc_m == pytest.approx(29.0)


def test_corners_slow_down_and_straights_do_not():
    assert PATH.speed_limit(2.0, 0.6, 0.6, 5.0) == math.inf
    at_corner = PATH.speed_limit(10.0, 0.6, 0.6, 5.0)
    assert at_corner < 0.4
    limits = [PATH.speed_limit(arc, 0.6, 0.6, 5.0) for arc in np.arange(5.5, 10.0, 0.25)]
    assert limits == sorted(limits, reverse=True)
    gentle = RoutePolyline(polyline((0, 0), (10, 0), (20, 0.8)))
    assert gentle.speed_limit(10.0, 0.6, 0.6, 5.0) == math.inf


def test_a_round_corner_counts_like_a_sharp_one_of_its_radius():
    angles = np.linspace(-math.pi / 2, 0, 20)
    for radius, slow in ((0.4, True), (8.0, False)):
        arc = np.c_[radius * np.cos(angles), radius + radius * np.sin(angles)]
        limit = RoutePolyline(polyline((-10, 0), *map(tuple, arc), step_m=0.2)).speed_limit(
            10.0 + radius, 0.6, 0.6, 1.0
        )
        assert (limit < 0.5) == slow, radius


def test_odd_routes():
    twice = Route(points_W_m=np.zeros((3, 2)), arc_m=np.zeros(3), edge_index=np.zeros(3, np.int32))
    assert RoutePolyline(twice).length_m < 0.01
    empty = Route(points_W_m=np.zeros((0, 2)), arc_m=np.zeros(0), edge_index=np.zeros(0, np.int32))
    with pytest.raises(ConfigError, match="no points"):
        RoutePolyline(empty)
