"""Scenes made by chance stand where they should."""

import math

import numpy as np
import pytest

from benchmarks.camera.random_scenes import ground_m, scatter
from tests.support.samples import strip_street
from wcsim.config import CameraConfig
from wcsim.types import ActorKind


def test_actors_stand_on_their_ground_and_apart():
    street = strip_street()
    scene = scatter(street, CameraConfig(), poses=3, actors=30, seed=4)
    assert len(scene.poses) == 3 and len(scene.actors) == 30
    assert all(T_CW.shape == (3, 4) for T_CW in scene.poses)
    for actor in scene.actors:
        x, y, z = actor.p_W_m
        crossing = 38 <= x <= 42
        assert (4 <= abs(y) <= 7 or crossing) if actor.kind is ActorKind.PEDESTRIAN else abs(y) < 4
        assert z == pytest.approx(ground_m(street.grid, x, y))
    for i, a in enumerate(scene.actors):
        for b in scene.actors[:i]:
            reach = 0.5 * (math.hypot(*a.size_lwh_m[:2]) + math.hypot(*b.size_lwh_m[:2]))
            assert np.hypot(*(a.p_W_m - b.p_W_m)[:2]) >= reach


def test_the_seed_makes_the_scene():
    street = strip_street()
    first, again = (scatter(street, CameraConfig(), poses=2, actors=10, seed=1) for _ in range(2))
    other = scatter(street, CameraConfig(), poses=2, actors=10, seed=2)
    assert np.array_equal(first.poses, again.poses)
    assert [a.p_W_m.tolist() for a in first.actors] == [a.p_W_m.tolist() for a in again.actors]
    assert [a.p_W_m.tolist() for a in first.actors] != [a.p_W_m.tolist() for a in other.actors]
