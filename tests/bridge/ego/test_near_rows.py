"""The rows of the observation `state`, in a street whose every edge and wall is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.actors import actor
from tests.support.samples import straight_route, strip_street
from tests.users.kinematics import plant
from wcsim.bridge.ego.near_rows import OWN, SOLID, STEP_DOWN, STEP_UP, WAY, WAY_ON_ROAD, near_rows
from wcsim.supervisor.observation import EDGE_ROW, OTHERS_ROW, SOLID_ROW, WAY_AHEAD_M, WAY_ROW
from wcsim.types import F64, ActorKind, ActorState, Joystick

GRID = strip_street().grid
ROUTE = straight_route(5.5)


def car(x: float, y: float, yaw: float = 0.0, speed: float = 3.0, name: str = "v:1") -> ActorState:
    return actor(ActorKind.CAR, x, y, yaw, speed, name, (4.0, 2.0, 1.5))


def rows_at(x: float, y: float, yaw: float = 0.0, others: tuple[ActorState, ...] = (), route=ROUTE) -> F64:
    chair = plant(x, y, yaw, 1.2, 0.3)
    return near_rows(chair, Joystick(0.2, 0.7), route, x, GRID, others)


def test_the_first_row_is_of_the_chair_itself():
    np.testing.assert_allclose(rows_at(10.0, 5.5)[0], [OWN, 0.2, 0.7, 1.2, 0.0, 0.3, 0.0, 0.0, 70.0], atol=1e-9)


def test_the_way_ahead_ends_at_the_destination():
    way = rows_at(10.0, 5.0)[WAY_ROW:SOLID_ROW]
    np.testing.assert_allclose(way[:, 1:3], [(metres, 0.5) for metres in WAY_AHEAD_M], atol=1e-9)
    np.testing.assert_allclose(way[:, 5:7], [(1.0, 0.0)] * len(WAY_AHEAD_M))
    assert set(way[:, 0]) == {WAY}
    assert set(rows_at(30.0, 5.5, route=straight_route(2.0))[WAY_ROW:SOLID_ROW, 0]) == {WAY_ON_ROAD}
    end = rows_at(75.0, 5.5)[WAY_ROW:SOLID_ROW]
    assert end[-1, 1] == end[-2, 1] == pytest.approx(5.0)


@pytest.mark.parametrize("y, kind, side", [(5.5, STEP_DOWN, -1.5), (2.5, STEP_UP, 1.5)])
@pytest.mark.parametrize("yaw", [0.0, math.pi])
def test_the_kerb_is_a_step_down_from_the_pavement_and_up_from_the_road(y, kind, side, yaw):
    """From the pavement at y = 5.5 the kerb at y = 4 is to the right of who heads east."""
    nearest = rows_at(10.0, y, yaw)[EDGE_ROW]
    assert nearest[0] == kind
    assert nearest[2] == pytest.approx(side * math.cos(yaw), abs=0.06)


def test_a_pole_is_in_two_sectors_at_most():
    pole = rows_at(24.0, 5.5)[SOLID_ROW:EDGE_ROW]
    assert pole[0, 0] == SOLID
    np.testing.assert_allclose(pole[0, 1:3], [1.05, 1.15], atol=0.15)
    assert not pole[2:].any()


@given(x=st.floats(5.0, 70.0), y=st.floats(2.0, 7.0), yaw=st.floats(-3.0, 3.0))
def test_what_stands_is_sorted_and_as_far_whichever_way_the_chair_looks(x, y, yaw):
    far = []
    for block in (slice(SOLID_ROW, EDGE_ROW), slice(EDGE_ROW, OTHERS_ROW)):
        for rows in (rows_at(x, y)[block], rows_at(x, y, yaw)[block]):
            far_m = np.hypot(rows[:, 1], rows[:, 2])[rows[:, 0] > 0]
            assert (np.diff(far_m) >= -1e-9).all()
            far.append(far_m[:1])
    np.testing.assert_allclose(far[0], far[1])
    np.testing.assert_allclose(far[2], far[3])


def test_road_users_are_told_as_the_chair_sees_them_and_not_those_on_a_bridge():
    above = replace(car(12.0, 8.0, name="v:2"), p_W_m=np.array([12.0, 8.0, 6.0]))
    rows = rows_at(10.0, 5.5, 0.5 * math.pi, (car(30.0, 0.0, name="v:3"), above, car(14.0, 2.5, math.pi, 2.0)))
    np.testing.assert_allclose(rows[OTHERS_ROW], [7.0, -3.0, -4.0, 0.0, 2.0, 0.0, 1.0, 4.0, 2.0], atol=1e-9)
    assert rows[OTHERS_ROW + 1, 2] == pytest.approx(-20.0)
    assert not rows[OTHERS_ROW + 2 :].any()
