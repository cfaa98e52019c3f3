"""What is noticed: once rolled, never again while in sight; attention has its share and length."""

import math

import numpy as np
import pytest

from tests.users.actors import actor, car, user_view, walker
from tests.users.kinematics import polyline
from wcsim.core.seeding import make_rng
from wcsim.types import ActorKind
from wcsim.users.perception import UserPerception, actor_to_discs
from wcsim.users.profiles import find_builtin_profile

ROUTE = polyline((0, 0), (20, 0))


def notices(name, seed, **what) -> bool:
    seen = UserPerception(find_builtin_profile(name), make_rng(seed)).update(user_view(ROUTE, **what))
    return bool(seen.things or seen.vehicles)


def test_the_chance_to_notice_is_the_profiles():
    for name, share in (("competent", 0.98), ("inattentive", 0.35)):
        share_found = np.mean([notices(name, seed, obstacles=[(2.0, 0.0, 0.1)]) for seed in range(400)])
        assert share_found == pytest.approx(share, abs=0.07)


def test_what_was_missed_stays_missed_and_what_was_seen_stays_seen():
    for seed in range(30):
        perception = UserPerception(find_builtin_profile("inattentive"), make_rng(seed))
        answers = {
            len(perception.update(user_view(ROUTE, 0.1 * i, obstacles=[(2.0, 0.01 * i, 0.1)])).things)
            for i in range(30)
        }
        assert len(answers) == 1


@pytest.mark.parametrize(
    "what, expected",
    [
        ({"obstacles": [(5.5, 0.0, 0.1)]}, True),
        ({"obstacles": [(7.0, 0.0, 0.1)]}, False),
        ({"obstacles": [(-4.0, 0.0, 0.1)]}, False),
        ({"obstacles": [(-4.0, 0.0, 0.1)], "pose": (0.0, 0.0, math.pi)}, True),
        ({"actors": [walker(8.5, 0.0)]}, True),
        ({"actors": [walker(11.0, 0.0)]}, False),
        ({"actors": [actor(ActorKind.WHEELCHAIR, 5.0, 0.0)]}, True),
        ({"actors": [car(20.0, 20.0, v=10.0)]}, True),
        ({"actors": [car(-20.0, 0.0, v=10.0)]}, True),
        ({"actors": [car(43.5, 0.0, v=10.0)]}, True),
        ({"actors": [car(45.0, 0.0, v=10.0)]}, False),
        ({"actors": [walker(-4.0, 0.0)]}, False),
    ],
)
def test_how_far_and_where_things_are_detected(what, expected):
    seed = 0 if notices("competent", 0, obstacles=[(2.0, 0.0, 0.1)]) else 1
    assert notices("competent", seed, **what) == expected


def look(*actors, name="competent", seed=0):
    return UserPerception(find_builtin_profile(name), make_rng(seed)).update(user_view(ROUTE, actors=actors))


@pytest.mark.parametrize("kind", [ActorKind.BICYCLE, ActorKind.SCOOTER])
@pytest.mark.parametrize("x_m, known", [(23.0, True), (-23.0, True), (27.0, False)])
def test_riders_are_traffic_from_both_sides_and_far_away_nothing_to_go_around(kind, x_m, known):
    seen = look(actor(kind, x_m, 0.0, v=5.0))
    assert (len(seen.vehicles), seen.things) == (int(known), ())


def test_people_that_stand_or_walk_are_no_traffic():
    others = (ActorKind.BICYCLE, 0.0), (ActorKind.PEDESTRIAN, 1.5), (ActorKind.WHEELCHAIR, 1.5)
    assert [len(look(actor(kind, 5.0, 0.0, v=v)).vehicles) for kind, v in others] == [0, 0, 0]


def test_a_rider_near_by_is_avoided_as_people_are_and_detected_or_missed_as_both():
    ahead, name = actor(ActorKind.BICYCLE, 4.0, 0.0, v=5.0), "inattentive"
    looks = [look(ahead, name=name, seed=seed) for seed in range(40)]
    assert {(bool(seen.things), bool(seen.vehicles)) for seen in looks} == {(True, True), (False, False)}
    behind = look(actor(ActorKind.BICYCLE, -4.0, 0.0, v=5.0))
    assert behind.vehicles and not behind.things


@pytest.mark.parametrize("ahead_m, near", [(24.0, True), (26.0, False)])
def test_a_vehicle_far_away_is_watched_and_nothing_to_go_around_yet(ahead_m, near):
    seen = look(car(ahead_m, 0.0, v=9.0))
    assert len(seen.vehicles) == 1 and bool(seen.things) == near


def test_attention_has_its_share_and_length():
    perception = UserPerception(find_builtin_profile("inattentive"), make_rng(3))
    attentive = np.array([perception.step_attention(0.1) for _ in range(40_000)])
    assert 1.0 - attentive.mean() == pytest.approx(0.3, abs=0.03)
    ends = np.count_nonzero(attentive[1:] & ~attentive[:-1])
    assert np.count_nonzero(~attentive) * 0.1 / ends == pytest.approx(2.0, abs=0.2)
    lengths = np.diff(np.flatnonzero(np.diff(attentive.astype(int))))
    assert lengths[attentive[np.flatnonzero(np.diff(attentive.astype(int)))[1:]] == 0].max() <= 42
    turning = UserPerception(find_builtin_profile("inattentive"), make_rng(3))
    assert all(turning.step_attention(0.1, calm=False) for _ in range(1000))
    turning.step_attention(0.1, calm=True)
    assert not turning.attentive  # what was put off comes when there is time for it
    turning.step_attention(0.1, calm=True)
    assert turning.step_attention(0.1, heeds=True)  # a light ahead ends it,
    assert all(turning.step_attention(0.1, heeds=True) for _ in range(1000))  # and puts the next one off
    always = UserPerception(find_builtin_profile("competent"), make_rng(3))
    assert all(always.step_attention(0.1) for _ in range(100))


def test_a_long_box_becomes_a_row_of_discs_that_covers_it():
    row = actor_to_discs(car(10.0, 5.0, yaw=math.pi / 2, v=2.0))
    assert len(row) == 3
    assert {thing.radius_m for thing in row} == {0.9}
    assert min(t.y_m for t in row) - 0.9 == pytest.approx(5.0 - 2.25)
    assert all(t.x_m == pytest.approx(10.0) and t.vy_mps == pytest.approx(2.0) for t in row)
    assert len(actor_to_discs(walker(0.0, 0.0))) == 1
