"""The joystick mapping and the drive controllers, without physics."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.physics.wheelchair import drive_reference
from wcsim.config import ChairConfig
from wcsim.core import joystick
from wcsim.physics.wheelchair import drive_controller
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.types import Joystick

CHAIR = ChairConfig()
SPEC = plant_spec(CHAIR)
DT_S = 1 / 240
SETTING = drive_controller.settings(CHAIR, SPEC, DT_S)
axis = st.floats(-1.0, 1.0)
sticks = st.builds(Joystick, axis, axis)
speeds = st.floats(-3.0, 3.0)
chairs = st.builds(
    ChairConfig,
    v_max_mps=st.sampled_from([0.6, 1.67, 2.78]),
    reverse_share=st.floats(0.0, 1.0),
    accel_mps2=st.floats(0.5, 2.0),
    decel_mps2=st.floats(1.0, 3.0),
    jerk_mps3=st.floats(1.0, 20.0),
    deadband=st.floats(0.0, 0.5),
    shape_exponent=st.floats(1.0, 3.0),
    tremor_damping_s=st.sampled_from([0.0, 0.1, 0.4]),
    brake_after_s=st.floats(0.0, 0.3),
)


@given(sticks, st.floats(0.0, 0.5), st.floats(1.0, 3.0))
def test_the_shaped_stick_stays_in_the_disc_and_keeps_its_direction(stick, deadband, exponent):
    x, y = joystick.shape_joystick(stick.x, stick.y, deadband, exponent)
    assert math.hypot(x, y) <= 1.0 + 1e-12
    if math.sqrt(stick.x**2 + stick.y**2) <= deadband:
        assert (x, y) == (0.0, 0.0)
    else:
        assert x * stick.y == pytest.approx(y * stick.x, abs=1e-12)
        assert x * stick.x >= 0.0 and y * stick.y >= 0.0


def test_deadband_and_shape():
    assert joystick.shape_joystick(0.0, 0.05, 0.08, 1.0) == (0.0, 0.0)
    assert joystick.shape_joystick(0.0, 3.0, 0.08, 1.5) == (0.0, 1.0)
    assert joystick.shape_joystick(-0.5, 0.0, 0.0, 2.0) == (-0.25, 0.0)


@given(st.floats(0.0, 2 * math.pi), st.floats(0.0, 1.5), st.floats(0.0, 1.5))
def test_more_stick_never_asks_for_less(angle, a, b):
    small, large = sorted((a, b))
    outs = [joystick.shape_joystick(r * math.cos(angle), r * math.sin(angle), 0.08, 1.5) for r in (small, large)]
    assert math.hypot(*outs[0]) <= math.hypot(*outs[1]) + 1e-12


@given(sticks, speeds)
def test_targets_stay_within_the_limits(stick, v_now):
    v, w = drive_controller._target(stick.x, stick.y, v_now, SETTING)
    assert -CHAIR.reverse_share * CHAIR.v_max_mps - 1e-12 <= v <= CHAIR.v_max_mps + 1e-12
    assert (
        abs(w) <= joystick.compute_yaw_rate_limit(v_now, CHAIR.yaw_rate_max_radps, CHAIR.yaw_slowdown_s_per_m) + 1e-12
    )
    assert abs(w) <= joystick.compute_yaw_rate_limit(v, CHAIR.yaw_rate_max_radps, CHAIR.yaw_slowdown_s_per_m) + 1e-12


@given(sticks, speeds)
def test_left_and_right_are_mirror_images(stick, v_now):
    v, w = drive_controller._target(stick.x, stick.y, v_now, SETTING)
    assert drive_controller._target(-stick.x, stick.y, v_now, SETTING) == (v, -w)


def test_right_is_clockwise_and_back_is_slower():
    assert drive_controller._target(1.0, 0.0, 0.0, SETTING)[1] == pytest.approx(-1.5)
    assert drive_controller._target(0.0, -1.0, 0.0, SETTING)[0] == pytest.approx(-0.668)
    assert joystick.compute_yaw_rate_limit(1.67, CHAIR.yaw_rate_max_radps, CHAIR.yaw_slowdown_s_per_m) == pytest.approx(
        1.5 / (1 + 0.6 * 1.67)
    )


@pytest.mark.parametrize("profile, speed_mps", [("indoor", 0.6), ("pavement", 1.67), ("road", 2.78)])
def test_a_speed_profile_names_the_speed_at_full_stick(profile, speed_mps):
    chair = ChairConfig(profile=profile)
    assert drive_controller._target(0.0, 1.0, 0.0, drive_controller.settings(chair, SPEC, DT_S))[0] == pytest.approx(
        speed_mps
    )


@given(chairs, st.lists(st.tuples(sticks, speeds, st.floats(-20.0, 20.0)), min_size=1, max_size=6))
def test_the_compiled_controllers_do_what_plain_python_does(chair, plan):
    setting, state, plain = (
        drive_controller.settings(chair, SPEC, DT_S),
        drive_controller.new_state(),
        drive_reference.DriveState(),
    )
    for stick, v_mps, wheel in plan:
        for _ in range(40):
            got = drive_controller.step(state, setting, stick.x, stick.y, v_mps, wheel, -0.5 * wheel)
            want = drive_reference.step(plain, stick, v_mps, (wheel, -0.5 * wheel), chair, SPEC, DT_S)
            assert got == pytest.approx((*want.radps, *want.torque_Nm), rel=1e-12, abs=1e-12)


def follow(stick: Joystick, state: np.ndarray, seconds: float, setting=SETTING) -> list[tuple[float, float]]:
    """Reference speed and its acceleration of a chair that obeys exactly."""
    track = []
    for _ in range(round(seconds / DT_S)):
        v, w = state[drive_controller.V_MOTOR_MPS], 0.5 * SPEC.wheel.track_m * state[drive_controller.W_REF_RADPS]
        wheels = ((v - w) / SPEC.wheel.radius_m, (v + w) / SPEC.wheel.radius_m)
        drive_controller.step(state, setting, stick.x, stick.y, v, *wheels)
        track.append((state[drive_controller.V_REF_MPS], state[drive_controller.A_REF_MPS2]))
    return track


@given(st.lists(sticks, min_size=1, max_size=4))
def test_speed_follows_within_the_limits_of_acceleration_and_jerk(plan):
    state = drive_controller.new_state()
    track = [(0.0, 0.0)]
    for stick in plan:
        track += follow(stick, state, 0.7)
    for (v0, a0), (v1, a1) in itertools.pairwise(track):
        assert abs(v1 - v0) <= (CHAIR.decel_mps2 + 0.1) * DT_S
        assert abs(a1 - a0) <= CHAIR.jerk_mps3 * DT_S + 0.14  # the last bit of a change is taken in one step
        assert -0.67 <= v1 <= 1.68
    follow(Joystick(0.0, 0.0), state, 3.0)
    assert not state[[drive_controller.V_REF_MPS, drive_controller.V_MOTOR_MPS, drive_controller.W_REF_RADPS]].any()


@given(st.lists(sticks, min_size=1, max_size=4))
def test_the_turn_follows_within_its_acceleration(plan):
    state, rates = drive_controller.new_state(), [0.0]
    for stick in plan:
        for _ in range(60):
            follow(stick, state, DT_S)
            rates.append(state[drive_controller.W_REF_RADPS])
    assert np.abs(np.diff(rates)).max() <= CHAIR.yaw_accel_radps2 * DT_S + 1e-12


def test_stops_in_the_distance_of_the_formula():
    state = drive_controller.new_state()
    follow(Joystick(0.0, 1.0), state, 4.0)
    way = sum(v for v, _ in follow(Joystick(0.0, 0.0), state, 3.0)) * DT_S
    assert way == pytest.approx(drive_controller.stopping_distance_m(1.67, 1.5, 4.0), rel=0.02)


def test_the_formula_for_a_slow_chair_never_reaches_its_full_deceleration():
    assert drive_controller.stopping_distance_m(0.1, 1.5, 4.0) == pytest.approx(0.1 * math.sqrt(0.1 / 4.0), rel=1e-9)


def test_tremor_damping_smooths_a_trembling_hand():
    hand = [0.7 + 0.2 * math.sin(2 * math.pi * 6.0 * k * DT_S) for k in range(960)]
    seen = []
    for damping_s in (0.0, 0.2):
        setting = drive_controller.settings(ChairConfig(tremor_damping_s=damping_s), SPEC, DT_S)
        state, stick = drive_controller.new_state(), []
        for y in hand:
            drive_controller.step(state, setting, 0.0, y, 0.0, 0.0, 0.0)
            stick.append(state[drive_controller.STICK_Y])
        seen.append(np.ptp(stick[480:]))
    assert seen[1] / seen[0] == pytest.approx(1 / math.hypot(1.0, 2 * math.pi * 6.0 * 0.2), rel=0.03)


def test_the_parking_brake_closes_after_its_time():
    state = drive_controller.new_state()
    torques = []
    for _ in range(round((CHAIR.brake_after_s + 0.1) / DT_S)):
        left, right, torque, _ = drive_controller.step(state, SETTING, 0.0, 0.0, 0.0, 0.0, 0.0)
        torques.append(torque)
        assert (left, right) == (0.0, 0.0)
    closed = [torque == SPEC.motor.brake_torque_Nm for torque in torques]
    assert closed.index(True) == pytest.approx(CHAIR.brake_after_s / DT_S, abs=2)
    assert drive_controller.step(state, SETTING, 0.0, 1.0, 0.0, 0.0, 0.0)[2] < SPEC.motor.brake_torque_Nm


@given(st.floats(-60.0, 60.0))
def test_motor_torque_falls_with_speed_to_its_floor(radps):
    torque = drive_controller._motor_torque_Nm(radps, SETTING)
    assert 0.15 * 90.0 <= torque <= 90.0
    assert torque == drive_controller._motor_torque_Nm(-radps, SETTING)
    assert torque == pytest.approx(90.0 * max(0.15, 1 - abs(radps) / 24))


@pytest.mark.parametrize(
    "lag_mps, charge, rest",
    [
        (0.05, drive_controller.THROTTLE_MPS2, drive_controller.BRAKE_MPS2),
        (-0.05, drive_controller.BRAKE_MPS2, drive_controller.THROTTLE_MPS2),
    ],
)
def test_one_of_two_controllers_is_in_charge(lag_mps, charge, rest):
    state = drive_controller.new_state()
    follow(Joystick(0.0, 0.5), state, 3.0)
    for _ in range(3):
        drive_controller.step(state, SETTING, 0.0, 0.5, state[drive_controller.V_REF_MPS] - lag_mps, 5.0, 5.0)
    assert state[charge] * lag_mps > 0.0 and state[rest] == 0.0


def test_a_wheel_that_outruns_the_turn_asked_for_gives_way_to_the_other():
    state = drive_controller.new_state()
    follow(Joystick(0.0, 1.0), state, 3.0)
    _, _, left, right = drive_controller.step(state, SETTING, 0.0, 1.0, 1.5, 8.55, 8.50)
    assert left == pytest.approx(0.5 * drive_controller._motor_torque_Nm(8.55, SETTING))
    assert right == drive_controller._motor_torque_Nm(8.50, SETTING)
    _, _, left, right = drive_controller.step(
        state, SETTING, 0.0, 1.0, 1.9, 12.55, 12.50
    )  # both brake: the slower one too much
    assert left == drive_controller._motor_torque_Nm(12.55, SETTING)
    assert right == pytest.approx(0.5 * drive_controller._motor_torque_Nm(12.50, SETTING))


def test_a_blocked_chair_does_not_wind_up():
    state = drive_controller.new_state()
    for _ in range(2400):
        left, _, _, _ = drive_controller.step(state, SETTING, 0.0, 1.0, 0.0, 0.0, 0.0)
    assert left <= (CHAIR.v_max_mps + drive_controller.SPEED_BAND_MPS) / SPEC.wheel.radius_m + 1e-9
    for _ in range(720):
        command = drive_controller.step(state, SETTING, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert command[:2] == (0.0, 0.0)


def test_a_wheel_without_grip_does_not_brake_the_other_one():
    assert drive_controller.speed_mps(0.06, 0.0) == 0.06  # creeping in a turn on the spot is seen
    assert drive_controller.speed_mps(0.4, -0.28) == pytest.approx(-0.18)  # swinging round a wheel is not
    assert drive_controller.speed_mps(-0.4, 0.0) == pytest.approx(-0.1)
