"""The guard of the mirror: silent while all is well, loud when an update is missed."""

from dataclasses import replace

import numpy as np
import pytest

from tests.physics.rig import actor
from tests.support.worlds import follow, open_world
from tests.support.yardstick import multiple
from wcsim.bridge import mirror
from wcsim.bridge.mirror import EVERY, MirrorCheck, _check_mirror
from wcsim.errors import PhysicsError
from wcsim.physics.engine import Engine
from wcsim.physics.kinematic_bodies import BodyPool
from wcsim.types import ActorKind


@pytest.fixture
def engine():
    with Engine(1 / 240) as made:
        yield made


@pytest.fixture
def pool(engine):
    return BodyPool(engine)


@pytest.fixture
def guard(pool):
    return MirrorCheck(pool)


def moved(one, dx: float, turn: float = 0.0):
    there = one.p_W_m + np.array([dx, 0.0, 0.0])
    return replace(one, p_W_m=there, yaw_rad=one.yaw_rad + turn, v_W_mps=np.array([10.0 * dx, 0.0, 0.0]))


def tick(engine, pool, before, after):
    pool.place(mirror.moves({one.id: one for one in before}, after, 0.1))
    for _ in range(24):
        engine.step()


def test_it_is_silent_while_bodies_follow(engine, pool, guard):
    now = (actor("v:a", 0.0, 0.0), actor("p:b", 5.0, 5.0, kind=ActorKind.PEDESTRIAN, size=(0.3, 0.5, 1.7)))
    for number in range(2 * EVERY):
        after = (moved(now[0], 1.39, 0.05), moved(now[1], 0.14 * (-1) ** number, 1.0))
        tick(engine, pool, now, after)
        guard.check(after)
        now = after


def test_a_tick_without_an_update_raises_even_when_the_body_coasts_on(engine, pool, guard):
    one = actor("v:a", 0.0, 0.0)
    tick(engine, pool, (one,), (moved(one, 1.0),))
    guard.check((moved(one, 1.0),))
    for _ in range(24):
        engine.step()
    _check_mirror(pool, (moved(one, 2.0),))  # its place alone says nothing
    with pytest.raises(PhysicsError, match="not updated"):
        guard.check((moved(one, 2.0),))


def test_one_actor_whose_update_is_missed_is_named_within_four_ticks(engine, pool, guard):
    now = tuple(actor(f"v:{k}", 10.0 * k, 0.0) for k in range(6))
    with pytest.raises(PhysicsError, match="'v:3'"):
        for _ in range(EVERY):
            after = tuple(moved(one, 0.02) for one in now)
            frozen = tuple(now[3] if one.id == "v:3" else one for one in after)
            tick(engine, pool, now, frozen)
            guard.check(after)
            now = after


@pytest.mark.parametrize("dx, turn", [(0.011, 0.0), (0.0, 0.03)])
def test_a_centimetre_or_a_small_turn_is_too_much(engine, pool, dx, turn):
    one = actor("v:a", 0.0, 0.0)
    tick(engine, pool, (one,), (one,))
    _check_mirror(pool, (moved(one, 0.009),))
    with pytest.raises(PhysicsError, match="v:a"):
        _check_mirror(pool, (moved(one, dx, turn),))


def test_ghosts_and_missing_bodies_are_named(engine, pool):
    here, gone, new = (actor(name, x, 0.0) for name, x in (("v:here", 0.0), ("v:gone", 9.0), ("v:new", 18.0)))
    tick(engine, pool, (here, gone), (here, gone))
    with pytest.raises(PhysicsError, match=r"without an actor \['v:gone'\].*without a body \['v:new'\]"):
        _check_mirror(pool, (here, new))


def test_a_world_that_forgets_its_mirror_stops(corner, monkeypatch):
    with open_world(corner) as world:
        for _ in range(5):
            follow(world)
        monkeypatch.setattr(world, "_mirror", lambda: None)
        with pytest.raises(PhysicsError, match="not updated"):
            follow(world)


def test_it_costs_next_to_nothing(pool):
    actors = tuple(actor(f"v:{k:03}", 7.0 * k, 0.0) for k in range(60))
    pool.place(mirror.moves({}, actors, 0.1))

    def one_round():
        for turn in range(EVERY):
            _check_mirror(pool, actors, turn, EVERY)

    assert multiple(one_round) / EVERY < 0.6  # about 0.1, for 60 actors
