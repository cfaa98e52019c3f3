"""A chair that rolls over a plane with nothing in reach, without Bullet.

Its wheels do not slip and its casters trail, so a tick is one call of a compiled kernel. Drive
controller, motors and what the sensors sample are those of a chair in the engine. One that hangs on
springs alone pitches about its drive axle. What is left out: slip of the tyres, and the friction of
the casters' swivels (docs/adr/017-rolling-without-the-engine.md has the errors).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, Self, cast

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
_LEANING: Final = 0.01
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
    def of(cls, spec: PlantSpec, chair: ChairConfig, joint_of: Mapping[str, int]) -> Self:
        """From a plant, its drive's limits, and the places of its joints in `Motion` by name."""
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
            rest_rad = -moment_Nm / stiffness_Nmprad
            springs = np.array([*(number / body_kgm2 for number in numbers), rest_rad])

        # 3. The slope that leaves no grip: half of the weight, at least, lies on the drive wheels.
        push_mps2 = 2.0 * max(chair.accel_mps2, chair.decel_mps2)  # as far as the controllers go
        aside_mps2 = 0.5 * chair.v_max_mps * chair.yaw_rate_max_radps
        spare_mps2 = 0.5 * spec.wheel.friction * GRAVITY_MPS2 - math.hypot(push_mps2, aside_mps2)
        # 4. The casters.
        casters, joints = [], []
        for number, pair in enumerate(spec.casters):
            for side, sign in (("l", 1.0), ("r", -1.0)):
                name, y_m = f"{number}_{side}", sign * 0.5 * pair.track_m
                casters.append((pair.swivel_x_m, y_m, pair.trail_m, pair.radius_m))
                swivel, wheel = joint_of[f"swivel_{name}"], joint_of[f"caster_{name}"]
                joints.append((swivel, wheel, joint_of.get(f"arm_{name}", -1)))
        return cls(
            drive=np.array(drive),
            casters=np.array(casters),
            springs=springs,
            joints=tuple(joints),
            steepest=spare_mps2 / GRAVITY_MPS2,
        )

    def can_roll(self, state: PlantState, rotation: Rotation, plane: Plane) -> bool:
        """Whether a chair stands on that plane with its wheels rolling, and has grip to spare."""
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
            stick: Of its driver.
            steps: In the tick.
            dt_s: A step.
        """
        # 1. The chair as it stands on the plane: heading and pitch; what it leans aside is nothing.
        tilt, (com_x_m, com_z_m) = _tilt(plane), self.drive[_COM_X_M:].tolist()
        com_B_m = com_x_m, 0.0, com_z_m
        rotation = matrix_from_quaternion(motion.q_WB)
        ahead, aside, up = (tilt.T @ rotation[::3]).tolist()
        yaw_rad, pitch_rad = math.atan2(aside, ahead), math.asin(up)
        nod_radps = 0.0
        if self.springs[0]:
            nod_radps = -rotate_vector_inverse(rotation, *motion.w_W_radps)[1]
        left, right, *_ = joints = list(motion.joints)
        wheels = left[1], right[1], left[0], right[0]
        state = np.array([0.0, 0.0, yaw_rad, *wheels, pitch_rad, nod_radps])
        casters = [(joints[swivel], joints[wheel]) for swivel, wheel, _ in self.joints]
        turning = np.array([(swivel[0], wheel[1], wheel[0]) for swivel, wheel in casters])

        # 2. The tick.
        memory, push = memory.copy(), (stick.x, stick.y)
        rows, hubs_m = np.empty((steps, ROW)), np.empty((steps, 2 + len(casters), 3))
        plant = self.drive, self.casters, self.springs
        _roll(state, turning, memory, setting, plant, tilt, push, dt_s, rows, hubs_m)

        # 3. The chair as it moves then.
        last = rows[-1].tolist()
        after = cast(Rotation, tuple(last[:9]))
        origin_W_m = np.subtract(motion.p_W_m, rotate_vector(rotation, *com_B_m))
        there_W_m = (origin_W_m + tilt @ (state[_X], state[_Y], 0.0)).tolist()
        roll_rad, pitch_rad, yaw_rad = rpy_from_matrix(after)
        *_, left_radps, right_radps, left_rad, right_rad, pitch, nod = state.tolist()
        joints[:2] = (left_rad, left_radps), (right_rad, right_radps)
        at = zip(self.joints, self.casters[:, 0].tolist(), turning.tolist(), strict=True)
        for (swivel, wheel, arm), x_m, (angle, spin, turned) in at:
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
    across = -k * x * y
    return np.array([[1.0 - k * x * x, across, x], [across, 1.0 - k * y * y, y], [-x, -y, z]])


@compile_exact_kernel
def _roll(
    state: F64,
    turning: F64,
    memory: F64,
    setting: F64,
    plant: tuple[F64, F64, F64],
    tilt: F64,
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
        plant: Drive, casters and springs of `RollingPlant`.
        tilt: (3, 3) the plane's.
        stick: Of the driver: right, forward.
        dt_s: A step.
        rows: (steps, ROW) takes what the sensors sample, see `physics/sensors/imu.py`.
        hubs: (steps, 2 + n, 3) takes the middles of the wheels from the chair's first place, in W.
    """
    drive, casters, springs = plant
    radius, half = drive[_RADIUS_M], drive[_HALF_M]
    for n in range(len(rows)):
        left, right = state[_LEFT_RADPS], state[_RIGHT_RADPS]
        v, w = 0.5 * radius * (left + right), 0.5 * radius * (right - left) / half
        # 1. The motors' targets, and what they can. The axle nods back above the ground.
        axle_mps = v - radius * state[_PITCH_RADPS]
        targets = drive_controller.step(memory, setting, *stick, axle_mps, left, right)
        cos, sin = math.cos(state[_YAW]), math.sin(state[_YAW])
        # Gravity along the plane, in the chair's frame.
        ahead = -GRAVITY_MPS2 * (tilt[2, 0] * cos + tilt[2, 1] * sin)
        aside = -GRAVITY_MPS2 * (tilt[2, 1] * cos - tilt[2, 0] * sin)
        left, right = _turned(left, right, targets, ahead, aside, drive, dt_s)
        # 2. Both wheels roll, and springs give way to what pushes the chair back.
        push_mps2 = (0.5 * radius * (left + right) - v) / dt_s - ahead
        v, w = 0.5 * radius * (left + right), 0.5 * radius * (right - left) / half
        pull = springs[0] * (state[_PITCH] - springs[3])
        nod_radps2 = springs[2] * push_mps2 - pull - springs[1] * state[_PITCH_RADPS]
        state[_PITCH_RADPS] += dt_s * nod_radps2
        state[_PITCH] += state[_PITCH_RADPS] * dt_s
        middle = state[_YAW] + 0.5 * w * dt_s
        state[_X] += v * math.cos(middle) * dt_s
        state[_Y] += v * math.sin(middle) * dt_s
        state[_YAW] += w * dt_s
        blow = _blow(state[_LEFT_RAD], left * dt_s, radius)
        blow += _blow(state[_RIGHT_RAD], right * dt_s, radius)
        state[_LEFT_RAD] += left * dt_s
        state[_RIGHT_RAD] += right * dt_s
        state[_LEFT_RADPS], state[_RIGHT_RADPS] = left, right
        cos, sin = math.cos(state[_YAW]), math.sin(state[_YAW])
        # 3. What the sensors sample: rotation, velocity of the frame's centre of mass, turn rate.
        tip_cos, tip_sin = math.cos(state[_PITCH]), math.sin(state[_PITCH])
        nod = state[_PITCH_RADPS]
        surge, swing = v - nod * drive[_COM_Z_M] - blow, w * drive[_COM_X_M] + blow
        heave = nod * drive[_COM_X_M] + 0.5 * blow
        for i in range(3):
            # The chair's directions on the plane: ahead, to the left, up.
            fore, up = tilt[i, 0] * cos + tilt[i, 1] * sin, tilt[i, 2]
            port = tilt[i, 1] * cos - tilt[i, 0] * sin
            rows[n, 3 * i] = tip_cos * fore + tip_sin * up
            rows[n, 3 * i + 1] = port
            rows[n, 3 * i + 2] = tip_cos * up - tip_sin * fore
            rows[n, 9 + i] = surge * fore + swing * port + heave * up
            rows[n, 12 + i] = w * up - nod * port
        # 4. Where the wheels' middles are; casters trail.
        for k in range(2 + len(casters)):
            at = (0.0, half - 2.0 * half * k, radius)
            if k >= 2:
                at = _trail(casters[k - 2], turning[k - 2], v, w, dt_s)
            hx = state[_X] + cos * at[0] - sin * at[1]
            hy = state[_Y] + sin * at[0] + cos * at[1]
            for i in range(3):
                hubs[n, k, i] = tilt[i, 0] * hx + tilt[i, 1] * hy + tilt[i, 2] * at[2]


