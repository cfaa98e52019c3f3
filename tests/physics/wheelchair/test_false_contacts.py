"""The guard against contacts that cannot be."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.physics.rig import FORWARD, rig, step_street
from wcsim.core.frames import integrate_quaternion, matrix_from_quaternion, quaternion_from_ypr, rpy_from_matrix
from wcsim.physics.wheelchair.contacts import MOST_IN_A_ROW, Motion, Tyre, _off_tyre

TYRE = Tyre(radius_m=0.178, half_width_m=0.04)


@given(st.floats(0.0, 2 * math.pi), st.floats(-0.04, 0.04))
def test_what_pushes_the_tread_towards_the_axle_is_on_the_tyre(angle, y):
    x, z = math.cos(angle), math.sin(angle)
    assert not _off_tyre((TYRE.radius_m * x, y, TYRE.radius_m * z), (-x, 0.0, -z), TYRE)
    assert _off_tyre((TYRE.radius_m * x, y + 0.2, TYRE.radius_m * z), (-x, 0.0, -z), TYRE)
    assert _off_tyre((TYRE.radius_m * x, y, TYRE.radius_m * z), (x, 0.0, z), TYRE)


def test_what_pushes_the_side_of_a_wheel_may_be_anywhere_on_it():
    assert not _off_tyre((0.05, 0.04, -0.1), (0.0, -1.0, 0.0), TYRE)
    assert _off_tyre((0.2, 0.04, -0.1), (0.0, -1.0, 0.0), TYRE)


def test_a_point_ahead_on_flat_ground_is_off_the_tyre():
    assert _off_tyre((0.054, -0.034, -0.178), (0.0, 0.0, 1.0), TYRE)


@given(st.floats(-3.0, 3.0), st.floats(-2.0, 2.0))
def test_turning_on_about_the_vertical(yaw, rate):
    q = integrate_quaternion(quaternion_from_ypr(yaw), (0.0, 0.0, rate), 0.01)
    assert math.remainder(
        rpy_from_matrix(matrix_from_quaternion(q))[2] - yaw - 0.01 * rate, 2 * math.pi
    ) == pytest.approx(0.0, abs=1e-6)


def test_coasting_carries_on_as_before(on_flat):
    on_flat.drive(FORWARD, 20)
    chair, bullet = on_flat.chair, on_flat.engine.bullet
    chair.before_step()
    before: Motion = chair._before
    bullet.resetBaseVelocity(chair.body_id, (0.0, 0.0, 9.0))
    on_flat.engine.step()
    before.coast(chair.body_id, chair._body.joints, on_flat.engine.step_s, bullet)
    chair._read()
    assert chair._v_W_mps == pytest.approx(before.v_W_mps)
    assert np.subtract(chair._p_com_W_m, before.p_W_m) == pytest.approx(np.array(before.v_W_mps) / 240)
    wheel = bullet.getJointState(chair.body_id, chair._body.joints[0])
    assert wheel[1] == pytest.approx(before.joints[0][1])


def impossible(chair) -> tuple:
    """A contact point with a large force, ahead of the left drive wheel, as PyBullet words it."""
    hub = chair._engine.bullet.getLinkState(chair.body_id, chair._body.links["wheel_l"])[0]
    place = (hub[0] + 0.15, hub[1], 0.0)
    return (0, chair.body_id, 0, chair._body.links["wheel_l"], -1, place, place, (0.0, 0.0, 1.0), 0.0, 15_000.0)


def test_an_impossible_contact_is_coasted_over_but_not_for_ever(on_flat):
    on_flat.drive(FORWARD, 20)
    chair, speed = on_flat.chair, on_flat.chair.state().v_B_mps[0]
    for number in range(MOST_IN_A_ROW + 1):
        chair.before_step()
        on_flat.engine.step()
        chair._coast_over_ghosts([impossible(chair)], [])
        chair._read()
        assert chair.ghosts == min(number + 1, MOST_IN_A_ROW)
    assert chair.state().v_B_mps[0] == pytest.approx(speed, abs=0.01)


def test_real_kerbs_are_no_ghosts():
    with rig(step_street(0.04), v_max_mps=1.67) as r:
        r.drive(FORWARD, 40)
        assert r.chair.ghosts == 0
    with rig(step_street(-0.12), v_max_mps=1.0) as r:
        r.drive(FORWARD, 50)
        assert r.chair.ghosts == 0
