"""From a joystick position to wheel motors: mapping, limits, two PI controllers, motor curve.

Acceleration and jerk are limited. Linear velocity is held by two PI controllers, throttle and
brake, as in the paper; angular velocity is set directly within its limits. They give target speeds
for the two motors, whose torque ends where that of a DC motor does. All of it is compiled, and
works on an array of memory (`new_state`) and one of settings (`settings`).
"""

import math
from typing import Final

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.jit import compile_exact_kernel
from wcsim.core.joystick import (
    ACCEL,
    DECEL,
    STILL_MPS,
    YAW_ACCEL,
    advance_speed,
    drive_limits_from_chair,
    move_towards,
    shape_joystick,
    target_speeds,
)
from wcsim.physics.wheelchair.plant import PlantSpec
from wcsim.types import F64

PI_KP_PER_S: Final = 3.0
PI_KI_PER_S2: Final = 1.0
SLIP_MPS: Final = 0.1  # more than this between wheels and ground is a wheel without grip
SPEED_BAND_MPS: Final = 0.25  # how far the controllers may lead the reference speed
# The share of its torque that a wheel loses for each rad/s by which it outruns the desired turn.
STEER_S: Final = 10.0
_STILL_RADPS: Final = 1e-3

# Memory of the controllers
V_REF_MPS, A_REF_MPS2, W_REF_RADPS, V_MOTOR_MPS = 0, 1, 2, 3
THROTTLE_MPS2, BRAKE_MPS2 = 4, 5  # integral parts of the two PI controllers
IDLE_S, STICK_X, STICK_Y = 6, 7, 8
_STATE_SIZE: Final = 9

# Settings; the first are the limits of `wcsim.core.joystick`.
_DT_S, _DEADBAND, _EXPONENT, _SMOOTHING, _BRAKE_AFTER = range(8, 13)
_HALF_TRACK, _RADIUS = 13, 14
_STALL, _NO_LOAD, _LEAST_SHARE, _BRAKE_TORQUE = 15, 16, 17, 18


def new_state() -> F64:
    """Memory of the controllers of a chair that stands."""
    return np.zeros(_STATE_SIZE)


def settings(chair: ChairConfig, spec: PlantSpec, dt_s: float) -> F64:
    """All numbers of a chair for `step`, for control steps of `dt_s`."""
    damping_s = chair.tremor_damping_s
    return np.array(
        [
            *drive_limits_from_chair(chair),
            dt_s,
            chair.deadband,
            chair.shape_exponent,
            1.0 - math.exp(-dt_s / damping_s) if damping_s > 0.0 else 1.0,
            chair.brake_after_s,
            0.5 * spec.wheel.track_m,
            spec.wheel.radius_m,
            spec.motor.stall_torque_Nm,
            spec.motor.no_load_radps,
            spec.motor.least_torque_share,
            spec.motor.brake_torque_Nm,
        ]
    )


def stopping_distance_m(v_mps: float, decel_mps2: float, jerk_mps3: float) -> float:
    """Way to a stop from a steady speed with limited jerk: v^2 / 2a + v a / 2j if a is reached.

    >>> round(stopping_distance_m(1.67, 1.5, 4.0), 3)
    1.243
    """
    # From a low speed the chair stands before its jerk has reached the whole deceleration.
    full = min(decel_mps2, math.sqrt(jerk_mps3 * abs(v_mps)))
    return 0.5 * v_mps * v_mps / full + 0.5 * abs(v_mps) * full / jerk_mps3


def speed_mps(axle_mps: float, wheels_mps: float) -> float:
    """The chair's speed for the controllers: that of its axle, but near that of its wheels.

    A chair that turns on the spot creeps a little, which only the axle's speed shows. Where one
    wheel has no grip, as across a ramp, the axle swings round the other one. Holding its speed
    would brake the only wheel that can steer.
    """
    return wheels_mps + min(max(axle_mps - wheels_mps, -SLIP_MPS), SLIP_MPS)


@compile_exact_kernel
def _target(x: float, y: float, v_ref_mps: float, setting: F64) -> tuple[float, float]:
    """The desired speeds of a joystick position: forward in m/s, turn to the left in rad/s.

    The position is pulled to the unit disc first. The faster of reference speed and desired speed
    limits the turn. The measured speed would not do, as the axle of a chair that turns in place
    trembles.

    Args:
        x: Joystick to the right.
        y: Joystick forward.
        v_ref_mps: Speed that the controllers hold at the moment.
        setting: From `settings`.
    """
    sx, sy = shape_joystick(x, y, setting[_DEADBAND], setting[_EXPONENT])
    return target_speeds(sx, sy, v_ref_mps, setting)


@compile_exact_kernel
def _motor_torque_Nm(wheel_radps: float, setting: F64) -> float:
    """The most that a motor gives at a wheel speed, from the stall torque to the no-load speed."""
    return float(
        setting[_STALL] * max(setting[_LEAST_SHARE], 1.0 - abs(wheel_radps) / setting[_NO_LOAD])
    )


