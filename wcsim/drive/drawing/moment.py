"""What there is to draw of one moment: who is where, and what the chair that is followed sees and wants."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wcsim.physics.renderer.instances import ChairPose, rotation_of
from wcsim.types import ActorState, CameraFrame, Route, SignalState


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """One moment of a street with chairs in it."""

    actors: tuple[ActorState, ...]
    signals: tuple[SignalState, ...]
    chairs: tuple[ChairPose, ...]
    seat: int  # whose pictures these are; one of `chairs`
    jumped: bool = False  # the chair is somewhere else than a moment ago: the picture's camera does not come after it
    route: Route | None = None  # None where it is not known
    done_m: float = 0.0  # along the route
    frame: CameraFrame | None = None  # what its front camera saw; drawn, without errors, where that is not known

    @property
    def column(self) -> int:
        """Where the chair is among `chairs`."""
        return [chair.seat for chair in self.chairs].index(self.seat)

    @property
    def chair(self) -> ChairPose:
        """The chair itself."""
        return self.chairs[self.column]

    @property
    def yaw_rad(self) -> float:
        """Its heading."""
        R_WB = rotation_of(self.chair.q_WB)
        return math.atan2(R_WB[1, 0], R_WB[0, 0])
