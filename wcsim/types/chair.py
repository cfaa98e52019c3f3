"""A wheelchair's commands, state, outline, contacts, and sensor measurements in one tick."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal

import numpy as np
from msgspec import Meta

from wcsim.types import bounds as b
from wcsim.types.arrays import F32, F64, U8, ComparesArrays


@dataclass(frozen=True, slots=True)
class Joystick:
    """A joystick position: x right, y forward, each in [-1, 1]."""

    x: b.Stick
    y: b.Stick


AT_REST: Final = Joystick(0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """The joystick command of a seat for one tick."""

    seat: int
    tick: int
    joystick: Joystick


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlantState(ComparesArrays):
    """The true state of a wheelchair."""

    p_WB_m: F64  # (3,)
    q_WB: F64  # (4,) x, y, z, w
    v_B_mps: F64  # (3,)
    w_B_radps: F64  # (3,)
    wheel_radps: F64  # (2,) left, right drive wheel
    roll_rad: b.Number  # right side down positive
    pitch_rad: b.Number  # nose up positive
    yaw_rad: b.Number

    @property
    def row(self) -> F64:
        """15 numbers: position, quaternion, velocity, angular velocity, wheel speeds."""
        return np.concatenate(
            [self.p_WB_m, self.q_WB, self.v_B_mps, self.w_B_radps, self.wheel_radps]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline:
    """The box around a wheelchair with its user."""

    length_m: float
    width_m: float
    height_m: float
    middle_x_m: float  # from the drive axle forward to the middle of its length

    @property
    def size_lwh_m(self) -> tuple[float, float, float]:
        """Length, width and height."""
        return self.length_m, self.width_m, self.height_m

    @property
    def half_lw_m(self) -> tuple[float, float]:
        """Half the length and half the width."""
        return 0.5 * self.length_m, 0.5 * self.width_m

    @property
    def front_x_m(self) -> float:
        """Its front, ahead of the drive axle."""
        return self.middle_x_m + 0.5 * self.length_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """A contact in one tick between a part of the wheelchair and something else; impulses are summed over the tick."""  # noqa: E501

    kind: b.NameOrNone  # an ActorKind value, or "ground", "kerb", "building", "static"
    part: b.NameOrNone  # "wheel", "caster", "antitip", "footplate", "body"
    impulse_Ns: b.Number
    cause: Literal["own", "other"]
    actor_id: b.Line = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraFrame(ComparesArrays):
    """One image. A slower camera repeats its last image with the old `taken_tick`."""

    name: b.Line
    taken_tick: b.CountOrNone
    # (H, W) along the optical axis; range where nothing is hit, 0 where noise left no value.
    depth_m: F32
    class_id: U8  # (H, W) ClassId, VOID where the noise leaves no class
    rgb: U8 | None = None  # (H, W, 3), only if the camera draws colours


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuFrame(ComparesArrays):
    """Measurements of the IMU and the tilt sensor in one tick."""

    accel_mean_mps2: F64  # (3,) specific force in the sensor frame, tick mean, gravity included
    # (3,) largest |.| per axis within the tick after the 20 Hz low-pass, gravity removed; exact.
    accel_peak_mps2: F64
    gyro_radps: F64  # (3,) tick mean
    roll_rad: b.Number  # as the tilt sensor measures it; the true tilt is in PlantState
    pitch_rad: b.Number
    yaw_rad: b.Number  # exact


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """Description of a sensor of `[sensors]`: its reading has one float64 for each part."""

    parts: tuple[str, ...]  # name and unit of each number, as speed_mps
    # Of each part; the observation holds number / full_scale as float32, cut to [-1, 1].
    full_scale: tuple[float, ...]
    mirror: tuple[float, ...]  # 1 or -1: the sign of each if left and right are exchanged


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reading(ComparesArrays):
    """Reading of one sensor of `[sensors]` in one tick; its `Measure` describes the numbers."""

    name: b.NameOrNone
    values: F64  # (len(parts),)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFrame:
    """All sensor readings of one seat after a tick."""

    tick: b.Count
    cameras: Annotated[tuple[CameraFrame, ...], Meta(max_length=b.MOST_CAMERAS)]
    imu: ImuFrame
    # Of the sensors in `[sensors]`, by name.
    readings: Annotated[tuple[Reading, ...], Meta(max_length=b.MOST_READINGS)] = ()
