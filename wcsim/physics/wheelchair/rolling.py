"""A chair that rolls over a plane with nothing in reach, without Bullet.

Its wheels do not slip and its casters trail, so a tick is one call of a compiled kernel. Drive
controller, motors and what the sensors sample are those of a chair in the engine. One that hangs on
springs alone pitches about its drive axle. What is left out: slip of the tyres, and the friction of
the casters' swivels (docs/adr/017-rolling-without-the-engine.md has the errors).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, cast

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.constants import GRAVITY_MPS2
from wcsim.core.frames import (
    Rotation,
    add_vectors,
    matrix_from_quaternion,
    quaternion_from_ypr,
    rotate_vector,
    rotate_vector_inverse,
    rpy_from_matrix,
)
from wcsim.core.jit import compile_exact_kernel
from wcsim.physics.sensors.imu import ROW
from wcsim.physics.wheelchair import drive_controller
from wcsim.physics.wheelchair.contacts import Motion
from wcsim.physics.wheelchair.plant import PlantSpec
from wcsim.types import F64, Joystick, PlantState

# A chair that can roll is no further off the plane, does not rock, and its wheels do not slip.
_LIFTED_M: Final = 0.008
_LEANING: Final = 0.02
_NODDING: Final = 0.06  # on springs
_ROCKING_RADPS: Final = 0.25
_SLIPPING_MPS: Final = 0.02
_HOPPING_MPS: Final = 0.05
# In Bullet a wheel feels the edges between the ground's triangles: a blow every metre or so.
_NOTCH_M: Final = 0.05
_NOTCHES_A_BLOW: Final = 16
_BLOW_MPS: Final = 0.004

# The state that a tick changes: place on the plane, heading, speed and turn of both drive wheels,
# pitch with its rate.
_X, _Y, _YAW, _LEFT_RADPS, _RIGHT_RADPS, _LEFT_RAD, _RIGHT_RAD, _PITCH, _PITCH_RADPS = range(9)
_ANGLE, _SPIN_RADPS, _TURNED = range(3)  # of each caster
_OWN, _OTHER, _AHEAD, _ASIDE, _HALF_M, _RADIUS_M, _COM_X_M, _COM_Z_M = range(8)


class Plane(NamedTuple):
    """The ground under and around a chair: its height at the chair's place, and its two slopes."""

    z_m: float
    rise_x: float
    rise_y: float


class RolledTick(NamedTuple):
    """What a tick of rolling leads to."""

    motion: Motion
    memory: F64  # of the drive controller
    rows: F64  # (steps, ROW) what the sensors sample, see `physics/sensors/imu.py`
    hubs_W_m: F64  # (steps, 2 + n, 3) middles of the drive wheels and casters