@compile_exact_kernel
def _control(state: F64, v_mps: float, setting: F64) -> None:
    """Throttle or brake: move the motors' speed on by the acceleration that one of both gives.

    Each is a PI controller with a feed-forward part; its integral rests while the output is at a
    bound.
    """
    dt_s, v_ref = setting[_DT_S], state[V_REF_MPS]
    # At a reference of exactly 0 the acceleration has the direction in which the chair will go.
    forward = 1.0 if v_ref + 1e-9 * state[A_REF_MPS2] >= 0.0 else -1.0
    error = forward * (v_ref - v_mps)
    out = forward * state[A_REF_MPS2] + PI_KP_PER_S * error
    if out >= 0.0:
        charge, rest = THROTTLE_MPS2, BRAKE_MPS2
        # Twice the limit: up to one for the reference's acceleration, the other for the error.
        low, high = 0.0, 2.0 * setting[ACCEL]
    else:
        charge, rest = BRAKE_MPS2, THROTTLE_MPS2
        low, high = -2.0 * setting[DECEL], 0.0
    # The controller that takes over begins without the memory of its last turn.
    state[rest] = 0.0
    out += state[charge]
    held = min(max(out, low), high)
    # Anti-windup: an integral that grows at the bound would overshoot once the bound is left.
    if out == held:
        state[charge] += PI_KI_PER_S2 * error * dt_s
    motor = state[V_MOTOR_MPS] + forward * held * dt_s
    # A chair that is held, as at a kerb, must not wind its motors' speed up.
    state[V_MOTOR_MPS] = min(max(motor, v_ref - SPEED_BAND_MPS), v_ref + SPEED_BAND_MPS)


@compile_exact_kernel
def _steered(ahead_radps: float, push_radps: float) -> float:
    """Share of its torque for a wheel that is ahead of the other one and is pushed on."""
    return max(0.0, 1.0 - STEER_S * abs(ahead_radps)) if ahead_radps * push_radps > 0.0 else 1.0


@compile_exact_kernel
def _damped(state: F64, x: float, y: float, setting: F64) -> None:
    """The controller's low-pass against a trembling hand."""
    share = setting[_SMOOTHING]
    # Without damping the stick goes through to the bit.
    if share >= 1.0:
        state[STICK_X] = x
        state[STICK_Y] = y
    else:
        state[STICK_X] += share * (x - state[STICK_X])
        state[STICK_Y] += share * (y - state[STICK_Y])


@compile_exact_kernel
def step(
    state: F64,
    setting: F64,
    x: float,
    y: float,
    v_mps: float,
    left_radps: float,
    right_radps: float,
) -> tuple[float, float, float, float]:
    """One control step: `state` is moved on, the result holds for the physics step to come.

    Args:
        state: The chair's memory, changed in place.
        setting: From `settings`.
        x: Joystick to the right.
        y: Joystick forward.
        v_mps: Measured forward speed, see `speed_mps`.
        left_radps: Measured speed of the left drive wheel.
        right_radps: And of the right one.

    Returns:
        Target speeds in rad/s and torque limits in Nm of the motors: left, right, left, right.
    """
    # 1. The reference follows the joystick.
    _damped(state, x, y, setting)
    v_desired, w_desired = _target(state[STICK_X], state[STICK_Y], state[V_REF_MPS], setting)
    idle = v_desired == 0.0 and w_desired == 0.0
    state[V_REF_MPS], state[A_REF_MPS2] = advance_speed(
        state[V_REF_MPS], state[A_REF_MPS2], v_desired, setting, setting[_DT_S]
    )
    most_radps = setting[YAW_ACCEL] * setting[_DT_S]
    state[W_REF_RADPS] = move_towards(state[W_REF_RADPS], w_desired, most_radps)
    state[IDLE_S] = state[IDLE_S] + setting[_DT_S] if idle else 0.0

    # 2. The motors follow the reference, or rest.
    if idle and abs(state[V_REF_MPS]) < STILL_MPS and abs(state[W_REF_RADPS]) < _STILL_RADPS:
        # Nothing is left over for the next start, which the controllers begin from rest.
        state[:IDLE_S] = 0.0
        if state[IDLE_S] >= setting[_BRAKE_AFTER]:
            return 0.0, 0.0, setting[_BRAKE_TORQUE], setting[_BRAKE_TORQUE]
    else:
        _control(state, v_mps, setting)
    half = setting[_HALF_TRACK] * state[W_REF_RADPS]
    left = (state[V_MOTOR_MPS] - half) / setting[_RADIUS]
    right = (state[V_MOTOR_MPS] + half) / setting[_RADIUS]

    # 3. Steering is first: with both motors at their limit, uphill, the chair would turn across
    # the slope.
    ahead = (left_radps - right_radps) - (left - right)
    return (
        left,
        right,
        _motor_torque_Nm(left_radps, setting) * _steered(ahead, left - left_radps),
        _motor_torque_Nm(right_radps, setting) * _steered(-ahead, right - right_radps),
    )
