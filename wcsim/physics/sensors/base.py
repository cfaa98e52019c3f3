"""What every sensor of a wheelchair does: start an episode, sample physics steps, read each tick.

A sensor is a class here and a line in `registry.py`. One whose reading is a row of numbers has its
section and its `Measure` in `config/sensors.py`; nothing else names it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from wcsim.core.frames import LEVEL, Rotation, Vec3
from wcsim.types import F64, ActorState, PlantState, SignalState

if TYPE_CHECKING:
    from wcsim.physics.buffers import SeatBuffers
    from wcsim.physics.engine import Engine
    from wcsim.physics.renderer.instances import ChairPose
    from wcsim.physics.sensors.camera import CameraRig

NoiseKeys = Mapping[str, int]  # 64 bits for each sensor, by name


class BodyMotion(NamedTuple):
    """How a wheelchair moves after a physics step."""

    rotation: Rotation = LEVEL  # R_WB
    v_com_W_mps: Vec3 = (0.0, 0.0, 0.0)
    w_W_radps: Vec3 = (0.0, 0.0, 0.0)
    wheel_rad: tuple[float, float] = (0.0, 0.0)  # how far the drive wheels have turned: left, right


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """The wheelchair that a sensor is put on."""

    seat: int
    engine: Engine
    com_B_m: Vec3  # the point that has the velocity of `BodyMotion`
    # Of the drive wheels as configured, whatever an episode has drawn.
    wheel_radius_m: float
    track_m: float
    rig: CameraRig | None = None  # which the cameras of all seats share


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """What there is to see from a wheelchair after a tick."""

    tick: int  # that the images show
    plant: PlantState  # where the wheelchair is
    actors: Sequence[ActorState]  # a tuple that is given again (the same object) is not read again
    chairs: Sequence[ChairPose]  # the wheelchairs, this one among them or not
    signals: Sequence[SignalState]  # of now
    buffers: SeatBuffers | None  # where the images go; None: the rig's own
    counted: bool  # whether the pixels of every actor are counted, for `CameraRig.shown_px`
    drawn: bool = True  # whether the cameras look at all


class Sensor:
    """One kind of sensor on one wheelchair; a method that it does not need stays as it is here."""

    def start(self, noise_key: int | None) -> None:
        """Begin an episode: draw the errors that stay through it, none without a key."""

    def set_step(self, step_s: float) -> None:
        """Take the physics steps to be so long from the next tick on."""

    def reset(self, motion: BodyMotion) -> None:
        """Stand still like this from now on, and forget what was before."""

    def sample(self, motion: BodyMotion) -> None:
        """Take the motion after a physics step into the tick."""

    def sample_rows(self, rows: F64, wheel_rad: tuple[float, float]) -> None:
        """Take a whole tick: rows (n, 15) of rotation, velocity and turn rate, as in `BodyMotion`.

        `wheel_rad` is how far the drive wheels have turned at its end.
        """
        for row in rows.tolist():
            self.sample(BodyMotion(tuple(row[:9]), tuple(row[9:12]), tuple(row[12:]), wheel_rad))

    def end_tick(self, noise_key: int | None) -> Any:
        """What it felt in the tick that ends; None for a sensor that has to look.

        `noise_key` (64 bits) selects the noise; without a key there is none.
        """

    def look(self, scene: Surroundings) -> Any:
        """What it sees after the tick; None when it does not look."""
