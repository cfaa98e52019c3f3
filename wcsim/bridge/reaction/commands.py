"""What the street knows of a wheelchair, and the commands that its actors get because of it."""

import math
from dataclasses import dataclass

import numpy as np

from wcsim.bridge.reaction.attention import AttentionModel
from wcsim.types import F64, ClassId

ROADWAY = (ClassId.ROAD, ClassId.CROSSWALK, ClassId.RAIL_TRACK)
LET_GO = -1.0
CHAIR, VEHICLE = "", "v:"  # what somebody stands before, when it is nobody on foot


@dataclass(frozen=True, slots=True, kw_only=True)
class ChairInStreet:
    """What others see of a wheelchair."""

    p_W_m: F64  # (2,) middle of the chair
    v_W_mps: F64  # (2,)
    on_road: bool  # on a carriageway or a crossing, not up on a pavement
    half_m: tuple[float, float]  # half the length and width of its footprint
    yaw_rad: float = 0.0
    z_m: float = 0.0
    # Of the others towards it in this episode; None: as towards everybody.
    habits: AttentionModel | None = None

    def row(self) -> F64:
        """x, y, cos, sin, half length, half width, velocity x and y as (8,)."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.array([*self.p_W_m, cos, sin, *self.half_m, *self.v_W_mps])


@dataclass(frozen=True, slots=True, kw_only=True)
class ActorCommand:
    """The command of one tick; `LET_GO` as speed gives everything back to SUMO."""

    actor_id: str
    speed_mps: float
    hard: bool = False  # harder than SUMO's service brake: the speed is taken as it is
    stay_in_lane: bool = False  # no lane change of SUMO's own
    pushy: bool = False  # a lane change that is ordered takes smaller gaps
    lane_index: int | None = None  # change to this lane
    aside_m: float | None = None  # move over within the lane, left positive


@dataclass(frozen=True, slots=True, kw_only=True)
class GreenRequest:
    """What a pressed button asks of a traffic light: to free a crossing when its program can."""

    tls_id: str
    links: tuple[int, ...]  # the crossing's places in the light's colours


@dataclass(frozen=True, slots=True, kw_only=True)
class Blocked:
    """An actor that stands because of a chair."""

    actor_id: str
    for_s: float
    could_pass: bool  # there is room beside the chair, or another lane
    behind: str = CHAIR  # who stands in between; CHAIR for nobody, VEHICLE for one that SUMO has
