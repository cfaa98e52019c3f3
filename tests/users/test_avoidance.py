"""Lanes around things, speeds in front of them, and the room that a street leaves."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.samples import straight_route
from wcsim.users.avoidance import PredictedChairPose, choose_lateral_offset
from wcsim.users.perception import DetectedObject
from wcsim.users.route_line import RoutePolyline

PATH = RoutePolyline(straight_route())
BODY = PredictedChairPose(x_m=10.0, y_m=5.5, yaw_rad=0.0, speed_mps=1.3, arc_m=10.0, left_m=0.0, half_m=(0.57, 0.31))
LANES = st.tuples(st.floats(-3, 3), st.floats(0.05, 3)).map(lambda t: (t[0], t[0] + t[1]))


def thing(ahead, left, vx=0.0, vy=0.0, radius=0.2) -> DetectedObject:
    return DetectedObject(x_m=10.0 + ahead, y_m=5.5 + left, radius_m=radius, vx_mps=vx, vy_mps=vy)


def lanes(*things):
    return BODY.blocked_lanes(PATH, things, 1.3)


def test_a_post_blocks_its_own_width_and_the_chairs():
    ((low, high),) = lanes(thing(3.0, 0.1))
    assert (low + high) / 2 == pytest.approx(0.1)
    assert high - low == pytest.approx(2 * (0.2 + 0.31 + 0.2))


def test_a_wider_chair_stays_farther_away_and_a_longer_one_stops_earlier():
    wide, long = replace(BODY, half_m=(0.57, 0.41)), replace(BODY, half_m=(0.77, 0.31))
    (usual,), (wider,) = (body.blocked_lanes(PATH, [thing(3.0, 0.1)], 1.3) for body in (BODY, wide))
    assert wider == pytest.approx((usual[0] - 0.1, usual[1] + 0.1))
    usual_mps, longer_mps = (body.safe_speed([thing(3.0, 0.0)], 0.8, 0.3) for body in (BODY, long))
    assert usual_mps**2 - longer_mps**2 == pytest.approx(2 * 0.8 * 0.2)


@pytest.mark.parametrize(
    "harmless",
    [
        thing(5.0, 0.0),  # too far yet
        thing(-2.0, 0.0),  # passed
        thing(3.0, 0.0, vx=1.3),  # as fast as the chair
        thing(8.0, 0.0, vx=1.0),  # met only later
        thing(3.0, 0.0, vy=8.0),  # a car that crosses
    ],
)
def test_what_needs_no_lane(harmless):
    assert lanes(harmless) == []


def test_people_that_walk_across_are_met_elsewhere():
    ((low, high),) = lanes(thing(3.0, -1.0, vy=0.6))
    assert -1.0 < (low + high) / 2 < 0.5


@given(st.lists(LANES, max_size=5), st.floats(0, 1.5), st.floats(0, 1.5), st.floats(-1, 1))
def test_a_chosen_lane_is_free_and_within_the_room(blocked, left, right, before):
    chosen = choose_lateral_offset(blocked, (left, right), before)
    if chosen is None:
        assert any(low < 0 < high for low, high in blocked)
    else:
        assert -right <= chosen <= left
        assert not any(low < chosen < high for low, high in blocked)


def test_the_last_side_is_held():
    blocked = [(-0.5, 0.5)]
    assert choose_lateral_offset(blocked, (1.0, 1.0), 0.5) == 0.5
    assert choose_lateral_offset(blocked, (1.0, 1.0), -0.5) == -0.5


def test_speed_in_front_of_things():
    def limit(*things):
        return BODY.safe_speed(things, 0.6, 0.25)

    assert limit() == math.inf
    assert limit(thing(5.0, 1.0)) == math.inf  # beside the way
    assert limit(thing(-3.0, 0.0)) == math.inf
    assert limit(thing(1.0, 0.0)) == 0.0
    distances = [limit(thing(ahead, 0.0)) for ahead in (1.5, 2.0, 3.0, 4.0)]
    assert distances == sorted(distances)
    assert limit(thing(1.0, 0.0, vx=0.8)) == pytest.approx(0.8)  # follows who walks ahead
    assert limit(thing(3.0, 0.0, vx=-1.3)) < limit(thing(3.0, 0.0))
    assert limit(thing(2.0, -0.8, vy=1.0)) < 1.0  # who steps in from the side in a moment
