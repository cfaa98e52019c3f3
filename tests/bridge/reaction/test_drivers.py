import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.bridge.reaction.roads import LANE_M, LEFT_TURN, StraightRoads, actor, chair, lane_shape, walker
from wcsim.bridge.reaction.attention import Attention, AttentionModel
from wcsim.bridge.reaction.commands import LET_GO
from wcsim.bridge.reaction.drivers import StreetReaction
from wcsim.bridge.reaction.swept_path import LaneShape
from wcsim.config import WorldConfig
from wcsim.types import ActorKind


def street(reaction_s=0.0, share=1.0, seed=1) -> StreetReaction:
    config = WorldConfig(reaction_s=reaction_s, attention_share=share)
    return StreetReaction(config, AttentionModel(config, seed))


def order_for(vehicle, chairs, roads=None, reaction=None):
    roads = roads or StraightRoads()
    orders = (reaction or street()).react(roads.put(vehicle), chairs, roads)
    return orders[0] if orders else None


def drive(vehicle, chairs, roads, seconds=30.0, reaction=None):
    """Let one vehicle obey along its lane; its x, y and speed at every tick."""
    reaction, track = reaction or street(reaction_s=0.7), []
    x, y, v = float(vehicle.p_W_m[0]), float(vehicle.p_W_m[1]), float(vehicle.v_W_mps[0])
    for _ in range(round(seconds / 0.1)):
        now = actor(vehicle.kind, x=x, y=y, speed=v, size=vehicle.size_lwh_m)
        order = order_for(now, chairs, roads, reaction)
        wanted = 13.9 if order is None or order.speed_mps == LET_GO else order.speed_mps
        brakes = roads.brakes(now.id)
        hardest = v if order is not None and order.hard else brakes.service_mps2 * 0.1
        v = min(max(wanted, v - hardest), v + 0.26)
        if order is not None and order.aside_m is not None:
            y += math.copysign(min(abs(order.aside_m), 0.08), order.aside_m)
        if order is not None and order.lane_index is not None:
            y = order.lane_index * LANE_M  # as SUMO does without sublanes
        x += 0.1 * v
        track.append((x, y, v))
    return track


@settings(max_examples=15)
@given(st.floats(0.5, 16.0), st.floats(45.0, 60.0), st.floats(-0.3, 0.3))
def test_a_car_stops_short_of_a_chair_that_fills_its_lane(speed, x, y):
    track = drive(actor(speed=speed), (chair(x, y),), StraightRoads())
    assert 0.3 < x - 0.57 - (track[-1][0] + 2.25) < 3.0
    assert track[-1][2] == pytest.approx(0.0, abs=0.05)


def test_nobody_brakes_for_a_chair_behind_beside_or_far_away():
    for there in (chair(-6.0), chair(12.0, 9.0), chair(300.0)):
        assert order_for(actor(), (there,)) is None


def test_a_chair_that_rolls_into_the_lane_counts_before_it_is_there():
    still, rolling = chair(25.0, -4.0), chair(25.0, -4.0, vy=1.5)
    assert order_for(actor(), (still,)).speed_mps == LET_GO  # it only keeps to its lane
    assert 0.0 <= order_for(actor(), (rolling,)).speed_mps < 13.0


def test_who_passes_before_the_chair_comes_does_not_stop_in_its_way():
    order = order_for(actor(x=-3.0, speed=12.0), (chair(4.0, -4.5, vy=1.2),))
    assert order is None or order.speed_mps == LET_GO or order.speed_mps > 8.0


def test_a_chair_on_the_pavement_beside_the_lane_does_not_stop_the_traffic():
    near = 1.35  # its side 0.14 m beside the car
    assert order_for(actor(), (chair(18.0, -near, on_road=False),)) is None
    assert order_for(actor(), (chair(18.0, -near, on_road=True),)).speed_mps < 10.0


def test_the_order_comes_after_the_reaction_time_and_everything_is_given_back_once():
    reaction, roads = street(reaction_s=0.3), StraightRoads()
    seen = [order_for(actor(), (chair(15.0),), roads, reaction) for _ in range(4)]
    assert [order is not None for order in seen] == [False, False, True, True]
    back = order_for(actor(), (chair(15.0, 30.0),), roads, reaction)
    assert back.speed_mps == LET_GO
    assert not back.stay_in_lane
    assert order_for(actor(), (chair(15.0, 30.0),), roads, reaction) is None


def test_who_was_held_is_let_go_when_the_chair_is_respawned_elsewhere():
    reaction, roads = street(), StraightRoads()
    assert order_for(actor(), (chair(12.0),), roads, reaction).speed_mps >= 0.0
    assert [order.speed_mps for order in reaction.react((), (chair(900.0),), roads)] == [LET_GO]
    assert reaction.react((), (chair(900.0),), roads) == ()


