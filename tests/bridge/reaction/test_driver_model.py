"""Each link of the driver model's chain alone: plain values in, plain values out, no SUMO."""

import math
from dataclasses import dataclass, replace

import pytest

from tests.bridge.reaction.roads import LANE_M, StraightRoads, actor, chair
from wcsim.bridge.reaction.commands import LET_GO
from wcsim.bridge.reaction.conflict import SweptOverlap, approach_mps
from wcsim.bridge.reaction.drivers import (
    _braking,
    _command,
    _conflict_pose,
    _considered,
    _DriverPlan,
    _Encounter,
    _free_lane,
    _junction_left_m,
    _narrow_gap_mps,
    _Passing,
    _passing_in_lane,
    _passing_mps,
    _perceive,
    _resumed_lane,
    _room_to_pass,
    _shift_mps,
    _Steering,
    _steering_out,
    _too_near_to_change_lanes,
    _waited,
    _WaitingTimes,
)
from wcsim.bridge.reaction.swept_path import Brakes, LaneShape, OnLane, _lay_out
from wcsim.types import ActorKind

FRONT = 6  # the pose of a vehicle's front; one at pose p touches after 0.5 (p - 7) m
BRAKE_MPS2, TICK_S = 2.7, 0.1
BRAKES = Brakes(service_mps2=4.5, emergency_mps2=9.0)


@dataclass
class Junction(StraightRoads):
    """The same lanes, inside a junction until x = 12 m."""

    def lanes_ahead(self, actor_id: str, ahead_m: float) -> tuple[str, ...]:
        index = self._index(actor_id)
        return f"E_{index}", f"F_{index}"

    def lane(self, lane_id: str) -> LaneShape:
        lane, inside = super().lane(lane_id), lane_id.startswith("E")
        points = lane.points_W_m.copy()
        points[:, 0] = (-100.0, 12.0) if inside else (12.0, 300.0)
        length_m = 112.0 if inside else 288.0
        return replace(lane, edge_id=lane_id[0], points_W_m=points, length_m=length_m, internal=inside)


def encounter(there=None, vehicle=None, roads=None, shared=False) -> _Encounter | None:
    """A car at 0, 10 m/s fast, and a chair 40 m ahead, unless told otherwise."""
    roads, vehicle = roads or StraightRoads(), vehicle or actor()
    there = there or chair(40.0)
    roads.put(vehicle)
    place = roads.on_lane(vehicle.id)
    tail_W_m = vehicle.p_W_m[:2] - (0.5 * vehicle.size_lwh_m[0], 0.0)
    lanes = [roads.lane(name) for name in roads.lanes_ahead(vehicle.id, 70.0)]
    tube = _lay_out(lanes, place.along_m, vehicle.size_lwh_m[0], tail_W_m, None)
    return _perceive(vehicle, place, replace(lanes[0], shared=shared), tube, there, there.row(), BRAKE_MPS2, TICK_S)


def at(*poses, left=0.0, speed=10.0, right_m=-0.31, left_m=0.31, on_road=True, **changes) -> _Encounter:
    """The usual encounter, with touches at these poses."""
    it = encounter(chair(9.0), actor(speed=speed))
    place = OnLane(lane_id="E_0", along_m=it.place.along_m, left_m=left)
    touch = SweptOverlap(at=poses, right_m=right_m, left_m=left_m)
    return it._replace(touch=touch, place=place, on_road=on_road, **changes)


def test_a_driver_perceives_only_chairs_near_its_way_and_on_the_pavement_only_those_in_reach():
    beside = {"x": 40.0, "y": -1.35}
    assert encounter(chair(40.0, 9.0)) is None
    assert encounter(chair(**beside, on_road=False)) is None
    assert encounter(chair(**beside, on_road=True)).on_road
    assert encounter(chair(**beside, on_road=False), shared=True).on_road
    assert not encounter(chair(40.0, on_road=False)).on_road
    assert encounter().check.speed_mps == 10.0


@pytest.mark.parametrize(
    "poses, expected", [((19, 17, -1), 17), ((19, FRONT + 2), FRONT + 2), ((19, FRONT + 1), 19), ((-1, 4), -1)]
)
def test_a_conflict_is_the_usual_gap_ahead_and_only_a_touch_alongside(poses, expected):
    assert _conflict_pose(at(*poses)) == expected


@pytest.mark.parametrize(
    "speed, distance_m, expected",
    [(0.0, 8.0, True), (0.0, 8.5, False), (10.0, 38.0, True), (10.0, 38.5, False), (14.0, 61.5, True)],
)
def test_no_change_of_lanes_begins_within_braking_distance_or_its_own_time(speed, distance_m, expected):
    it = at(-1, -1, 7 + round(2 * distance_m), speed=speed)
    assert _too_near_to_change_lanes(it) == expected
    assert not _too_near_to_change_lanes(it._replace(on_road=False))


