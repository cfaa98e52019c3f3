"""The room that a street leaves beside a route, and how far a user keeps from its edges."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.samples import straight_route, strip_street
from wcsim.types import ClassId
from wcsim.users.avoidance import FARTHEST_M, PavementWidthScanner, comfortable_offsets, smooth_offsets
from wcsim.users.route_line import RoutePolyline

GRID = strip_street().grid


def test_room_goes_to_the_kerb_and_to_the_pole():
    edges = PavementWidthScanner(GRID, RoutePolyline(straight_route()))
    left, right = edges.room(10.0, 4.5)
    assert right == pytest.approx(5.5 - 4.0, abs=0.11)
    assert left == FARTHEST_M  # grass is level: as far as the user looks
    assert edges.room(22.0, 4.5)[0] == pytest.approx(6.6 - 5.5, abs=0.11)
    assert PavementWidthScanner(GRID, RoutePolyline(straight_route(4.2))).room(10.0, 4.5)[1] == pytest.approx(
        0.2, abs=0.11
    )


def test_a_route_along_a_kerb_is_driven_aside_of_it_and_a_free_one_is_not():
    assert PavementWidthScanner(GRID, RoutePolyline(straight_route(4.4))).offset_at(10.0) == pytest.approx(
        0.26, abs=0.06
    )
    assert PavementWidthScanner(GRID, RoutePolyline(straight_route())).offset_at(10.0) == 0.0


def test_a_ramp_is_seen_before_it_and_a_level_way_has_none():
    edges = PavementWidthScanner(GRID, RoutePolyline(straight_route(4.6)))
    assert edges.slope_ahead(20.0, 4.0) == math.inf
    assert edges.slope_ahead(33.0, 4.0) == pytest.approx(3.5, abs=0.6)  # the kerb is lowered from 36.6 m on
    assert edges.slope_ahead(37.0, 4.0) == 0.0


def test_at_the_ends_of_a_route_there_is_an_answer():
    edges = PavementWidthScanner(GRID, RoutePolyline(straight_route(4.4)))
    assert all(np.isfinite(edges.offset_at(arc)) for arc in (-3.0, 0.0, 79.9, 80.0, 95.0))
    assert all(np.isfinite(edges.room(arc, 4.5)).all() for arc in (-3.0, 0.0, 79.9, 80.0, 95.0))


def test_between_two_edges_the_middle_is_held_and_no_step_is_left():
    aside = comfortable_offsets(np.array([[1.6, 1.6]] * 10 + [[1.0, 0.3]] * 4 + [[1.6, 1.6]] * 10))
    assert aside[11] == pytest.approx(0.35)
    smooth = smooth_offsets(aside)
    assert smooth[10:14] == pytest.approx([0.35] * 4)
    assert np.abs(np.diff(smooth)).max() < 0.1
    assert smooth[0] == smooth[-1] == 0.0


@pytest.mark.parametrize("rise_cm, is_edge", [(5, False), (6, True)])
def test_a_step_that_a_wheel_takes_is_no_edge(rise_cm, is_edge):
    grid = strip_street().grid
    height_cm = np.where(grid.height_cm > 6, rise_cm, 0).astype(np.uint8)
    plain = replace(grid, height_cm=height_cm, ground_class=np.full_like(grid.ground_class, ClassId.SIDEWALK))
    _, right_m = PavementWidthScanner(plain, RoutePolyline(straight_route(5.0))).room(5.0, 3.0)
    assert right_m == pytest.approx(1.0 if is_edge else FARTHEST_M, abs=0.11)
