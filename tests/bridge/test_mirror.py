from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.bridge.test_street import actor
from tests.samples import KERB_M, strip_street
from wcsim.bridge.mirror import moves, on_ground


def test_velocity_carries_the_old_pose_to_the_new_one():
    old = actor(x=3.0, y=1.0, yaw=3.0)
    new = replace(old, p_W_m=np.array([2.0, 1.2, 0.0]), yaw_rad=-3.1)
    (move,) = moves({old.id: old}, (new,), dt_s=0.1)
    assert np.allclose(move.actor.p_W_m + 0.1 * move.v_W_mps, new.p_W_m)
    assert move.yaw_rate_radps == pytest.approx((2 * math.pi - 6.1) / 0.1)


def test_a_newcomer_comes_from_where_its_speed_says():
    new = actor(x=10.0, speed=8.0)
    (move,) = moves({}, (new,), dt_s=0.1)
    assert move.actor.p_W_m[0] == pytest.approx(9.2)
    assert np.allclose(move.v_W_mps, [8.0, 0.0, 0.0])


def test_a_teleported_actor_does_not_sweep_through_the_street():
    old, new = actor(x=0.0), actor(x=40.0)
    (move,) = moves({old.id: old}, (new,), dt_s=0.1)
    assert np.allclose(move.actor.p_W_m, new.p_W_m)
    assert not move.v_W_mps.any()


def test_actors_that_have_left_are_not_moved():
    assert moves({"v:gone": actor(name="v:gone")}, (), dt_s=0.1) == ()


def test_actors_stand_on_the_ground_that_wheels_and_cameras_know():
    grid = strip_street().grid
    on_road, on_pavement = on_ground((actor(x=10.0, y=0.0), actor(x=10.0, y=5.5)), grid)
    assert on_road.p_W_m[2] == 0.0
    assert on_pavement.p_W_m[2] == pytest.approx(KERB_M)
    assert on_ground((), grid) == ()