def test_who_has_a_way_round_moves_over_first_and_drives_on_then():
    slower_mps = 10.0 - BRAKE_MPS2 * TICK_S
    ahead, alongside = at(-1, 30), at(-1, FRONT)
    assert _passing_mps(ahead, _Passing(), 7.0) == 7.0
    assert _passing_mps(ahead, _Passing(speed_mps=8.0), 7.0) == 8.0
    assert _passing_mps(ahead, _Passing(speed_mps=2.0, aside_m=-0.5), 12.0) == slower_mps
    assert _passing_mps(ahead, _Passing(speed_mps=2.0, aside_m=0.04), 12.0) == 12.0
    assert _passing_mps(ahead, _Passing(speed_mps=0.0, aside_m=0.5), 12.0) == 12.0
    assert _passing_mps(alongside, _Passing(speed_mps=2.0, aside_m=0.5), 12.0) == 12.0


def test_room_is_beside_the_chair_where_the_lane_is_divided_else_in_the_next_lane():
    two, no_sublanes = StraightRoads(lanes=2), StraightRoads(lanes=2, sublanes=False)
    aside = encounter(chair(40.0, 1.29), roads=two)
    within = _room_to_pass(aside, 30.0, two)
    assert within.aside_m < -0.3 and within.lane_index is None and within.speed_mps > 0.0
    no_sublanes.put(aside.check.actor)
    assert _room_to_pass(aside, 30.0, no_sublanes) == _Passing(lane_index=1)
    middle = encounter(chair(40.0), roads=two)
    assert _room_to_pass(middle, 30.0, two) == _Passing(lane_index=1)
    one = StraightRoads()
    assert not _room_to_pass(encounter(chair(40.0), roads=one), 30.0, one).possible


def test_nobody_passes_on_rails_round_a_chair_that_crosses_from_a_junction_or_between_two_lanes():
    roads = StraightRoads(lanes=2)
    tram = encounter(chair(40.0, 1.29), actor(ActorKind.TRAM), roads)
    crossing = encounter(chair(40.0, vy=0.5), roads=roads)
    straddling = encounter(vehicle=actor(y=0.9), roads=roads)
    usual = encounter(roads=roads)
    inside = usual._replace(here=replace(usual.here, internal=True))
    elsewhere = usual._replace(here=replace(usual.here, edge_id="D"))
    assert usual.straddles is False and straddling.straddles
    assert _room_to_pass(usual, 30.0, roads).possible
    for it in (tram, crossing, straddling, inside, elsewhere):
        assert not _room_to_pass(it, 30.0, roads).possible


def test_the_lane_beside_must_lead_on_beyond_the_chair():
    asked = []

    class Asked(StraightRoads):
        def lanes_beside(self, actor_id: str, ahead_m: float) -> tuple[int, ...]:
            asked.append(ahead_m)
            return ()

    roads = Asked(lanes=2, sublanes=False)
    assert _room_to_pass(encounter(roads=roads), 30.0, roads) == _Passing()
    assert asked == [30.0 + 2.0 * (2.0 + 4.5)]


def test_a_place_in_the_lane_that_is_too_narrow_or_too_near_to_reach_is_none():
    it = encounter(chair(40.0, 1.29))
    assert _passing_in_lane(it, 30.0, LANE_M).aside_m == pytest.approx(-0.41, abs=0.3)
    assert _passing_in_lane(it, 30.0, 2.6) is None
    left_m = _passing_in_lane(it, 30.0, LANE_M).aside_m
    there = it._replace(place=replace(it.place, left_m=left_m))
    assert _passing_in_lane(there, 30.0, LANE_M).aside_m == 0.0
    touching = there._replace(touch=replace(there.touch, at=(7, *there.touch.at[1:])))
    assert _passing_in_lane(touching, 30.0, LANE_M) is None
    assert _passing_in_lane(touching._replace(place=it.place), 30.0, LANE_M) is not None
    turns_there = encounter()._replace(touch=it.touch)  # its straight body touches all the same, though far ahead
    assert _passing_in_lane(turns_there, 30.0, LANE_M) is None


@pytest.mark.parametrize(
    "aside_m, distance_m, expected",
    [(0.0, 0.0, 1.0), (0.06, 0.6, 0.2), (0.06, 0.5, 0.0), (-0.8, 17.0, 8.0), (0.8, 17.0, 8.0), (0.04, 22.0, 29.09)],
)
def test_a_vehicle_is_so_fast_that_it_has_moved_over_in_time(aside_m, distance_m, expected):
    assert _shift_mps(aside_m, distance_m) == pytest.approx(expected, abs=0.01)


