import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.bridge.reaction.roads import LEFT_TURN
from tests.bridge.reaction.roads import lane_shape as lane
from wcsim.bridge.reaction.conflict import ROOM_M, SweptOverlap, _first_touches
from wcsim.bridge.reaction.pedestrians import _Block, _block_around, _block_around_disc, _ways_round
from wcsim.bridge.reaction.swept_path import STEP_M, OnLane, _lay_out
from wcsim.core.boxes import boxes_touch, gap_to_box

GAPS_M = np.array([0.1, 0.4, 3.0])


def straight_tube(length_m=4.5):
    way = lane("a_0", [(0.0, 0.0), (100.0, 0.0)])
    return _lay_out([way], 10.0, length_m, np.array([10.0 - length_m, 0.0]), None)


def look(tube, x, y, vx=0.0, vy=0.0, left_m=0.0, skew=0.0, speed=10.0, length_m=4.5):
    now = (10.0 - tube.first_m) / STEP_M
    row = np.array([x, y, 1.0, 0.0, 0.57, 0.31, vx, vy])
    body = 0.5 * length_m, 0.9, left_m, skew
    return _first_touches(tube.poses, (int(now), len(tube.poses)), body, GAPS_M, row, (now, STEP_M / speed))


def test_a_straight_way_touches_where_the_front_meets_the_chair():
    tube = straight_tube()
    touch = look(tube, 40.0, 0.0)
    assert tube.first_m + touch.at[0] * STEP_M == pytest.approx(40.0 - 0.57, abs=STEP_M)
    assert (touch.right_m, touch.left_m) == pytest.approx((-0.31, 0.31))
    assert look(tube, 40.0, 1.4).at[0] == -1
    assert look(tube, 40.0, 1.4).at[1] > 0
    assert look(tube, 40.0, 1.4, left_m=-0.5).at[1] == -1
    assert look(tube, 5.0, 9.0).at == (-1, -1, -1)


@given(st.floats(-2.0, 2.0), st.floats(-1.0, 1.0))
def test_touches_come_in_the_order_of_their_gaps(y, left_m):
    at = look(straight_tube(), 40.0, y, left_m=left_m).at
    found = [pose for pose in at if pose >= 0]
    assert found == sorted(found, reverse=True)
    assert at[0] < 0 or at[1] >= 0


def test_a_tail_that_lags_behind_in_a_change_of_lanes_touches_until_it_is_in_line_again():
    tube, beside = straight_tube(9.5), (16.0, 1.7)  # clear of the straight body
    assert look(tube, *beside, length_m=9.5).at[0] == -1
    assert look(tube, *beside, skew=-0.3, length_m=9.5).at[0] > 0
    assert look(tube, 70.0, 1.7, skew=-0.3, length_m=9.5).at[0] == -1


def test_a_chair_that_crosses_late_is_passed_and_one_that_crosses_in_time_is_not():
    tube = straight_tube()
    assert look(tube, 14.0, -5.0, vy=1.2).at[0] == -1
    crossing = look(tube, 30.0, -3.0, vy=1.2)
    assert crossing.at[0] > 0
    assert tube.first_m + crossing.at[0] * STEP_M < 30.0  # stops before its place, not beside it


def test_room_is_found_where_it_is_and_the_nearest_way_first():
    assert SweptOverlap(at=(9, 9), right_m=-0.31, left_m=0.31).room(1.8, 3.2) == ()
    (left,) = SweptOverlap(at=(9, 9), right_m=-1.6, left_m=-0.98).room(1.8, 3.2)
    assert left - 0.9 - -0.98 >= 0.5
    assert left + 0.9 <= 1.6
    both = SweptOverlap(at=(9, 9), right_m=-0.2, left_m=0.42).room(0.6, 4.0)
    assert len(both) == 2
    assert abs(both[0]) <= abs(both[1])


