"""The drive controllers in plain Python, which those that are compiled must equal."""

import math
from dataclasses import dataclass, field

from wcsim.config import ChairConfig
from wcsim.physics.wheelchair.drive_controller import PI_KI_PER_S2, PI_KP_PER_S, SPEED_BAND_MPS, STEER_S
from wcsim.physics.wheelchair.plant import PlantSpec
from wcsim.types import Joystick

STILL = 1e-3  # m/s and rad/s


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """What a joystick position asks for."""

    v_mps: float  # forward positive
    w_radps: float  # to the left positive


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelCommand:
    """Targets and torque limits for the left and the right motor."""

    radps: tuple[float, float]
    torque_Nm: tuple[float, float]


@dataclass(slots=True)
class PiState:
    """Memory of one PI controller: its integral part, in m/s2."""

    integral_mps2: float = 0.0


@dataclass(slots=True)
class DriveState:
    """Memory of the drive controllers of one chair."""

    v_ref_mps: float = 0.0
    a_ref_mps2: float = 0.0
    w_ref_radps: float = 0.0
    v_motor_mps: float = 0.0
    throttle: PiState = field(default_factory=PiState)
    brake: PiState = field(default_factory=PiState)
    idle_s: float = 0.0
    stick: Joystick = field(default_factory=lambda: Joystick(0.0, 0.0))


def shaped(joystick: Joystick, deadband: float, exponent: float) -> Joystick:
    """A joystick position inside the unit disc, without its deadband, then shaped along its radius."""
    radius = math.sqrt(joystick.x * joystick.x + joystick.y * joystick.y)
    if not radius > deadband:
        return Joystick(0.0, 0.0)
    out = ((min(radius, 1.0) - deadband) / (1.0 - deadband)) ** exponent
    return Joystick(joystick.x / radius * out, joystick.y / radius * out)


def target(joystick: Joystick, v_ref_mps: float, chair: ChairConfig) -> Target:
    """The speeds that a joystick position asks for; the faster of reference speed and speed asked for limits the turn.

    Args:
        joystick: The position; it is pulled to the unit disc first.
        v_ref_mps: Speed that the controllers hold at the moment.
        chair: Limits and shape.
    """
    stick = shaped(joystick, chair.deadband, chair.shape_exponent)
    v = stick.y * chair.v_max_mps * (chair.reverse_share if stick.y < 0.0 else 1.0)
    limit = chair.yaw_rate_max_radps / (1.0 + 0.6 * max(abs(v), abs(v_ref_mps)))
    return Target(v_mps=v, w_radps=0.0 - stick.x * limit)


def step(
    state: DriveState,
    joystick: Joystick,
    v_mps: float,
    wheel_radps: tuple[float, float],
    chair: ChairConfig,
    spec: PlantSpec,
    dt_s: float,
) -> WheelCommand:
    """One control step: `state` is moved on by `dt_s`, the command holds for the physics step to come.

    Args:
        state: The chair's memory, changed in place.
        joystick: What the driver wants now.
        v_mps: Measured forward speed of the drive axle.
        wheel_radps: Measured speeds of the left and the right drive wheel.
        chair: Limits of the drive.
        spec: The plant's wheels and motors.
        dt_s: Length of the step.
    """
    state.stick = damped(state.stick, joystick, chair.tremor_damping_s, dt_s)
    wanted = target(state.stick, state.v_ref_mps, chair)
    idle = wanted.v_mps == 0.0 and wanted.w_radps == 0.0
    _follow_speed(state, wanted.v_mps, chair, dt_s)
    state.w_ref_radps = _towards(state.w_ref_radps, wanted.w_radps, chair.yaw_accel_radps2 * dt_s)
    state.idle_s = state.idle_s + dt_s if idle else 0.0
    if idle and abs(state.v_ref_mps) < STILL and abs(state.w_ref_radps) < STILL:
        _stand(state)
        if state.idle_s >= chair.brake_after_s:
            return WheelCommand(radps=(0.0, 0.0), torque_Nm=(spec.motor.brake_torque_Nm, spec.motor.brake_torque_Nm))
    else:
        _control(state, v_mps, chair, dt_s)
    half = 0.5 * spec.wheel.track_m * state.w_ref_radps
    left = (state.v_motor_mps - half) / spec.wheel.radius_m
    right = (state.v_motor_mps + half) / spec.wheel.radius_m
    ahead = (wheel_radps[0] - wheel_radps[1]) - (left - right)
    shares = (_steered(ahead, left - wheel_radps[0]), _steered(-ahead, right - wheel_radps[1]))
    return WheelCommand(
        radps=(left, right),
        torque_Nm=(
            motor_torque_Nm(wheel_radps[0], spec) * shares[0],
            motor_torque_Nm(wheel_radps[1], spec) * shares[1],
        ),
    )