def test_the_next_lane_is_free_where_the_chair_does_not_reach_into_it():
    assert _free_lane(at(9, 9), (1, -1)) == 1
    assert _free_lane(at(9, 9, right_m=1.0, left_m=1.91), (1, -1)) == -1
    assert _free_lane(at(9, 9, right_m=1.0, left_m=1.89), (1,)) == 1  # 1.31 m off that lane's middle
    assert _free_lane(at(9, 9, right_m=1.0, left_m=1.91), (1,)) is None
    assert _free_lane(at(9, 9), ()) is None


def test_a_junction_is_left_only_towards_a_chair_behind_it():
    it = encounter(chair(40.0), actor(x=0.0), Junction())
    assert _junction_left_m(it, Junction()) == pytest.approx(12.0 + 0.5 - 2.25)
    assert _junction_left_m(encounter(chair(8.0), actor(x=0.0), Junction()), Junction()) == 0.0
    assert _junction_left_m(encounter(), StraightRoads()) == 0.0
    assert _junction_left_m(it._replace(here=replace(it.here, internal=False)), Junction()) == 0.0


@pytest.mark.parametrize(
    "left, toward, expected",
    [(0.9, ("E", 1), 1), (0.9, None, None), (0.9, ("F", 1), None), (0.4, ("E", 1), None), (-0.9, ("E", 1), None)],
)
def test_who_is_half_way_into_a_lane_is_told_again(left, toward, expected):
    assert _resumed_lane(at(30, 29, left=left), toward) == expected


def test_room_to_steer_out_is_kept_by_who_changes_lanes_straddles_or_leaves_a_junction():
    it, kept_mps = at(-1, 47), approach_mps(20.0 - 2.0 - 4.5, BRAKE_MPS2, TICK_S)
    straddling = at(-1, 47, left=0.9)
    assert _steering_out(it, _DriverPlan(), _Passing(), 20.0, 0.0) == _Steering()
    changes = _steering_out(it, _DriverPlan(), _Passing(lane_index=1), 20.0, 0.0)
    assert changes == _Steering(lane_index=1, limit_mps=kept_mps)
    assert _steering_out(it, _DriverPlan(lane_index=2), _Passing(), 20.0, 0.0).lane_index == 2
    assert _steering_out(it, _DriverPlan(lane_index=2), _Passing(lane_index=1), 20.0, 0.0).lane_index == 1
    assert _steering_out(straddling, _DriverPlan(), _Passing(), 20.0, 0.0) == _Steering(limit_mps=kept_mps)
    assert _steering_out(straddling, _DriverPlan(), _Passing(speed_mps=1.0), 20.0, 0.0) == _Steering()
    assert _steering_out(at(30, FRONT, left=0.9), _DriverPlan(), _Passing(), 20.0, 0.0) == _Steering()
    leaves = _steering_out(it, _DriverPlan(), _Passing(), 20.0, 15.0)
    assert leaves == _Steering(limit_mps=approach_mps(15.0, BRAKE_MPS2, TICK_S))
    half_way = _DriverPlan(toward=("E", 1))
    again = _steering_out(straddling, half_way, _Passing(), 20.0, 0.0)
    assert again == _Steering(lane_index=1, limit_mps=kept_mps, resumed=True)
    assert not _steering_out(straddling, half_way._replace(lane_index=1), _Passing(), 20.0, 0.0).resumed


def test_a_narrow_gap_is_driven_slowly_where_the_front_half_clears():
    assert _narrow_gap_mps(at(-1, 12), 12) == 0.8
    assert _narrow_gap_mps(at(12 + 5, 12), 12) == pytest.approx(0.8)
    assert _narrow_gap_mps(at(12 + 4, 12), 12) is None
    assert _narrow_gap_mps(at(8, 3), 3) == 0.0  # its tail would touch at once
    assert _narrow_gap_mps(at(-1, 12, on_road=False), 12) is None
    crossing = encounter(chair(40.0, vy=0.5))
    assert _narrow_gap_mps(crossing._replace(touch=at(-1, 12).touch), 12) is None


