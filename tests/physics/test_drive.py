"""The joystick mapping and the drive controllers, without physics."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.config import ChairConfig
from wcsim.physics import drive
from wcsim.physics.plant import PlantSpec
from wcsim.types import Joystick

CHAIR = ChairConfig()
SPEC = PlantSpec()
DT_S = 1 / 240
axis = st.floats(-1.0, 1.0)
sticks = st.builds(Joystick, axis, axis)
speeds = st.floats(-3.0, 3.0)


@given(sticks, st.floats(0.0, 0.5), st.floats(1.0, 3.0))
def test_the_shaped_stick_stays_in_the_disc_and_keeps_its_direction(stick, deadband, exponent):
    out = drive.shaped(stick, deadband, exponent)
    assert math.hypot(out.x, out.y) <= 1.0 + 1e-12
    if math.hypot(stick.x, stick.y) <= deadband:
        assert out == Joystick(0.0, 0.0)
    else:
        assert out.x * stick.y == pytest.approx(out.y * stick.x, abs=1e-12)
        assert out.x * stick.x >= 0.0 and out.y * stick.y >= 0.0


@given(st.floats(0.0, 2 * math.pi), st.floats(0.0, 1.5), st.floats(0.0, 1.5))
def test_more_stick_never_asks_for_less(angle, a, b):
    small, large = sorted((a, b))
    outs = [drive.shaped(Joystick(r * math.cos(angle), r * math.sin(angle)), 0.08, 1.5) for r in (small, large)]
    assert math.hypot(outs[0].x, outs[0].y) <= math.hypot(outs[1].x, outs[1].y) + 1e-12


@given(sticks, speeds)
def test_targets_stay_within_the_limits(stick, v_now):
    wanted = drive.target(stick, v_now, CHAIR)
    assert -CHAIR.reverse_share * CHAIR.v_max_mps - 1e-12 <= wanted.v_mps <= CHAIR.v_max_mps + 1e-12
    assert abs(wanted.w_radps) <= drive.yaw_rate_limit(v_now, CHAIR) + 1e-12
    assert abs(wanted.w_radps) <= drive.yaw_rate_limit(wanted.v_mps, CHAIR) + 1e-12


@given(sticks, speeds)
def test_left_and_right_are_mirror_images(stick, v_now):
    one = drive.target(stick, v_now, CHAIR)
    other = drive.target(Joystick(-stick.x, stick.y), v_now, CHAIR)
    assert one.v_mps == other.v_mps
    assert one.w_radps == -other.w_radps


def test_right_is_clockwise_and_back_is_slower():
    assert drive.target(Joystick(1.0, 0.0), 0.0, CHAIR).w_radps == pytest.approx(-1.5)
    assert drive.target(Joystick(0.0, -1.0), 0.0, CHAIR).v_mps == pytest.approx(-0.668)
    assert drive.yaw_rate_limit(1.67, CHAIR) == pytest.approx(1.5 / (1 + 0.6 * 1.67))


def follow(stick: Joystick, state: drive.DriveState, seconds: float) -> list[tuple[float, float]]:
    """Reference speed and its acceleration of a chair that obeys exactly."""
    track = []
    for _ in range(round(seconds / DT_S)):
        v, w = state.v_motor_mps, 0.5 * SPEC.track_m * state.w_ref_radps
        wheels = ((v - w) / SPEC.wheel_radius_m, (v + w) / SPEC.wheel_radius_m)
        drive.step(state, stick, v, wheels, CHAIR, SPEC, DT_S)
        track.append((state.v_ref_mps, state.a_ref_mps2))
    return track


@given(st.lists(sticks, min_size=1, max_size=4))
def test_speed_follows_within_the_limits_of_acceleration_and_jerk(plan):
    state = drive.DriveState()
    track = [(0.0, 0.0)]
    for stick in plan:
        track += follow(stick, state, 0.7)
    for (v0, a0), (v1, a1) in itertools.pairwise(track):
        assert abs(v1 - v0) <= (CHAIR.decel_mps2 + 0.1) * DT_S
        assert abs(a1 - a0) <= CHAIR.jerk_mps3 * DT_S + 0.14  # the last bit of a change is taken in one step
        assert -0.67 <= v1 <= 1.68
    follow(Joystick(0.0, 0.0), state, 3.0)
    assert state.v_ref_mps == 0.0 and state.v_motor_mps == 0.0 and state.w_ref_radps == 0.0


def test_stops_in_the_distance_of_the_formula():
    state = drive.DriveState()
    follow(Joystick(0.0, 1.0), state, 4.0)
    way = sum(v for v, _ in follow(Joystick(0.0, 0.0), state, 3.0)) * DT_S
    assert way == pytest.approx(drive.stopping_distance_m(1.67, 1.5, 4.0), rel=0.02)


def test_the_formula_for_a_slow_chair_never_reaches_its_full_deceleration():
    assert drive.stopping_distance_m(0.1, 1.5, 4.0) == pytest.approx(0.1 * math.sqrt(0.1 / 4.0), rel=1e-9)


def test_the_parking_brake_closes_after_its_time():
    state = drive.DriveState()
    torques = []
    for _ in range(round((CHAIR.brake_after_s + 0.1) / DT_S)):
        command = drive.step(state, Joystick(0.0, 0.0), 0.0, (0.0, 0.0), CHAIR, SPEC, DT_S)
        torques.append(command.torque_Nm[0])
        assert command.radps == (0.0, 0.0)
    closed = [torque == SPEC.brake_torque_Nm for torque in torques]
    assert closed.index(True) == pytest.approx(CHAIR.brake_after_s / DT_S, abs=2)
    assert drive.step(state, Joystick(0.0, 1.0), 0.0, (0.0, 0.0), CHAIR, SPEC, DT_S).torque_Nm[0] < SPEC.brake_torque_Nm


@given(st.floats(-60.0, 60.0))
def test_motor_torque_falls_with_speed_to_its_floor(radps):
    torque = drive.motor_torque_Nm(radps, SPEC)
    assert 0.15 * 90.0 <= torque <= 90.0
    assert torque == drive.motor_torque_Nm(-radps, SPEC)
    assert torque == pytest.approx(90.0 * max(0.15, 1 - abs(radps) / 24))


def test_a_blocked_chair_does_not_wind_up():
    state = drive.DriveState()
    for _ in range(2400):
        command = drive.step(state, Joystick(0.0, 1.0), 0.0, (0.0, 0.0), CHAIR, SPEC, DT_S)
    assert command.radps[0] <= (CHAIR.v_max_mps + drive.SPEED_BAND_MPS) / SPEC.wheel_radius_m + 1e-9
    for _ in range(720):
        command = drive.step(state, Joystick(0.0, 0.0), 0.0, (0.0, 0.0), CHAIR, SPEC, DT_S)
    assert command.radps == (0.0, 0.0)