@compile_exact_kernel
def _trail(
    caster: F64, turning: F64, v: float, w: float, dt_s: float
) -> tuple[float, float, float]:
    """Turn a caster as its wheel rolls; the middle of that wheel in B."""
    x, y, trail, radius = caster
    ahead, aside = v - w * y, w * x
    cos, sin = math.cos(turning[_ANGLE]), math.sin(turning[_ANGLE])
    turning[_ANGLE] += ((aside * cos - ahead * sin) / trail - w) * dt_s
    cos, sin = math.cos(turning[_ANGLE]), math.sin(turning[_ANGLE])
    turning[_SPIN_RADPS] = (ahead * cos + aside * sin) / radius
    turning[_TURNED] += turning[_SPIN_RADPS] * dt_s
    return x - trail * cos, y - trail * sin, radius


@compile_exact_kernel
def _turned(
    left: float,
    right: float,
    targets: tuple[float, float, float, float],
    ahead_mps2: float,
    aside_mps2: float,
    drive: F64,
    dt_s: float,
) -> tuple[float, float]:
    """The speeds of both drive wheels after a step: their targets, within the torques."""
    own, other, radius, half = drive[_OWN], drive[_OTHER], drive[_RADIUS_M], drive[_HALF_M]
    v, w = 0.5 * radius * (left + right), 0.5 * radius * (right - left) / half
    # The push of the weight, and of the mass that lies ahead of the axle in a turn.
    push = 0.5 * radius * (drive[_AHEAD] * ahead_mps2 + drive[_ASIDE] * w * w)
    twist = 0.5 * radius * drive[_ASIDE] * (aside_mps2 - v * w) / half
    gain_left, gain_right = (targets[0] - left) / dt_s, (targets[1] - right) / dt_s
    torque_left = own * gain_left + other * gain_right - (push - twist)
    torque_right = own * gain_right + other * gain_left - (push + twist)
    torque_left = min(max(torque_left, -targets[2]), targets[2]) + push - twist
    torque_right = min(max(torque_right, -targets[3]), targets[3]) + push + twist
    step = dt_s / (own * own - other * other)
    return (
        left + step * (own * torque_left - other * torque_right),
        right + step * (own * torque_right - other * torque_left),
    )


@compile_exact_kernel
def _blow(turned_rad: float, turn_rad: float, radius_m: float) -> float:
    """The speed that an edge of the ground gives a wheel in a step, by its way alone."""
    notch = math.floor((turned_rad + turn_rad) * radius_m / _NOTCH_M)
    drawn = notch * 40503 % 65536
    drawn = (drawn ^ (drawn >> 7)) * 30011 % 65536
    if notch == math.floor(turned_rad * radius_m / _NOTCH_M) or drawn % _NOTCHES_A_BLOW:
        return 0.0
    return _BLOW_MPS * (drawn / 32768.0 - 1.0)