def test_attention_is_a_property_of_the_actor_and_of_the_seed():
    names = [f"v:{i}" for i in range(200)]
    seen = {name for name in names if Attention(0.5, 3).looks(name)}
    again = {name for name in reversed(names) if Attention(0.5, 3).looks(name)}
    other = {name for name in names if Attention(0.5, 4).looks(name)}
    assert seen == again != other
    assert 60 < len(seen) < 140
    assert order_for(actor(), (chair(8.0),), reaction=street(share=0.0)) is None


def test_persons_and_rear_pieces_are_not_steered_as_vehicles():
    roads = StraightRoads()
    tram = actor(ActorKind.TRAM, name="v:tram", size=(8.7, 2.4, 3.5))
    rear = actor(ActorKind.TRAM, x=-9.0, name="v:tram~1", size=(8.7, 2.4, 3.5), piece=1)
    orders = street().react(roads.put(walker(5.0, 0.0), tram, rear), (chair(20.0),), roads)
    assert [order.actor_id for order in orders] == ["v:tram"]


def test_a_bicycle_brakes_earlier_than_a_car():
    for name, kind, size in (("car", ActorKind.CAR, (4.5, 1.8, 1.5)), ("bike", ActorKind.BICYCLE, (1.7, 1.8, 1.7))):
        front_at_zero = actor(kind, x=-0.5 * size[0], speed=8.0, size=size)
        limit = order_for(front_at_zero, (chair(14.0),)).speed_mps
        if name == "car":
            car_limit = limit
    assert limit < car_limit


def test_an_emergency_brake_goes_beyond_the_service_brake_and_no_further_than_the_vehicle_can():
    order = order_for(actor(speed=10.0), (chair(11.0),))
    assert order.hard
    assert 10.0 - 0.9 - 1e-9 <= order.speed_mps < 10.0 - 0.45


def test_a_car_moves_over_where_there_is_room_and_drives_on_past_the_chair():
    for sign in (1, -1):
        track = drive(actor(speed=10.0), (chair(60.0, sign * 1.29),), StraightRoads())
        beside = [y for x, y, _ in track if abs(x - 60.0) < 2.5]
        assert beside
        assert max(sign * y for y in beside) + 0.9 < 1.29 - 0.31 - 0.3
        assert track[-1][0] > 75.0


def test_without_sublanes_or_room_it_waits_or_takes_the_next_lane():
    stuck = drive(actor(speed=10.0), (chair(60.0, 0.0),), StraightRoads(sublanes=False))
    assert stuck[-1][0] < 57.5
    track = drive(actor(speed=10.0), (chair(60.0, 0.0),), StraightRoads(lanes=2, sublanes=False))
    assert track[-1][0] > 75.0
    assert track[-1][1] > 0.5 * LANE_M


def test_a_tram_never_leaves_its_track():
    tram = actor(ActorKind.TRAM, speed=8.0, size=(8.7, 2.4, 3.5))
    order = order_for(tram, (chair(25.0, 1.29),), StraightRoads(lanes=2))
    assert order.lane_index is None
    assert order.aside_m is None
    assert order.speed_mps >= 0.0


def test_a_chair_that_rolls_along_the_lane_is_followed_and_not_hit():
    reaction, roads = street(reaction_s=0.7), StraightRoads()
    x, v, ahead = 0.0, 12.0, 40.0
    for _ in range(400):
        order = order_for(actor(x=x, speed=v), (chair(ahead, vx=1.67),), roads, reaction)
        wanted = 13.9 if order is None or order.speed_mps == LET_GO else order.speed_mps
        v = min(max(wanted, v - 0.45), v + 0.26)
        x, ahead = x + 0.1 * v, ahead + 0.167
        assert ahead - x > 2.25 + 0.57
    assert v == pytest.approx(1.67, abs=0.4)


def test_who_drives_in_the_next_lane_does_not_change_into_the_chair():
    roads = StraightRoads(lanes=2)
    order = order_for(actor(y=LANE_M, speed=10.0), (chair(15.0, 0.0),), roads)
    assert order.stay_in_lane
    assert order.lane_index is None


def test_only_who_has_just_come_into_being_on_the_chair_is_turned_away():
    reaction = street()
    old, far = actor(x=50.0, name="v:old"), actor(x=0.0, name="v:far")
    assert reaction.turned_away((old, far), (chair(49.0),), ()) == ()
    fresh = actor(x=51.0, name="v:fresh")
    assert reaction.turned_away((old, far, fresh), (chair(49.0),), {"v:fresh", "v:far"}) == ("v:fresh",)
    assert reaction.turned_away((old, far, fresh), (), {"v:fresh"}) == ()


