"""From a joystick position to wheel motors: mapping, limits of acceleration and jerk, two PI controllers, motor curve.

Linear velocity is held by two PI controllers, throttle and brake, as in the paper; angular velocity is set directly
within its limits. What they give are target speeds for the two motors, whose torque ends where that of a DC motor does.
All of it is compiled, and works on an array of memory (`new_state`) and one of settings (`settings`).
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
SPEED_BAND_MPS: Final = 0.25  # how far the controllers may lead the speed that is wanted
STEER_S: Final = 10.0  # share of its torque that a wheel loses for each rad/s by which it outruns the turn asked for
_STILL_RADPS: Final = 1e-3

# memory of the controllers
V_REF_MPS, A_REF_MPS2, W_REF_RADPS, V_MOTOR_MPS = 0, 1, 2, 3
THROTTLE_MPS2, BRAKE_MPS2 = 4, 5  # integral parts of the two PI controllers
IDLE_S, STICK_X, STICK_Y = 6, 7, 8
_STATE_SIZE: Final = 9

# settings; the first are the limits of `wcsim.core.joystick`
_DT_S, _DEADBAND, _EXPONENT, _SMOOTHING, _BRAKE_AFTER = range(8, 13)
_HALF_TRACK, _RADIUS = 13, 14
_STALL, _NO_LOAD, _LEAST_SHARE, _BRAKE_TORQUE = 15, 16, 17, 18


def new_state() -> F64:
    """Memory of the controllers of a chair that stands."""
    return np.zeros(_STATE_SIZE)


def settings(chair: ChairConfig, spec: PlantSpec, dt_s: float) -> F64:
    """Everything that `step` must know of a chair, for control steps of `dt_s`."""
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
    """Way to a stop from a steady speed with limited jerk: v^2 / 2a + v a / 2j, when there is time to reach a.

    >>> round(stopping_distance_m(1.67, 1.5, 4.0), 3)
    1.243
    """
    # From a low speed the chair stands before its jerk has built up the whole deceleration.
    full = min(decel_mps2, math.sqrt(jerk_mps3 * abs(v_mps)))
    return 0.5 * v_mps * v_mps / full + 0.5 * abs(v_mps) * full / jerk_mps3


def speed_mps(axle_mps: float, wheels_mps: float) -> float:
    """The speed that the controllers take for the chair's: that of its axle, but near that of its wheels.

    A chair that turns on the spot creeps a little without its wheels' knowing, which the axle's speed corrects. Where
    one wheel has no grip, as across a ramp, the axle swings round the other one, and holding its speed would brake the
    only wheel that can steer.
    """
    return wheels_mps + min(max(axle_mps - wheels_mps, -SLIP_MPS), SLIP_MPS)


@compile_exact_kernel
def _target(x: float, y: float, v_ref_mps: float, setting: F64) -> tuple[float, float]:
    """The speeds that a joystick position asks for: forward in m/s, turn to the left in rad/s.

    The position is pulled to the unit disc first. The faster of reference speed and speed asked for limits the turn;
    the measured speed would not do, because the axle of a chair that turns in place trembles.

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
    """What a motor gives at most at a wheel speed: falling from the stall torque to the no-load speed."""
    return float(setting[_STALL] * max(setting[_LEAST_SHARE], 1.0 - abs(wheel_radps) / setting[_NO_LOAD]))


@compile_exact_kernel
def _control(state: F64, v_mps: float, setting: F64) -> None:
    """Throttle or brake: the motors' speed moves on by the acceleration that the controller in charge gives.

    A PI controller with a feed-forward part; its integral rests while the output is at a bound.
    """
    dt_s, v_ref = setting[_DT_S], state[V_REF_MPS]
    # At a reference of exactly 0 the acceleration says which way the chair is about to go.
    forward = 1.0 if v_ref + 1e-9 * state[A_REF_MPS2] >= 0.0 else -1.0
    error = forward * (v_ref - v_mps)
    out = forward * state[A_REF_MPS2] + PI_KP_PER_S * error
    if out >= 0.0:
        charge, rest = THROTTLE_MPS2, BRAKE_MPS2
        # Twice the limit: the reference's acceleration takes up to one of it, the error needs the other.
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
    state: F64, setting: F64, x: float, y: float, v_mps: float, left_radps: float, right_radps: float
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
    _damped(state, x, y, setting)
    v_wanted, w_wanted = _target(state[STICK_X], state[STICK_Y], state[V_REF_MPS], setting)
    idle = v_wanted == 0.0 and w_wanted == 0.0
    state[V_REF_MPS], state[A_REF_MPS2] = advance_speed(
        state[V_REF_MPS], state[A_REF_MPS2], v_wanted, setting, setting[_DT_S]
    )
    state[W_REF_RADPS] = move_towards(state[W_REF_RADPS], w_wanted, setting[YAW_ACCEL] * setting[_DT_S])
    state[IDLE_S] = state[IDLE_S] + setting[_DT_S] if idle else 0.0
    if idle and abs(state[V_REF_MPS]) < STILL_MPS and abs(state[W_REF_RADPS]) < _STILL_RADPS:
        # Nothing is left over for the next start: the controllers begin it from rest.
        state[:IDLE_S] = 0.0
        if state[IDLE_S] >= setting[_BRAKE_AFTER]:
            return 0.0, 0.0, setting[_BRAKE_TORQUE], setting[_BRAKE_TORQUE]
    else:
        _control(state, v_mps, setting)
    half = setting[_HALF_TRACK] * state[W_REF_RADPS]
    left = (state[V_MOTOR_MPS] - half) / setting[_RADIUS]
    right = (state[V_MOTOR_MPS] + half) / setting[_RADIUS]
    # steering comes first: where both motors are at their limit, uphill, the chair would turn across the slope
    ahead = (left_radps - right_radps) - (left - right)
    return (
        left,
        right,
        _motor_torque_Nm(left_radps, setting) * _steered(ahead, left - left_radps),
        _motor_torque_Nm(right_radps, setting) * _steered(-ahead, right - right_radps),
    )
