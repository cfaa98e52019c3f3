"""A wheelchair's commands, state, outline and contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from wcsim.types.arrays import F64, ComparesArrays


@dataclass(frozen=True, slots=True)
class Joystick:
    """A joystick position: x right, y forward, each in [-1, 1]."""

    x: float
    y: float


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
    roll_rad: float  # right side down positive
    pitch_rad: float  # nose up positive
    yaw_rad: float


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
    """A contact in one tick between a part of the wheelchair and something else; impulses are summed over the tick."""

    kind: str  # an ActorKind value, or "ground", "kerb", "building", "static"
    part: str  # "wheel", "caster", "antitip", "footplate", "body"
    impulse_Ns: float
    cause: Literal["own", "other"]
    actor_id: str = ""
