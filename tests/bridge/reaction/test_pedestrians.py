import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.bridge.reaction.roads import actor, chair, walker
from tests.support.samples import USUAL_OUTLINE, strip_street
from wcsim.bridge.reaction.attention import Attention
from wcsim.bridge.reaction.commands import LET_GO
from wcsim.bridge.reaction.pedestrians import PedestrianAvoidance
from wcsim.core.boxes import gap_to_box
from wcsim.core.constants import SIDESTEP_MPS
from wcsim.types import ActorKind, ClassId

TICK_S = 0.1
STREET = strip_street()


def deflection(share: float = 1.0) -> PedestrianAvoidance:
    return PedestrianAvoidance(STREET.grid, TICK_S, Attention(share, 1))


def walk(people, chairs, ticks=150, share=1.0, others=()):
    """People walk straight on as SUMO would have them, and stand when told; their real states at every tick."""
    people, moved, standing, track = list(people), deflection(share), set(), []
    for _ in range(ticks):
        now = tuple(replace(p, v_W_mps=p.v_W_mps * (p.id not in standing)) for p in people)
        moved.update((*now, *others), chairs)
        real = moved.shifted((*now, *others))
        for order in moved.holds(real, chairs):
            (standing.discard if order.speed_mps == LET_GO else standing.add)(order.actor_id)
        people = [replace(p, p_W_m=p.p_W_m + TICK_S * p.v_W_mps * (p.id not in standing)) for p in people]
        track.append(real[: len(people)])
    return track


def gap_m(person, there) -> float:
    x, y = there.p_W_m
    radius = 0.5 * max(person.size_lwh_m[:2])
    return gap_to_box(*person.p_W_m[:2].tolist(), x, y, 1.0, 0.0, *USUAL_OUTLINE.half_lw_m) - radius


def test_a_person_walks_round_a_standing_chair_and_comes_back():
    there = chair(9.0, 5.5, on_road=False)
    places = [person for (person,) in walk((walker(2.0, 5.6),), (there,))]
    p = np.array([place.p_W_m for place in places])
    assert p[-1, 0] > 13.0
    assert min(gap_m(place, there) for place in places) > 0.1
    assert places[0].deflect_m == 0.0
    assert max(abs(place.deflect_m) for place in places) > 0.4
    assert places[-1].deflect_m == 0.0
    assert np.abs(np.diff(p[:, 1])).max() <= SIDESTEP_MPS * TICK_S + 1e-9
    assert set(np.unique(STREET.grid.class_at(p))) <= {ClassId.SIDEWALK, ClassId.TERRAIN}


def test_who_does_not_look_walks_on_as_if_there_was_no_chair():
    places = [person for (person,) in walk((walker(2.0, 5.6),), (chair(9.0, 5.5, on_road=False),), share=0.0)]
    assert all(place.deflect_m == 0.0 for place in places)
    assert places[-1].p_W_m[0] > 18.0


@settings(max_examples=40)
@given(
    st.lists(st.tuples(st.floats(0.0, 18.0), st.floats(4.4, 6.8), st.booleans()), min_size=1, max_size=5),
    st.floats(6.0, 12.0),
    st.floats(4.4, 6.7),
    st.floats(-0.8, 0.8),
)
def test_nobody_is_moved_fast_off_the_pavement_or_into_anybody(crowd, x, y, vx):
    people = [walker(px, py, math.pi * back, name=f"p:{i}") for i, (px, py, back) in enumerate(crowd)]
    start = chair(x, y, on_road=False)
    people = [p for p in people if gap_m(p, start) > 0.5]
    moved = deflection()
    before: dict[str, np.ndarray] = {}
    for tick in range(60):
        there = chair(x + tick * TICK_S * vx, y, vx=vx, on_road=False)
        moved.update(tuple(people), (there,))
        real = {p.id: p for p in moved.shifted(tuple(people))}
        for bare in people:
            p = real[bare.id]
            offset = p.p_W_m[:2] - bare.p_W_m[:2]
            assert np.hypot(*(offset - before.get(p.id, np.zeros(2)))) <= SIDESTEP_MPS * TICK_S + 1e-9
            before[p.id] = offset
            if p is not bare:
                assert int(STREET.grid.class_at(p.p_W_m)) in (ClassId.SIDEWALK, ClassId.TERRAIN)
                assert all(
                    math.dist(p.p_W_m[:2], q.p_W_m[:2])
                    >= min(0.5, math.dist(bare.p_W_m[:2], b.p_W_m[:2]), math.dist(bare.p_W_m[:2], q.p_W_m[:2])) - 1e-6
                    for b, q in ((b, real[b.id]) for b in people)
                    if q.id != p.id
                )


def test_nobody_steps_onto_the_carriageway_or_into_a_wall():
    by_the_kerb, by_the_house = walker(5.0, 4.3), walker(60.0, 8.5)
    (real,) = walk((by_the_kerb,), (chair(8.0, 4.6, on_road=False),))[-1]
    assert real.p_W_m[1] >= 4.0
    for (place,) in walk((by_the_house,), (chair(63.0, 8.3, on_road=False),)):
        assert place.p_W_m[1] <= 8.75


