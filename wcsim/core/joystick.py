"""The one law by which a chair's controller follows a joystick.

It has a dead band, a shape, and limits of speed, acceleration and jerk. The drive
(`physics/wheelchair/drive_controller.py`) obeys it, the oracle and `dwa` predict by it, and the
simulated user steers by its inverse.
"""

import math
from typing import Final, Protocol

import numpy as np

from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F64

STILL_MPS: Final = 1e-3

# Places in the limits of a drive (8,).
V_MAX, REVERSE, ACCEL, DECEL, JERK, YAW_MAX, YAW_ACCEL, YAW_SLOWDOWN = range(8)


class _DriveSettings(Protocol):
    """The settings of a chair's controller, as in `wcsim.config.ChairConfig`."""

    @property
    def v_max_mps(self) -> float: ...
    @property
    def reverse_share(self) -> float: ...
    @property
    def accel_mps2(self) -> float: ...
    @property
    def decel_mps2(self) -> float: ...
    @property
    def jerk_mps3(self) -> float: ...
    @property
    def yaw_rate_max_radps(self) -> float: ...
    @property
    def yaw_accel_radps2(self) -> float: ...
    @property
    def yaw_slowdown_s_per_m(self) -> float: ...
    @property
    def deadband(self) -> float: ...
    @property
    def shape_exponent(self) -> float: ...


def drive_limits_from_chair(chair: _DriveSettings) -> F64:
    """The limits of a drive (8,), in the order of the names above."""
    speeds = (
        chair.v_max_mps,
        chair.reverse_share,
        chair.accel_mps2,
        chair.decel_mps2,
        chair.jerk_mps3,
    )
    return np.array(
        [*speeds, chair.yaw_rate_max_radps, chair.yaw_accel_radps2, chair.yaw_slowdown_s_per_m]
    )


def shape_joysticks(joysticks: F64, chair: _DriveSettings) -> F64:
    """Joystick positions (K, 2) as the drive takes them, see `shape_joystick`."""
    rows = [
        shape_joystick(x, y, chair.deadband, chair.shape_exponent) for x, y in joysticks.tolist()
    ]
    return np.array(rows, np.float64).reshape(-1, 2)


def raw_radius_from_shaped(radius: float, chair: _DriveSettings) -> float:
    """How far out a stick must be for `shape_joystick` to give `radius`.

    >>> from wcsim.config import ChairConfig
    >>> round(raw_radius_from_shaped(0.5, ChairConfig(deadband=0.1)), 3)
    0.55
    >>> raw_radius_from_shaped(0.0, ChairConfig())
    0.08
    """
    shape: float = radius ** (1.0 / chair.shape_exponent)
    return min(1.0, chair.deadband + (1.0 - chair.deadband) * shape)


@compile_exact_kernel
def shape_joystick(x: float, y: float, deadband: float, exponent: float) -> tuple[float, float]:
    """A joystick position within the unit disc, without the deadband, shaped along its radius."""
    radius = math.sqrt(x * x + y * y)
    if not radius > deadband:
        return 0.0, 0.0
    out = ((min(radius, 1.0) - deadband) / (1.0 - deadband)) ** exponent
    return x / radius * out, y / radius * out


@compile_exact_kernel
def compute_yaw_rate_limit(v_mps: float, yaw_max_radps: float, slowdown_s_per_m: float) -> float:
    """The fastest turn at a speed, in rad/s: full in place, slower the faster the chair drives."""
    return yaw_max_radps / (1.0 + slowdown_s_per_m * abs(v_mps))


@compile_exact_kernel
def target_speeds(x: float, y: float, v_now_mps: float, limits: F64) -> tuple[float, float]:
    """The target speeds of a shaped joystick position: forward in m/s, turn to the left in rad/s.

    The faster of the current and the target speed limits the turn.
    """
    v = y * limits[V_MAX]
    if y < 0.0:
        v *= limits[REVERSE]
    return v, 0.0 - x * compute_yaw_rate_limit(
        max(abs(v), abs(v_now_mps)), limits[YAW_MAX], limits[YAW_SLOWDOWN]
    )


@compile_exact_kernel
def move_towards(value: float, goal: float, most: float) -> float:
    """A value moved towards a goal, by so much at most."""
    return value + min(max(goal - value, -most), most)


@compile_exact_kernel
def advance_speed(
    v_mps: float, a_mps2: float, v_target_mps: float, limits: F64, dt_s: float
) -> tuple[float, float]:
    """Speed and acceleration `dt_s` later, without overshoot; acceleration and jerk are limited."""
    jerk = limits[JERK]
    gap = v_target_mps - v_mps
    limit = limits[DECEL] if v_mps * gap < 0.0 else limits[ACCEL]
    # From an acceleration of sqrt(2 j |gap|) a jerk of j ends exactly at the target speed. It is
    # taken one step ahead, so that the jerk need not catch up at the end.
    ahead = gap - a_mps2 * dt_s
    a_target = math.copysign(min(limit, math.sqrt(2.0 * jerk * abs(ahead))), ahead)
    a_mps2 = move_towards(a_mps2, a_target, jerk * dt_s)
    move = a_mps2 * dt_s
    if abs(gap) <= abs(move) + STILL_MPS * dt_s and abs(a_mps2) <= 2.0 * jerk * dt_s + 0.1:
        return v_target_mps, 0.0
    return v_mps + move, a_mps2


@compile_exact_kernel
def advance_drive(
    v: float, w: float, a: float, stick_x: float, stick_y: float, limits: F64, dt_s: float
) -> tuple[float, float, float]:
    """Speed, turn rate and acceleration `dt_s` later; the drive follows a shaped stick.

    `limits` (8,) are in the order of the names above.
    """
    v_target, w_target = target_speeds(stick_x, stick_y, v, limits)
    v, a = advance_speed(v, a, v_target, limits, dt_s)
    return v, move_towards(w, w_target, limits[YAW_ACCEL] * dt_s), a
