"""What a touch does: impulses with the right sign and of the right size; a person is neither a wall nor a ghost."""

import itertools
import math

import numpy as np
import pytest

from tests.physics.rig import FORWARD, NEUTRAL, actor, rig
from wcsim.physics.kinematic_bodies import BodyMove, BodyPool
from wcsim.types import ActorKind

PERSON = (0.29, 0.51, 1.75)
MASS_KG = 190.0


def still(one) -> BodyMove:
    return BodyMove(actor=one, v_W_mps=np.zeros(3), yaw_rate_radps=0.0)


def deepest(r, pool, name) -> float:
    points = r.engine.bullet.getContactPoints(r.chair.body_id, pool.body_of(name))
    return min((point[8] for point in points), default=0.0)


def deepest_in_tick(r, pool, name) -> float:
    """The deepest contact of the steps to the end of a tick."""
    deep = 0.0
    for _ in range(round(0.1 / r.engine.step_s)):
        r.step()
        deep = min(deep, deepest(r, pool, name))
    r.chair.end_tick(None)
    return deep


def struck(yaw: float, aside_m: float, gap_m: float, speed=8.0, size=(4.5, 1.8, 1.5), kind=ActorKind.CAR):
    """A vehicle drives into a standing chair for 0.6 s: deepest contact, impulse on the chair, its velocity after."""
    deep, impulse = 0.0, 0.0
    with rig() as r:
        r.place(yaw=yaw)
        pool = BodyPool(r.engine)
        for tick in range(6):
            car = actor("v:car", speed * 0.1 * tick - 0.5 * size[0] - gap_m, aside_m, 0.0, kind, size)
            pool.place([BodyMove(actor=car, v_W_mps=np.array([speed, 0.0, 0.0]), yaw_rate_radps=0.0, dt_s=0.1)])
            r.chair.command(NEUTRAL)
            deep = min(deep, deepest_in_tick(r, pool, "v:car"))
            impulse += sum(c.impulse_Ns for c in r.chair.contacts() if c.actor_id == "v:car")
            moved = np.array(r.chair._v_W_mps)
    return deep, impulse, moved


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, math.pi])
def test_a_car_gives_the_chair_the_momentum_it_leaves_with(yaw):
    deep, impulse, moved = struck(yaw, 0.0, 1.0)
    assert moved[0] > 6.0, "pushed the way the car drives"
    assert impulse > 0.8 * MASS_KG * moved[0], "and by at least what that takes: the ground takes some of it"
    assert impulse < 4.0 * MASS_KG * moved[0]
    assert -0.05 < deep < 0.0


@pytest.mark.proof
def test_nothing_sinks_in_by_55_mm_wherever_it_hits():
    places = itertools.product(np.linspace(0, 2 * math.pi, 24, endpoint=False), (-0.6, -0.3, 0, 0.3, 0.6), (0.95, 1.03))
    assert min(struck(yaw, aside_m, gap_m)[0] for yaw, aside_m, gap_m in places) > -0.055


def test_driving_into_a_standing_person_stops_the_chair_but_not_like_a_wall():
    peaks, entry = {}, 0.0
    for name, kind in (("person", ActorKind.PEDESTRIAN), ("block", ActorKind.OTHER)):
        with rig() as r:
            pool, deep, impulse, seen, slowest = BodyPool(r.engine), 0.0, 0.0, 0, 9.0
            one = actor(name, 2.5, 0.0, kind=kind, size=PERSON)
            while seen < 6:
                pool.place([still(one)])
                r.chair.command(FORWARD if not seen else NEUTRAL)
                before = float(r.chair.state().v_B_mps[0])
                deep = min(deep, deepest_in_tick(r, pool, name))
                slowest = min(slowest, float(r.chair.state().v_B_mps[0])) if deep < 0.0 else slowest
                impulse += sum(c.impulse_Ns for c in r.chair.contacts() if c.actor_id == name)
                if deep < 0.0:
                    seen += 1
                    peaks[name] = max(peaks.get(name, 0.0), float(abs(r.chair.imu().accel_peak_mps2[0])))
                    entry = before if seen == 1 else entry
        assert entry == pytest.approx(1.65, abs=0.1)
        assert slowest < 0.1, "stopped"
        assert 0.8 * MASS_KG * entry < impulse < 6.0 * MASS_KG * entry
        if kind is ActorKind.PEDESTRIAN:
            assert -0.05 < deep < -0.01, "gives way, but nobody drives through"
            assert slowest > -0.5, "and does not throw back"
    assert peaks["person"] < 0.6 * peaks["block"]


def test_a_person_who_walks_into_the_chair_moves_it_and_does_not_pass_through(on_flat):
    pool, deep = BodyPool(on_flat.engine), 0.0
    for tick in range(14):
        one = actor("p", 0.14 * tick - 2.0, 0.0, kind=ActorKind.PEDESTRIAN, size=PERSON)
        pool.place([BodyMove(actor=one, v_W_mps=np.array([1.4, 0.0, 0.0]), yaw_rate_radps=0.0)])
        deep = min(deep, deepest_in_tick(on_flat, pool, "p"))
    assert -0.05 < deep < 0.0
    assert on_flat.chair.state().v_B_mps[0] > 0.5
