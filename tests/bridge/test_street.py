from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from wcsim.bridge.street import ChairInStreet, StreetReaction, along_path, speed_limit
from wcsim.config import WorldConfig
from wcsim.types import ActorKind, ActorState

BRAKE_MPS2 = 4.5


def actor(kind=ActorKind.CAR, x=0.0, y=0.0, yaw=0.0, speed=10.0, size=(4.5, 1.8, 1.5), name="v:car") -> ActorState:
    return ActorState(
        id=name,
        kind=kind,
        p_W_m=np.array([x, y, 0.0]),
        yaw_rad=yaw,
        pitch_rad=0.0,
        v_W_mps=speed * np.array([math.cos(yaw), math.sin(yaw), 0.0]),
        size_lwh_m=size,
    )


def chair(x: float, y: float = 0.0, vy: float = 0.0, on_road: bool = True) -> ChairInStreet:
    return ChairInStreet(p_W_m=np.array([x, y]), v_W_mps=np.array([0.0, vy]), on_road=on_road)


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5, math.pi])
def test_a_car_may_stop_short_of_a_chair_ahead_whatever_its_heading(yaw):
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    target = ChairInStreet(p_W_m=15.0 * ahead, v_W_mps=np.zeros(2), on_road=True)
    limit = speed_limit(actor(yaw=yaw), target, BRAKE_MPS2)
    assert limit == pytest.approx(math.sqrt(2 * BRAKE_MPS2 * (15.0 - 2.25 - 2.0)), rel=1e-9)


def test_nobody_brakes_for_a_chair_behind_beside_or_far_away():
    assert math.isinf(speed_limit(actor(), chair(-5.0), BRAKE_MPS2))
    assert math.isinf(speed_limit(actor(), chair(12.0, 3.0), BRAKE_MPS2))
    assert math.isinf(speed_limit(actor(speed=5.0), chair(60.0), BRAKE_MPS2))


def test_a_chair_that_will_roll_into_the_lane_counts_before_it_is_there():
    still, rolling = chair(14.0, 3.5), chair(14.0, 3.5, vy=-1.5)
    assert math.isinf(speed_limit(actor(speed=6.0), still, BRAKE_MPS2))
    assert math.isfinite(speed_limit(actor(speed=6.0), rolling, BRAKE_MPS2))


def test_a_chair_on_the_pavement_beside_the_lane_does_not_stop_the_traffic():
    assert math.isfinite(speed_limit(actor(), chair(12.0, 1.7, on_road=True), BRAKE_MPS2))
    assert math.isinf(speed_limit(actor(), chair(12.0, 1.7, on_road=False), BRAKE_MPS2))


def test_the_order_comes_after_the_reaction_time_and_is_taken_back_once():
    config = WorldConfig(reaction_s=0.3, attention_share=1.0)
    street = StreetReaction(config, seed=1)
    orders = [street.react((actor(),), (chair(15.0),)) for _ in range(4)]
    assert [len(order) for order in orders] == [0, 0, 1, 1]
    released = street.react((actor(),), (chair(15.0, 9.0),))
    assert [order.speed_mps for order in released] == [-1.0]
    assert street.react((actor(),), (chair(15.0, 9.0),)) == ()


def test_who_was_held_is_let_go_when_the_chair_is_respawned_elsewhere():
    street = StreetReaction(WorldConfig(reaction_s=0.0, attention_share=1.0), seed=1)
    assert street.react((actor(),), (chair(12.0),))[0].speed_mps > 0.0
    assert [order.speed_mps for order in street.react((), (chair(900.0),))] == [-1.0]
    assert street.react((), (chair(900.0),)) == ()


def test_attention_is_a_property_of_the_actor_and_of_the_seed():
    config = WorldConfig(reaction_s=0.0, attention_share=0.5)
    cars = tuple(actor(name=f"v:{i}") for i in range(200))
    seen = {order.actor.id for order in StreetReaction(config, seed=3).react(cars, (chair(12.0),))}
    again = {order.actor.id for order in StreetReaction(config, seed=3).react(cars[::-1], (chair(12.0),))}
    other = {order.actor.id for order in StreetReaction(config, seed=4).react(cars, (chair(12.0),))}
    assert seen == again != other
    assert 60 < len(seen) < 140
    blind = StreetReaction(WorldConfig(reaction_s=0.0, attention_share=0.0), seed=3)
    assert blind.react(cars, (chair(12.0),)) == ()


def test_a_person_stops_at_once_before_the_chair_and_goes_on_when_it_has_gone():
    street = StreetReaction(WorldConfig(attention_share=1.0), seed=0)
    walker = actor(ActorKind.PEDESTRIAN, speed=1.2, size=(0.3, 0.5, 1.7), name="p:a")
    assert [order.speed_mps for order in street.react((walker,), (chair(0.9),))] == [0.0]
    assert [order.speed_mps for order in street.react((walker,), (chair(0.9, 1.5),))] == [-1.0]


@given(st.floats(0.5, 20.0), st.floats(-0.3, 0.3))
def test_a_point_on_the_path_lies_on_the_path(distance_m, bend_per_m):
    assume(abs(bend_per_m) > 0.02 and abs(distance_m * bend_per_m) < 3.0)
    x = math.sin(distance_m * bend_per_m) / bend_per_m
    y = (1.0 - math.cos(distance_m * bend_per_m)) / bend_per_m
    along_m, aside_m = along_path(x, y, bend_per_m)
    assert along_m == pytest.approx(distance_m, abs=1e-6)
    assert aside_m == pytest.approx(0.0, abs=1e-6)


def test_left_of_a_bent_path_is_left():
    for bend_per_m in (-0.1, 0.0, 0.1):
        assert along_path(0.5, 1.0, bend_per_m)[1] > 0.5
        assert along_path(0.5, -1.0, bend_per_m)[1] < -0.5


def test_a_turning_car_stops_for_a_chair_round_the_corner_and_not_for_one_straight_on():
    turning = actor(speed=5.0)
    round_the_corner, straight_on = chair(8.0, 5.0), chair(12.0, 0.0)
    assert math.isinf(speed_limit(turning, round_the_corner, BRAKE_MPS2))
    assert math.isfinite(speed_limit(turning, round_the_corner, BRAKE_MPS2, bend_per_m=0.12))
    assert math.isinf(speed_limit(turning, straight_on, BRAKE_MPS2, bend_per_m=0.12))


def test_a_cyclist_begins_to_brake_earlier_than_a_car():
    kinds = (ActorKind.BICYCLE, ActorKind.CAR)
    limits = [speed_limit(actor(kind, speed=6.0), chair(9.0), BRAKE_MPS2) for kind in kinds]
    assert limits[0] < limits[1]