def _steered(ahead_radps: float, push_radps: float) -> float:
    """Share of its torque for a wheel that is ahead of the other one and is pushed on."""
    return max(0.0, 1.0 - STEER_S * abs(ahead_radps)) if ahead_radps * push_radps > 0.0 else 1.0


def damped(old: Joystick, new: Joystick, time_s: float, dt_s: float) -> Joystick:
    """First-order low-pass."""
    if time_s == 0.0:
        return new
    share = 1.0 - math.exp(-dt_s / time_s)
    return Joystick(old.x + share * (new.x - old.x), old.y + share * (new.y - old.y))


def motor_torque_Nm(wheel_radps: float, spec: PlantSpec) -> float:
    """What a motor gives at most at a wheel speed: falling from the stall torque to the no-load speed."""
    motor = spec.motor
    return motor.stall_torque_Nm * max(motor.least_torque_share, 1.0 - abs(wheel_radps) / motor.no_load_radps)


def _follow_speed(state: DriveState, v_wanted_mps: float, chair: ChairConfig, dt_s: float) -> None:
    """Move the reference speed towards the wanted one within the limits of acceleration and jerk."""
    gap = v_wanted_mps - state.v_ref_mps
    slowing = state.v_ref_mps * gap < 0.0
    limit = chair.decel_mps2 if slowing else chair.accel_mps2
    # sqrt(2 j |gap|) is the acceleration from which a jerk of j ends exactly at the wanted speed; one step ahead, so
    # that the jerk has not to catch up at the end
    ahead = gap - state.a_ref_mps2 * dt_s
    a_wanted = math.copysign(min(limit, math.sqrt(2.0 * chair.jerk_mps3 * abs(ahead))), ahead)
    state.a_ref_mps2 = _towards(state.a_ref_mps2, a_wanted, chair.jerk_mps3 * dt_s)
    move = state.a_ref_mps2 * dt_s
    if abs(gap) <= abs(move) + STILL * dt_s and abs(state.a_ref_mps2) <= 2.0 * chair.jerk_mps3 * dt_s + 0.1:
        state.v_ref_mps, state.a_ref_mps2 = v_wanted_mps, 0.0
    else:
        state.v_ref_mps += move


def _control(state: DriveState, v_mps: float, chair: ChairConfig, dt_s: float) -> None:
    """Throttle or brake: the motors' speed moves on by the acceleration that the controller in charge gives."""
    forward = 1.0 if state.v_ref_mps + 1e-9 * state.a_ref_mps2 >= 0.0 else -1.0
    error = forward * (state.v_ref_mps - v_mps)
    feed = forward * state.a_ref_mps2
    if feed + PI_KP_PER_S * error >= 0.0:
        state.brake.integral_mps2 = 0.0
        a = _pi(state.throttle, error, feed, (0.0, 2.0 * chair.accel_mps2), dt_s)
    else:
        state.throttle.integral_mps2 = 0.0
        a = _pi(state.brake, error, feed, (-2.0 * chair.decel_mps2, 0.0), dt_s)
    motor = state.v_motor_mps + forward * a * dt_s
    state.v_motor_mps = min(max(motor, state.v_ref_mps - SPEED_BAND_MPS), state.v_ref_mps + SPEED_BAND_MPS)


def _pi(state: PiState, error_mps: float, feed_mps2: float, bounds: tuple[float, float], dt_s: float) -> float:
    """PI controller with a feed-forward part; its integral rests while the output is at a bound."""
    out = feed_mps2 + PI_KP_PER_S * error_mps + state.integral_mps2
    held = min(max(out, bounds[0]), bounds[1])
    if out == held:
        state.integral_mps2 += PI_KI_PER_S2 * error_mps * dt_s
    return held


def _stand(state: DriveState) -> None:
    state.v_ref_mps = state.a_ref_mps2 = state.w_ref_radps = state.v_motor_mps = 0.0
    state.throttle.integral_mps2 = state.brake.integral_mps2 = 0.0


def _towards(value: float, goal: float, most: float) -> float:
    return value + min(max(goal - value, -most), most)