@given(st.floats(-1.5, 1.5), st.floats(0.5, 2.6))
def test_who_has_room_keeps_a_gap_and_stays_in_its_lane(middle, width):
    touch = SweptOverlap(at=(9, 9), right_m=middle - 0.31, left_m=middle + 0.31)
    for place in touch.room(width, 3.2):
        gap = max(place - 0.5 * width - touch.left_m, touch.right_m - place - 0.5 * width)
        assert gap >= ROOM_M - 0.1 - 1e-9
        assert abs(place) + 0.5 * width <= 1.6 - 0.1 + 1e-9


def test_a_long_vehicle_cuts_the_corner_and_a_short_one_hardly():
    way = lane("a_0", [(-50.0, 0.0), *LEFT_TURN, (10.0, 60.0)])
    inward = []
    for length_m in (4.0, 12.0):
        tube = _lay_out([way], 45.0, length_m, np.array([45.0 - 50.0 - length_m, 0.0]), None)
        from_centre = np.hypot(tube.poses[:, 0], tube.poses[:, 1] - 10.0)
        inward.append(10.0 - from_centre.min())
    assert inward[0] < 0.3
    assert 1.2 < inward[1] < 2.6


def test_the_way_goes_on_over_the_next_lanes_and_remembers_the_last():
    first, second = lane("a_0", [(0, 0), (50, 0)], length_m=100.0), lane("b_0", [(52, 0), (90, 0)])
    tube = _lay_out([first, second], 80.0, 4.0, np.array([36.0, 0.0]), None)
    assert tube.front_m(OnLane(lane_id="a_0", along_m=80.0, left_m=0.0)) == pytest.approx(40.0)
    assert tube.front_m(OnLane(lane_id="b_0", along_m=3.0, left_m=0.0)) == pytest.approx(55.0)
    assert [tube.lane_at(m) for m in (10.0, 60.0)] == ["a_0", "b_0"]
    later = _lay_out([second], 3.0, 12.0, np.array([43.0, 0.0]), tube)
    assert later.points_W_m[:, 0].min() < 50.0


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3.2, 3.2), st.floats(-3.2, 3.2))
def test_boxes_touch_whichever_of_them_is_asked(x, y, turn, other_turn):
    a = (0.0, 0.0, math.cos(turn), math.sin(turn), 1.2, 0.4)
    b = (x, y, math.cos(other_turn), math.sin(other_turn), 0.6, 0.3)
    assert boxes_touch(*a, *b) == boxes_touch(*b, *a)
    if gap_to_box(x, y, *a) < 0.3:
        assert boxes_touch(*a, *b)
    if gap_to_box(x, y, *a) > math.hypot(0.6, 0.3):
        assert not boxes_touch(*a, *b)


def test_the_way_round_is_the_shorter_one_and_none_leads_through_a_block():
    chair_like = _block_around(0.0, 0.0, 1.0, 0.0, (3.0, 0.2, 1.0, 0.0, 0.57, 0.31), 0.5, 0.4)
    assert chair_like.near_m == pytest.approx(3.0 - 0.97)
    first = next(iter(_ways_round([chair_like], 0.0)))
    assert first == pytest.approx(0.2 - 0.81)
    wall = _Block(near_m=1.0, far_m=2.0, right_m=-5.0, left_m=-0.3)
    assert next(iter(_ways_round([chair_like, wall], 0.0))) == pytest.approx(0.2 + 0.81)
    assert next(iter(_ways_round([], 0.7))) == 0.0


def test_nobody_steps_through_what_is_beside():
    beside = _Block(near_m=-0.9, far_m=0.9, right_m=-0.6, left_m=0.8)
    assert set(_ways_round([beside], 0.9)) == {0.8, 0.9}
    ahead = _Block(near_m=0.5, far_m=2.3, right_m=-0.6, left_m=0.8)
    assert -0.6 in _ways_round([ahead], 0.9)


def test_of_somebody_half_behind_only_the_part_beside_counts():
    behind, ahead = _block_around_disc(-0.3, 0.6, 0.5), _block_around_disc(0.3, 0.6, 0.5)
    assert behind.right_m == pytest.approx(0.6 - 0.4)
    assert ahead.right_m == pytest.approx(0.1)
    assert behind.far_m == pytest.approx(0.2)
