from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.bridge.test_street import actor
from tests.samples import strip_street
from wcsim.bridge.deflect import SIDESTEP_MPS, Deflection
from wcsim.bridge.street import ChairInStreet, speed_limit
from wcsim.types import ActorKind, ActorState, ClassId

TICK_S = 0.1
STREET = strip_street()


def walker(x: float, y: float, yaw: float = 0.0, name: str = "p:a") -> ActorState:
    return actor(ActorKind.PEDESTRIAN, x=x, y=y, yaw=yaw, speed=1.2, size=(0.3, 0.5, 1.7), name=name)


def chair(x: float, y: float) -> ChairInStreet:
    return ChairInStreet(p_W_m=np.array([x, y]), v_W_mps=np.zeros(2), on_road=False)


def walk_past(deflection: Deflection, chairs, x0=2.0, y=5.6, ticks=120):
    """A person walks east at 1.2 m/s and stops for the chair like in the street; returns its real places."""
    x, places = x0, []
    for _ in range(ticks):
        sumo = walker(x, y)
        deflection.update((sumo,), chairs)
        (real,) = deflection.shifted((sumo,))
        places.append(real)
        x += 0.12 * all(speed_limit(real, one, 4.5) > 0.0 for one in chairs)
    return places


def test_a_person_walks_round_a_standing_chair_and_comes_back():
    places = walk_past(Deflection(STREET.grid, TICK_S), (chair(9.0, 5.5),))
    p = np.array([place.p_W_m for place in places])
    assert p[-1, 0] > 12.0
    assert np.linalg.norm(p[:, :2] - [9.0, 5.5], axis=1).min() > 0.7
    assert places[0].deflect_m == 0.0
    assert max(abs(place.deflect_m) for place in places) > 0.4
    assert places[-1].deflect_m == 0.0
    sideways = np.abs(np.diff(p[:, 1]))
    assert sideways.max() <= SIDESTEP_MPS * TICK_S + 1e-9
    ground = STREET.grid.class_at(p)
    assert set(np.unique(ground)) <= {ClassId.SIDEWALK, ClassId.TERRAIN}


def test_deflection_is_to_the_left_when_positive():
    deflection = Deflection(STREET.grid, TICK_S)
    for _ in range(20):
        deflection.update((walker(5.0, 5.0),), (chair(7.0, 4.8),))
    (real,) = deflection.shifted((walker(5.0, 5.0),))
    assert real.deflect_m > 0.3
    assert real.p_W_m[1] == pytest.approx(5.0 + real.deflect_m)


def test_nobody_steps_onto_the_carriageway_or_into_a_wall():
    deflection = Deflection(STREET.grid, TICK_S)
    for _ in range(40):
        deflection.update((walker(5.0, 4.3),), (chair(7.0, 4.6),))
    (real,) = deflection.shifted((walker(5.0, 4.3),))
    assert real.p_W_m[1] >= 4.0
    beside_house = walker(60.0, 8.7)
    for _ in range(40):
        deflection.update((beside_house,), (chair(62.0, 8.5),))
    (real,) = deflection.shifted((beside_house,))
    assert real.p_W_m[1] <= 8.75


def test_people_keep_apart_from_each_other():
    deflection = Deflection(STREET.grid, TICK_S)
    pair = (walker(5.0, 5.2, name="p:a"), walker(5.0, 6.0, name="p:b"))
    for _ in range(40):
        deflection.update(pair, (chair(7.0, 5.2),))
        a, b = deflection.shifted(pair)
        assert np.hypot(*(a.p_W_m - b.p_W_m)[:2]) >= 0.44


def test_without_a_chair_nothing_is_moved():
    deflection = Deflection(STREET.grid, TICK_S)
    crowd = (walker(5.0, 5.2), actor())
    deflection.update(crowd, ())
    assert deflection.shifted(crowd) == crowd


def test_a_turn_of_the_person_does_not_throw_it_sideways():
    deflection = Deflection(STREET.grid, TICK_S)
    east = walker(5.0, 5.6)
    for _ in range(10):
        deflection.update((east,), (chair(7.0, 5.5),))
    (before,) = deflection.shifted((east,))
    north = replace(east, yaw_rad=np.pi / 2)
    deflection.update((north,), (chair(7.0, 5.5),))
    (after,) = deflection.shifted((north,))
    assert np.linalg.norm(after.p_W_m - before.p_W_m) <= SIDESTEP_MPS * TICK_S + 1e-9
