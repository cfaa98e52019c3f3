"""Mirror bodies: pooled, moved, parked."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.physics.rig import actor, ray_down
from wcsim.core import frames
from wcsim.errors import PhysicsError
from wcsim.physics.engine import Engine, Role
from wcsim.physics.kinematic_bodies import BodyMove, BodyPool
from wcsim.types import ActorKind

KINDS = list(ActorKind)


@pytest.fixture
def pool(engine):
    return BodyPool(engine)


def move(moved, v=(0.0, 0.0, 0.0), yaw_rate=0.0) -> BodyMove:
    return BodyMove(actor=moved, v_W_mps=np.array(v), yaw_rate_radps=yaw_rate)


def test_a_body_stands_where_its_actor_stands(engine, pool):
    walker = actor("p", 1.0, 1.0, -2.0, ActorKind.PEDESTRIAN, (0.3, 0.5, 1.7))
    pool.place([move(actor("a", 3.0, 4.0, 0.5)), move(walker)])
    poses = pool.poses()
    assert list(poses) == ["a", "p"] and pool.count == 2
    assert poses["a"][0] == pytest.approx([3.0, 4.0, 0.0], abs=1e-9)
    assert poses["a"][1] == pytest.approx(0.5)
    assert poses["p"][0] == pytest.approx([1.0, 1.0, 0.0], abs=1e-9)
    tops = ray_down(engine, np.array([[3.0, 4.0], [1.0, 1.0]]))
    assert tops == pytest.approx([1.5, 1.7], abs=0.01)
    assert engine.tag_of(pool.body_of("a")).role is Role.ACTOR


def test_it_is_carried_through_the_tick_by_its_velocity(engine, pool):
    pool.place([move(actor("a", 0.0, 0.0), (13.9, 0.0, 0.0)), move(actor("b", 0.0, 9.0), (5.0, 0.0, 0.0), 0.5)])
    for _ in range(24):
        engine.step()
    p, yaw = pool.poses()["a"]
    assert p == pytest.approx([1.39, 0.0, 0.0], abs=1e-6) and yaw == pytest.approx(0.0)
    assert pool.poses()["b"][1] == pytest.approx(0.05, abs=1e-3)


def test_a_car_on_a_slope_is_pitched(engine, pool):
    pool.place([move(replace(actor("a", 0.0, 0.0), pitch_rad=0.2))])
    assert pool.poses()["a"][0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    front, back = ray_down(engine, np.array([[1.5, 0.0], [-1.5, 0.0]]))
    assert front - back == pytest.approx(3.0 * math.tan(0.2), rel=0.05)


def test_who_leaves_is_parked_and_the_body_is_used_again(engine, pool):
    pool.place([move(actor("a", 0.0, 0.0)), move(actor("b", 10.0, 0.0))])
    first = pool.body_of("a")
    pool.place([move(actor("b", 10.0, 0.0))])
    assert pool.count == 1 and pool.made == 2
    assert ray_down(engine, np.array([[0.0, 0.0]]))[0] == -np.inf
    pool.place([move(actor("b", 10.0, 0.0)), move(actor("c", 20.0, 0.0))])
    assert pool.made == 2 and pool.body_of("c") == first
    assert engine.tag_of(first).actor_id == "c"
    pool.place([move(actor("c", 20.0, 0.0, size=(8.0, 2.5, 3.0)))])
    assert pool.made == 3 and pool.body_of("c") != first


@given(st.lists(st.lists(st.tuples(st.integers(0, 7), st.sampled_from(KINDS)), unique_by=lambda x: x[0], max_size=8)))
@settings(max_examples=25)
def test_the_pool_holds_exactly_the_listed_actors(ticks):
    with Engine(1 / 240) as engine:
        pool = BodyPool(engine)
        most: dict[ActorKind, int] = {}
        for listed in ticks:
            pool.place([move(actor(f"a{number}", 10.0 * number, 0.0, kind=kind)) for number, kind in listed])
            poses = pool.poses()
            assert set(poses) == {f"a{number}" for number, _ in listed}
            for number, _ in listed:
                assert poses[f"a{number}"][0][0] == pytest.approx(10.0 * number)
            assert len({pool.body_of(name) for name in poses}) == len(listed) == pool.count
            for kind in KINDS:
                most[kind] = max(most.get(kind, 0), sum(other is kind for _, other in listed))
            assert pool.made == sum(most.values())  # never more than were needed at once


def test_every_kind_gets_a_body_of_its_size(engine, pool):
    size = (2.0, 0.8, 1.2)
    pool.place([move(actor(kind.value, 20.0 * i, 0.0, kind=kind, size=size)) for i, kind in enumerate(KINDS)])
    heights = ray_down(engine, np.array([[20.0 * i, 0.0] for i in range(len(KINDS))]))
    assert heights == pytest.approx(np.full(len(KINDS), 1.2), abs=0.01)


def test_what_cannot_be_used_is_refused(pool):
    with pytest.raises(PhysicsError, match="one move for each"):
        pool.place([move(actor("a", 0.0, 0.0)), move(actor("a", 1.0, 0.0))])
    with pytest.raises(PhysicsError, match="'n'"):
        pool.place([move(actor("n", math.nan, 0.0))])
    with pytest.raises(PhysicsError, match="size"):
        pool.place([move(actor("s", 0.0, 0.0, size=(1.0, 0.0, 1.0)))])
    with pytest.raises(PhysicsError, match="no body"):
        pool.body_of("ghost")


@given(
    yaw=st.floats(-math.pi, math.pi), turn=st.floats(-0.5, 0.5), speed=st.floats(0.0, 16.0),
    pitch=st.floats(-0.15, 0.15), kind=st.sampled_from(KINDS),
)  # fmt: skip
@settings(max_examples=20)
def test_substeps_lie_between_the_ticks_and_the_tick_ends_within_a_centimetre(yaw, turn, speed, pitch, kind):
    """A vehicle drives an arc: straight on within a millimetre, round a bend within a centimetre of the next tick."""
    start = replace(actor("a", 1.0, 2.0, yaw, kind, (4.5, 1.8, 1.5)), pitch_rad=pitch)
    way = 0.1 * speed
    chord = way * (math.sin(turn / 2) / (turn / 2) if abs(turn) > 1e-9 else 1.0)
    ahead = np.array([math.cos(yaw + turn / 2), math.sin(yaw + turn / 2), 0.1])
    end = start.p_W_m + chord * ahead
    with Engine(1 / 240) as engine:
        pool = BodyPool(engine)
        pool.place([BodyMove(actor=start, v_W_mps=(end - start.p_W_m) / 0.1, yaw_rate_radps=turn / 0.1, dt_s=0.1)])
        seen = [pool.poses()["a"]]
        for _ in range(24):
            engine.step()
            seen.append(pool.poses()["a"])
    gone = [float(np.linalg.norm(p - start.p_W_m)) for p, _ in seen]
    assert all(b >= a - 2e-3 for a, b in itertools.pairwise(gone)), "on and on"
    for k, (p, _) in enumerate(seen):
        assert np.linalg.norm(p - (start.p_W_m + k / 24 * (end - start.p_W_m))) < 0.05 + 0.15 * way * abs(turn)
    assert np.linalg.norm(seen[-1][0] - end) < 1e-4
    assert frames.wrap_angle(seen[-1][1] - yaw - turn) == pytest.approx(0.0, abs=2e-3)