@dataclass(frozen=True, slots=True, kw_only=True)
class RollingPlant:
    """The numbers of a plant that matter where it rolls."""

    # (8,) what a drive wheel has to turn, by itself and by the other one (kg m2); mass, mass times
    # its place ahead of the axle; half of the track, radius; the frame's centre of mass (x, z).
    drive: F64
    casters: F64  # (n, 4): the swivel's place in B (x, y), trail and radius
    # (4,) of a chair on springs: stiffness, damping and push by an acceleration, each by inertia,
    # and the pitch at rest; all zero of one that a rigid caster holds level.
    springs: F64
    joints: tuple[tuple[int, int, int], ...]  # of each caster: swivel, wheel, arm (-1: none)
    steepest: float  # slope from which on a drive wheel might slip

    @classmethod
    def of(cls, spec: PlantSpec, chair: ChairConfig, joint_of: Mapping[str, int]) -> RollingPlant:
        """From a plant, the limits of its drive, and the places of its joints in `Motion` by name."""
        # 1. What the drive wheels turn; half of a push is the other wheel's.
        radius_m, half_m, mass_kg = spec.wheel.radius_m, 0.5 * spec.wheel.track_m, spec.whole_kg
        com_x_m, _, com_z_m = spec.frame_com_m
        turn_kgm2 = spec.frame_inertia_kgm2[2] + spec.frame_mass_kg * com_x_m**2
        turn_kgm2 += sum(mass * (p[0] ** 2 + p[1] ** 2) for mass, p, _ in spec.parts())
        along = 0.25 * mass_kg * radius_m**2
        turning = 0.25 * turn_kgm2 * (radius_m / half_m) ** 2
        aside_kgm = mass_kg * spec.mass.com_x_m
        own = along + turning + spec.drive_inertia_kgm2[1]
        drive = [own, along - turning, mass_kg, aside_kgm, half_m, radius_m, com_x_m, com_z_m]

        # 2. The springs, where no rigid caster holds it level.
        springs = np.zeros(4)
        balance = spec.spring_balance()
        if balance is not None:
            moment_Nm, stiffness_Nmprad, damping_Nmsprad = balance
            body_kgm2 = spec.frame_inertia_kgm2[1] + spec.frame_mass_kg * (com_x_m**2 + com_z_m**2)
            numbers = stiffness_Nmprad, damping_Nmsprad, spec.frame_mass_kg * com_z_m
            springs = np.array([*(number / body_kgm2 for number in numbers), -moment_Nm / stiffness_Nmprad])

        # 3. The slope that leaves no grip: half of the weight, at least, lies on the drive wheels.
        push_mps2 = 2.0 * max(chair.accel_mps2, chair.decel_mps2)  # as far as the controllers go
        aside_mps2 = 0.5 * chair.v_max_mps * chair.yaw_rate_max_radps
        spare_mps2 = 0.5 * spec.wheel.friction * GRAVITY_MPS2 - math.hypot(push_mps2, aside_mps2)
        casters = [
            (pair.swivel_x_m, side * 0.5 * pair.track_m, pair.trail_m, pair.radius_m)
            for pair in spec.casters
            for side in (1.0, -1.0)
        ]
        names = [f"{number}_{side}" for number in range(len(spec.casters)) for side in "lr"]
        return cls(
            drive=np.array(drive),
            casters=np.array(casters),
            springs=springs,
            joints=tuple(
                (joint_of[f"swivel_{name}"], joint_of[f"caster_{name}"], joint_of.get(f"arm_{name}", -1))
                for name in names
            ),
            steepest=spare_mps2 / GRAVITY_MPS2,
        )

    def can_roll(self, state: PlantState, rotation: Rotation, plane: Plane) -> bool:
        """Whether a chair stands on that plane with its wheels rolling, and has grip to spare there."""
        radius_m, half_m = float(self.drive[_RADIUS_M]), float(self.drive[_HALF_M])
        ahead_mps, aside_mps, up_mps = state.v_B_mps.tolist()
        rock_radps, nod_radps, turn_radps = state.w_B_radps.tolist()
        left_mps, right_mps = (radius_m * state.wheel_radps).tolist()
        lean_x, lean_y, _ = rotate_vector_inverse(rotation, *_tilt(plane)[:, 2].tolist())
        return (
            max(abs(ahead_mps - turn_radps * half_m - left_mps), abs(aside_mps)) < _SLIPPING_MPS
            and abs(ahead_mps + turn_radps * half_m - right_mps) < _SLIPPING_MPS
            and abs(up_mps) < _HOPPING_MPS
            and math.hypot(rock_radps, nod_radps) < _ROCKING_RADPS
            and abs(lean_x) < (_NODDING if self.springs[0] else _LEANING)
            and abs(lean_y) < _LEANING
            and abs(float(state.p_WB_m[2]) - plane.z_m) < _LIFTED_M
            and math.hypot(plane.rise_x, plane.rise_y) < self.steepest
        )

    def tick(
        self,
        motion: Motion,
        plane: Plane,
        memory: F64,
        setting: F64,
        stick: Joystick,
        steps: int,
        dt_s: float,
    ) -> RolledTick:
        """What a tick of so many steps leads to; nothing of what is given changes.

        Args:
            motion: How the chair moves now.
            plane: What it stands on.
            memory: Of its drive controller.
            setting: Of its drive controller.
            stick: What its driver wants.
            steps: In the tick.
            dt_s: A step.
        """
        # 1. The chair as it stands on the plane: heading, pitch, and what is left of its rotation.
        tilt, com_B_m = _tilt(plane), (float(self.drive[_COM_X_M]), 0.0, float(self.drive[_COM_Z_M]))
        rotation = matrix_from_quaternion(motion.q_WB)
        lean = tilt.T @ np.array(rotation).reshape(3, 3)
        yaw_rad = math.atan2(lean[1, 0], lean[0, 0])
        pitch_rad = math.asin(lean[2, 0])
        turn = np.array(matrix_from_quaternion(quaternion_from_ypr(yaw_rad, pitch_rad)))
        lean = turn.reshape(3, 3).T @ lean
        nod_radps = -rotate_vector_inverse(rotation, *motion.w_W_radps)[1] if self.springs[0] else 0.0
        (left_rad, left_radps, *_), (right_rad, right_radps, *_), *_ = joints = list(motion.joints)
        wheels = left_radps, right_radps, left_rad, right_rad
        state = np.array([0.0, 0.0, yaw_rad, *wheels, pitch_rad, nod_radps])
        casters = [(joints[swivel], joints[wheel]) for swivel, wheel, _ in self.joints]
        turning = np.array([(swivel[0], wheel[1], wheel[0]) for swivel, wheel in casters])

        # 2. The tick.
        memory, push = memory.copy(), (stick.x, stick.y)
        rows, hubs_m = np.empty((steps, ROW)), np.empty((steps, 2 + len(casters), 3))
        numbers = self.drive, self.casters, self.springs
        _roll(state, turning, memory, setting, *numbers, tilt, lean, push, dt_s, rows, hubs_m)

        # 3. The chair as it moves then.
        last = rows[-1].tolist()
        after = cast(Rotation, tuple(last[:9]))
        origin_W_m = np.subtract(motion.p_W_m, rotate_vector(rotation, *com_B_m))
        there_W_m = (origin_W_m + tilt @ (state[_X], state[_Y], 0.0)).tolist()
        roll_rad, pitch_rad, yaw_rad = rpy_from_matrix(after)
        *_, left_radps, right_radps, left_rad, right_rad, pitch, nod = state.tolist()
        joints[:2] = (left_rad, left_radps), (right_rad, right_radps)
        places_m = self.casters[:, 0].tolist()
        for at, x_m, (angle, spin, turned) in zip(self.joints, places_m, turning.tolist(), strict=True):
            swivel, wheel, arm = at
            joints[swivel], joints[wheel] = (angle, 0.0), (turned, spin)
            if self.springs[0]:
                joints[arm] = (-x_m * pitch, -x_m * nod)
        return RolledTick(
            motion=Motion(
                add_vectors(tuple(there_W_m), rotate_vector(after, *com_B_m)),
                quaternion_from_ypr(yaw_rad, pitch_rad, roll_rad),
                tuple(last[9:12]),
                tuple(last[12:]),
                joints,
            ),
            memory=memory,
            rows=rows,
            hubs_W_m=hubs_m + np.array([*origin_W_m[:2], plane.z_m]),
        )