def test_who_comes_into_reach_brakes_after_its_reaction_and_no_harder_than_it_can():
    """A fast car that the mirror meets for the first time is no newcomer to the street."""
    reaction, roads = street(reaction_s=0.7), StraightRoads()
    fast = actor(x=0.0, speed=25.0, name="v:fast")
    orders = [order_for(fast, (chair(40.0),), roads, reaction) for _ in range(12)]
    assert orders[:6] == [None] * 6
    hardest_mps = 25.0 - 0.1 * roads.brakes("v:fast").emergency_mps2
    assert orders[-1].hard and orders[-1].speed_mps == pytest.approx(hardest_mps)


class Bend(StraightRoads):
    """A lane that turns left by a right angle on a radius of 10 m, from x = 0 on."""

    def lane(self, lane_id: str) -> LaneShape:
        return lane_shape(lane_id, [(-100.0, 0.0), *LEFT_TURN, (10.0, 100.0)], "E")


def test_a_turning_car_stops_for_a_chair_round_the_corner_and_not_for_one_straight_on():
    turning = actor(x=-8.0, speed=6.0)
    assert order_for(turning, (chair(10.0, 14.0),), Bend()).speed_mps < 12.0
    assert order_for(turning, (chair(18.0, 0.0),), Bend()) is None


def test_a_bus_that_cuts_the_corner_stops_for_a_chair_inside_it():
    inside = chair(5.5, 5.0, on_road=False)  # 2.4 m and more from the lane's middle
    assert order_for(actor(x=-6.0, speed=4.0), (inside,), Bend()) is None
    bus = actor(ActorKind.BUS, x=-6.0, speed=4.0, size=(15.0, 2.55, 3.2))
    order = order_for(bus, (inside,), Bend())
    assert order is not None
    assert 0.0 <= order.speed_mps < 6.0


def test_a_lane_beside_counts_only_where_the_route_goes_on_from_there():
    class Ends(StraightRoads):
        def lanes_beside(self, actor_id: str, ahead_m: float) -> tuple[int, ...]:
            return tuple(i for i in super().lanes_beside(actor_id, ahead_m) if ahead_m <= 15.0)

    for lanes_end, wanted in ((False, 1), (True, None)):
        roads = (Ends if lanes_end else StraightRoads)(lanes=2, sublanes=False)
        assert order_for(actor(x=0.0, speed=0.0), (chair(9.0),), roads).lane_index == wanted


def test_who_stands_near_a_chair_begins_no_change_of_lanes_of_sumos_own():
    """SUMO moves sideways even who stands, and turns its body while it does."""
    order = order_for(actor(x=0.0, speed=0.0), (chair(8.0, 2.4),), StraightRoads(lanes=2))
    assert order is not None
    assert order.stay_in_lane


def test_who_has_waited_long_drives_by_slowly_where_its_body_just_clears_and_never_where_it_does_not():
    for beside_m, clears in ((1.45, True), (1.25, False)):  # a gap of 0.24 m, and of 0.04 m
        track = drive(actor(speed=8.0), (chair(30.0, -beside_m),), StraightRoads(sublanes=False), seconds=40.0)
        waited_s = 0.1 * sum(v < 0.1 for _, _, v in track)
        assert waited_s > 7.0
        assert (track[-1][0] > 35.0) == clears
        beginning = [v for x, _, v in track if 26.0 < x + 2.25 < 28.5]
        assert not clears or max(beginning[len(beginning) // 2 :]) <= 1.0


def test_who_could_not_move_over_for_long_is_told_to_stay_in_its_line_before_it_drives_by():
    roads, reaction = StraightRoads(), street()
    standing, there = actor(speed=0.0), (chair(4.5, -1.45),)
    orders = [order_for(standing, there, roads, reaction) for _ in range(100)]
    assert orders[0].aside_m > 0.1
    stays = next(i for i, order in enumerate(orders) if order.aside_m == 0.0)
    assert 75 <= stays <= 90
    assert orders[stays].speed_mps == pytest.approx(0.8)
    assert all(order.aside_m is None and order.speed_mps == pytest.approx(0.8) for order in orders[stays + 1 :])


def test_a_car_that_takes_the_next_lane_keeps_its_own_length_free_to_steer_out():
    roads = StraightRoads(lanes=2, sublanes=False)
    near = order_for(actor(speed=0.0), (chair(8.0),), roads)
    far = order_for(actor(speed=0.0), (chair(12.0),), roads)
    assert near.lane_index == far.lane_index == 1
    assert near.speed_mps == 0.0
    assert far.speed_mps > 1.0