def test_who_has_no_way_past_stands_before_the_chair_and_goes_on_when_it_has_gone():
    moved, person = deflection(), walker(60.0, 8.5)
    wall = [chair(61.4, y, on_road=False) for y in (4.4, 5.2, 6.0, 6.8, 7.6, 8.4)]
    for _ in range(20):
        moved.update((person,), wall)
        orders = moved.holds(moved.shifted((person,)), wall)
    assert [order.speed_mps for order in orders] == [0.0]
    assert [blocked.could_pass for blocked in moved.blocked()] == [False]
    moved.update((person,), ())
    assert [order.speed_mps for order in moved.holds((person,), ())] == [LET_GO]
    assert moved.holds((person,), ()) == ()


def test_two_that_meet_at_a_chair_both_get_past_it():
    pair = (walker(2.0, 5.5, name="p:a"), walker(16.0, 5.6, math.pi, name="p:b"))
    track = walk(pair, (chair(9.0, 5.5, on_road=False),), ticks=250)
    assert track[-1][0].p_W_m[0] > 12.0
    assert track[-1][1].p_W_m[0] < 6.0
    assert min(math.dist(a.p_W_m[:2], b.p_W_m[:2]) for a, b in track) >= 0.5


def test_nobody_steps_into_a_bicycle_beside():
    bicycle = actor(ActorKind.BICYCLE, x=7.0, y=6.4, speed=0.0, size=(1.7, 0.6, 1.7), name="v:b")
    for (person,) in walk((walker(3.0, 5.5),), (chair(8.0, 5.2, on_road=False),), others=(bicycle,)):
        gap = gap_to_box(*person.p_W_m[:2].tolist(), 7.0, 6.4, 1.0, 0.0, 0.85, 0.3)
        assert person.deflect_m == 0.0 or gap >= 0.25


def test_without_a_chair_nothing_is_moved_or_ordered():
    moved = deflection()
    crowd = (walker(5.0, 5.2), actor())
    moved.update(crowd, ())
    assert moved.shifted(crowd) == crowd
    assert moved.holds(crowd, ()) == ()


def test_deflection_is_to_the_left_when_positive():
    (real,) = walk((walker(5.0, 5.0, speed=0.0),), (chair(7.0, 4.8, on_road=False),), ticks=20)[-1]
    assert real.deflect_m > 0.3
    assert real.p_W_m[1] == pytest.approx(5.0 + real.deflect_m)


def test_a_turn_of_the_person_does_not_throw_it_sideways():
    moved, east, there = deflection(), walker(5.0, 5.6), (chair(7.0, 5.5, on_road=False),)
    for _ in range(10):
        moved.update((east,), there)
    (before,) = moved.shifted((east,))
    north = replace(east, yaw_rad=np.pi / 2)
    moved.update((north,), there)
    (after,) = moved.shifted((north,))
    assert np.linalg.norm(after.p_W_m - before.p_W_m) <= SIDESTEP_MPS * TICK_S + 1e-9


def test_a_jump_of_sumos_does_not_carry_a_person_into_the_chair():
    moved, there = deflection(), chair(7.0, 5.5, on_road=False)
    person = walker(7.0, 6.3)
    moved.update((person,), (there,))
    jumped = replace(person, p_W_m=np.array([7.0, 5.7, 0.0]))
    moved.update((jumped,), (there,))
    (real,) = moved.shifted((jumped,))
    assert gap_m(real, there) >= 0.0


def aside(there, person, ticks=8, others=()):
    """A person that has stepped aside for a chair."""
    moved = deflection()
    for _ in range(ticks):
        moved.update((person, *others), there)
    assert moved.shifted((person,))[0].deflect_m != 0.0
    return moved


def test_who_is_put_far_away_by_sumo_is_there_and_not_beside():
    there, person = (chair(7.0, 5.4, on_road=False),), walker(5.0, 5.6)
    moved = aside(there, person)
    elsewhere = replace(person, p_W_m=np.array([40.0, 5.6, 0.0]))
    moved.update((elsewhere,), there)
    assert moved.shifted((elsewhere,))[0].deflect_m == 0.0


def test_a_jump_of_sumos_does_not_carry_who_is_aside_into_a_bicycle():
    there, person = (chair(7.0, 5.2, on_road=False),), walker(5.0, 5.6)
    bicycle = actor(ActorKind.BICYCLE, x=6.6, y=6.2, speed=0.0, size=(1.7, 0.6, 1.7), name="v:b")
    moved = aside(there, person)
    jumped = replace(person, p_W_m=np.array([5.9, 5.6, 0.0]))
    moved.update((jumped, bicycle), there)
    real = moved.shifted((jumped,))[0]
    assert gap_to_box(*real.p_W_m[:2].tolist(), 6.6, 6.2, 1.0, 0.0, 0.85, 0.3) >= 0.25 - 1e-9


def test_who_stands_aside_makes_way_for_a_bicycle_that_comes():
    there, person = (chair(7.0, 5.2, on_road=False),), walker(5.0, 5.6, speed=0.0)
    moved = aside(there, person, ticks=20)
    gaps = []
    for x in np.arange(-4.0, 5.0, 0.4):
        bicycle = actor(ActorKind.BICYCLE, x=x, y=6.4, speed=4.0, size=(1.7, 0.6, 1.7), name="v:b")
        moved.update((person, bicycle), there)
        (real, _) = moved.shifted((person, bicycle))
        gaps.append(gap_to_box(*real.p_W_m[:2].tolist(), x, 6.4, 1.0, 0.0, 0.85, 0.3) - 0.25)
    assert min(gaps) >= 0.0