def _tilt(plane: Plane) -> F64:
    """(3, 3) the smallest turn that takes the world's vertical to the plane's."""
    length = math.sqrt(1.0 + plane.rise_x**2 + plane.rise_y**2)
    x, y, z = -plane.rise_x / length, -plane.rise_y / length, 1.0 / length
    k = 1.0 / (1.0 + z)
    return np.array([[1.0 - k * x * x, -k * x * y, x], [-k * x * y, 1.0 - k * y * y, y], [-x, -y, z]])


@compile_exact_kernel
def _roll(
    state: F64,
    turning: F64,
    memory: F64,
    setting: F64,
    drive: F64,
    casters: F64,
    springs: F64,
    tilt: F64,
    lean: F64,
    stick: tuple[float, float],
    dt_s: float,
    rows: F64,
    hubs: F64,
) -> None:
    """Carry a chair through the steps of a tick.

    Args:
        state: (9,) changed in place.
        turning: (n, 3) of each caster, changed in place.
        memory: The drive controller's, changed in place.
        setting: The drive controller's.
        drive: Of `RollingPlant`.
        casters: Of `RollingPlant`.
        springs: Of `RollingPlant`.
        tilt: (3, 3) the plane's.
        lean: (3, 3) the chair's rotation against the plane, without heading and pitch; it stays.
        stick: What the driver wants: right, forward.
        dt_s: A step.
        rows: (steps, ROW) takes what the sensors sample, see `physics/sensors/imu.py`.
        hubs: (steps, 2 + n, 3) takes the middles of the wheels from the chair's first place, in W.
    """
    own, other, radius, half = drive[_OWN], drive[_OTHER], drive[_RADIUS_M], drive[_HALF_M]
    det = own * own - other * other
    body = np.empty((3, 3))
    for n in range(len(rows)):
        left, right = state[_LEFT_RADPS], state[_RIGHT_RADPS]
        v, w = 0.5 * radius * (left + right), 0.5 * radius * (right - left) / half
        # 1. What the motors are told, and what they can. The axle nods back above the ground.
        axle = v - radius * state[_PITCH_RADPS]
        told = drive_controller.step(memory, setting, stick[0], stick[1], axle, left, right)
        cos, sin = math.cos(state[_YAW]), math.sin(state[_YAW])
        # Gravity along the plane, in the chair's frame, and the pull of its mass ahead of the axle.
        ahead = -GRAVITY_MPS2 * (tilt[2, 0] * cos + tilt[2, 1] * sin)
        aside = -GRAVITY_MPS2 * (tilt[2, 1] * cos - tilt[2, 0] * sin)
        push_N = drive[_AHEAD] * ahead + drive[_ASIDE] * w * w
        twist_Nm = drive[_ASIDE] * (aside - v * w)
        load_left = 0.5 * radius * (push_N - twist_Nm / half)
        load_right = 0.5 * radius * (push_N + twist_Nm / half)
        gain_left, gain_right = (told[0] - left) / dt_s, (told[1] - right) / dt_s
        torque_left = own * gain_left + other * gain_right - load_left
        torque_right = own * gain_right + other * gain_left - load_right
        torque_left = min(max(torque_left, -told[2]), told[2]) + load_left
        torque_right = min(max(torque_right, -told[3]), told[3]) + load_right
        left += dt_s * (own * torque_left - other * torque_right) / det
        right += dt_s * (own * torque_right - other * torque_left) / det
        # 2. Both wheels roll, and springs give way to what pushes the chair back.
        before = v
        v, w = 0.5 * radius * (left + right), 0.5 * radius * (right - left) / half
        push_mps2 = (v - before) / dt_s - ahead
        state[_PITCH_RADPS] += dt_s * (
            springs[2] * push_mps2 - springs[0] * (state[_PITCH] - springs[3]) - springs[1] * state[_PITCH_RADPS]
        )
        state[_PITCH] += state[_PITCH_RADPS] * dt_s
        middle = state[_YAW] + 0.5 * w * dt_s
        state[_X] += v * math.cos(middle) * dt_s
        state[_Y] += v * math.sin(middle) * dt_s
        state[_YAW] += w * dt_s
        state[_LEFT_RADPS], state[_RIGHT_RADPS] = left, right
        blow = _blow(state[_LEFT_RAD], left * dt_s, radius) + _blow(state[_RIGHT_RAD], right * dt_s, radius)
        state[_LEFT_RAD] += left * dt_s
        state[_RIGHT_RAD] += right * dt_s
        cos, sin = math.cos(state[_YAW]), math.sin(state[_YAW])
        # 3. What the sensors sample: rotation, velocity of the frame's centre of mass, turn rate.
        pitch_cos, pitch_sin = math.cos(state[_PITCH]), math.sin(state[_PITCH])
        for k in range(3):
            along = pitch_cos * lean[0, k] - pitch_sin * lean[2, k]
            body[0, k] = cos * along - sin * lean[1, k]
            body[1, k] = sin * along + cos * lean[1, k]
            body[2, k] = pitch_sin * lean[0, k] + pitch_cos * lean[2, k]
        nod = state[_PITCH_RADPS]
        surge, swing = v - nod * drive[_COM_Z_M] - blow, w * drive[_COM_X_M] + blow
        vx, vy, vz = cos * surge - sin * swing, sin * surge + cos * swing, nod * drive[_COM_X_M] + 0.5 * blow
        for i in range(3):
            for k in range(3):
                rows[n, 3 * i + k] = tilt[i, 0] * body[0, k] + tilt[i, 1] * body[1, k] + tilt[i, 2] * body[2, k]
            rows[n, 9 + i] = tilt[i, 0] * vx + tilt[i, 1] * vy + tilt[i, 2] * vz
            rows[n, 12 + i] = tilt[i, 0] * nod * sin - tilt[i, 1] * nod * cos + tilt[i, 2] * w
        # 4. Casters trail: the hub of each goes where its wheel points.
        for k in range(2 + len(casters)):
            if k < 2:
                bx, by, bz = 0.0, half if k == 0 else -half, radius
            else:
                x, y, trail, bz = casters[k - 2]
                angle = turning[k - 2, _ANGLE]
                px, py = v - w * y, w * x
                rate = (py * math.cos(angle) - px * math.sin(angle)) / trail - w
                angle += rate * dt_s
                turning[k - 2, _ANGLE] = angle
                spin = (px * math.cos(angle) + py * math.sin(angle)) / bz
                turning[k - 2, _SPIN_RADPS] = spin
                turning[k - 2, _TURNED] += spin * dt_s
                bx, by = x - trail * math.cos(angle), y - trail * math.sin(angle)
            hx = state[_X] + cos * bx - sin * by
            hy = state[_Y] + sin * bx + cos * by
            for i in range(3):
                hubs[n, k, i] = tilt[i, 0] * hx + tilt[i, 1] * hy + tilt[i, 2] * bz


@compile_exact_kernel
def _blow(turned_rad: float, turn_rad: float, radius_m: float) -> float:
    """The speed that an edge of the ground gives a wheel in a step: by its way, the same each time."""
    notch = math.floor((turned_rad + turn_rad) * radius_m / _NOTCH_M)
    if notch == math.floor(turned_rad * radius_m / _NOTCH_M):
        return 0.0
    drawn = (notch * 2654435761 + 12345) & 0xFFFFFFFF
    drawn = ((drawn ^ (drawn >> 15)) * 2246822519) & 0xFFFFFFFF
    drawn ^= drawn >> 13
    if drawn % _NOTCHES_A_BLOW:
        return 0.0
    size = _BLOW_MPS * float((drawn >> 8) & 0xFF) / 255.0
    return size if drawn & 0x10000 else -size