def test_the_least_speed_over_all_chairs_holds_and_a_way_round_keeps_the_lane():
    roads = StraightRoads(lanes=2)
    near, far = encounter(chair(30.0), roads=roads), encounter(chair(55.0), roads=roads)
    one = _considered(_DriverPlan(), near, roads, impatient=False)
    both = _considered(one, far, roads, impatient=False)
    other = _considered(_considered(_DriverPlan(), far, roads, impatient=False), near, roads, impatient=False)
    assert _considered(_DriverPlan(), far, roads, impatient=False).stay_in_lane and not _too_near_to_change_lanes(far)
    assert one.lane_index == 1 and one.could_pass and one.stay_in_lane and one.toward == ("E", 1)
    assert both == other and both.limit_mps == one.limit_mps and both.nearest_m == one.nearest_m < math.inf
    beside = _considered(_DriverPlan(), encounter(chair(30.0, 2.3), roads=roads), roads, impatient=False)
    assert beside.nearest_m == math.inf and beside.limit_mps < 20.0  # passes it, but not fast
    assert beside.stay_in_lane and not beside.could_pass


def test_an_impatient_driver_takes_the_gap_that_just_clears_in_its_own_line():
    roads = StraightRoads(sublanes=False)
    it = encounter(chair(4.5, 1.45), actor(speed=0.0), roads)
    patient, impatient = (_considered(_DriverPlan(aside_m=0.3), it, roads, impatient=is_so) for is_so in (False, True))
    assert patient.limit_mps < 0.8 and patient.aside_m == 0.3
    assert (impatient.limit_mps, impatient.aside_m, impatient.lane_index) == (0.8, 0.0, None)


@pytest.mark.parametrize(
    "limit, nearest, speed, stands_s",
    [(0.0, 5.9, 0.0, 1.1), (0.21, 5.9, 0.0, 0.0), (0.0, 6.0, 0.0, 0.0), (0.0, 5.9, 0.1, 0.0)],
)
def test_only_who_stands_near_a_chair_because_of_it_is_counted_as_standing(limit, nearest, speed, stands_s):
    plan = _DriverPlan(limit_mps=limit, nearest_m=nearest)
    assert _waited(_WaitingTimes(stands_s=1.0), plan, speed, 0.1).stands_s == pytest.approx(stands_s)


def test_waiting_for_a_way_round_makes_pushy_and_standing_makes_ready_to_squeeze():
    there_is_one, stands = _DriverPlan(could_pass=True), _DriverPlan(limit_mps=0.0, nearest_m=1.0)
    waits = _waited(_WaitingTimes(waits_s=8.0), there_is_one, 0.9, 0.1)
    assert waits.pushy and not _WaitingTimes(waits_s=8.0).pushy
    assert _waited(waits, there_is_one, 1.0, 0.1).waits_s == 0.0
    assert _waited(waits, _DriverPlan(), 0.0, 0.1).waits_s == 0.0
    assert not _waited(_WaitingTimes(stands_s=7.8), stands, 0.0, 0.1).squeezes
    squeezes = _waited(_WaitingTimes(stands_s=8.0), stands, 0.0, 0.1)
    assert squeezes.squeezes and _waited(squeezes, there_is_one, 5.0, 0.1).squeezes


def test_the_service_brake_is_exceeded_only_where_it_does_not_do():
    def ordered(limit, nearest, speed, brakes=BRAKES):
        return _braking(_DriverPlan(limit_mps=limit, nearest_m=nearest), speed, 13.9, brakes, TICK_S)

    assert ordered(13.9, 3.0, 10.0) == (LET_GO, False)
    assert ordered(9.0, math.inf, 10.0) == (9.0, False)
    assert ordered(9.0, 11.7, 10.0) == (9.0, False)
    assert ordered(9.0, 11.5, 10.0) == (pytest.approx(9.1), True)
    assert ordered(0.0, 0.0, 0.7) == (0.0, True)
    weak = replace(BRAKES, service_mps2=2.0)
    assert [ordered(0.0, 0.0, speed, weak) for speed in (0.5, 0.51)] == [(0.0, False), (0.0, True)]
    assert ordered(9.5, 11.5, 10.0) == (9.5, True)
    assert ordered(2.0, 3.0, 10.0, replace(BRAKES, emergency_mps2=math.inf)) == (2.0, True)


def test_a_command_is_given_only_where_sumo_would_do_something_else():
    def told(plan, speed=(LET_GO, False), moved_over=False):
        return _command("v:car", plan, speed, False, moved_over)

    assert told(_DriverPlan()) is None
    assert told(_DriverPlan(), (3.0, True)).hard
    assert told(_DriverPlan(stay_in_lane=True)).stay_in_lane
    assert told(_DriverPlan(lane_index=0)).lane_index == 0
    assert told(_DriverPlan(aside_m=0.3)).aside_m == 0.3
    assert told(_DriverPlan(aside_m=0.01)).aside_m is None
    assert told(_DriverPlan(aside_m=0.01), moved_over=True).aside_m == 0.0
    assert told(_DriverPlan(lane_index=1), moved_over=True).aside_m is None
    assert _command("v:car", _DriverPlan(stay_in_lane=True), (LET_GO, False), True, False).pushy
