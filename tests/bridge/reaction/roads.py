"""Roads for tests of the reaction: straight lanes along x, without SUMO."""

import math
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from tests.support import actors
from tests.support.samples import USUAL_OUTLINE
from wcsim.bridge.reaction.commands import ChairInStreet
from wcsim.bridge.reaction.swept_path import Brakes, LaneShape, OnLane
from wcsim.types import ActorKind, ActorState

LANE_M = 3.2
# From the origin by a right angle, on a radius of 10 m.
LEFT_TURN = [(10.0 * math.sin(a), 10.0 - 10.0 * math.cos(a)) for a in np.linspace(0.0, 0.5 * math.pi, 20)]

actor = partial(actors.actor, speed=10.0, size=actors.CAR_LWH_M)


def walker(x: float, y: float, yaw: float = 0.0, name: str = "p:a", speed: float = 1.2) -> ActorState:
    return actor(ActorKind.PEDESTRIAN, x=x, y=y, yaw=yaw, speed=speed, size=(0.3, 0.5, 1.7), name=name)


def chair(x: float, y: float = 0.0, vx: float = 0.0, vy: float = 0.0, on_road: bool = True) -> ChairInStreet:
    half_m = USUAL_OUTLINE.half_lw_m
    return ChairInStreet(p_W_m=np.array([x, y]), v_W_mps=np.array([vx, vy]), on_road=on_road, half_m=half_m)


def lane_shape(
    lane_id: str, points: ArrayLike, edge_id: str = "", index: int = 0, length_m: float | None = None
) -> LaneShape:
    """A lane along these points, as long as they are; without a name of its own its edge has that of the lane."""
    points = np.array(points, np.float64)
    return LaneShape(
        id=lane_id, edge_id=edge_id or lane_id, index=index, points_W_m=points, width_m=LANE_M, internal=False,
        length_m=length_m or float(np.hypot(*np.diff(points, axis=0).T).sum()),
    )  # fmt: skip


@dataclass
class StraightRoads:
    """`lanes` lanes side by side, the rightmost along y = 0; vehicles are where they were put."""

    lanes: int = 1
    sublanes: bool = True
    vehicles: dict[str, ActorState] = field(default_factory=dict)

    def put(self, *vehicles: ActorState) -> tuple[ActorState, ...]:
        self.vehicles = {vehicle.id: vehicle for vehicle in vehicles}
        return vehicles

    def _index(self, actor_id: str) -> int:
        return round(self.vehicles[actor_id].p_W_m[1] / LANE_M)

    def on_lane(self, actor_id: str) -> OnLane | None:
        vehicle, index = self.vehicles[actor_id], self._index(actor_id)
        front_m = float(vehicle.p_W_m[0]) + 0.5 * vehicle.size_lwh_m[0]
        return OnLane(lane_id=f"E_{index}", along_m=front_m + 100.0, left_m=float(vehicle.p_W_m[1]) - index * LANE_M)

    def lanes_ahead(self, actor_id: str, ahead_m: float) -> tuple[str, ...]:
        return (f"E_{self._index(actor_id)}",)

    def lane(self, lane_id: str) -> LaneShape:
        index = int(lane_id[-1])
        return lane_shape(lane_id, [(x, index * LANE_M) for x in (-100.0, 300.0)], "E", index)

    def lanes_beside(self, actor_id: str, ahead_m: float) -> tuple[int, ...]:
        index = self._index(actor_id)
        return tuple(i for i in (index + 1, index - 1) if 0 <= i < self.lanes)

    def brakes(self, actor_id: str) -> Brakes:
        bicycle = self.vehicles[actor_id].kind is ActorKind.BICYCLE
        return Brakes(service_mps2=3.0 if bicycle else 4.5, emergency_mps2=7.0 if bicycle else 9.0)

    def allowed_mps(self, actor_id: str) -> float:
        return 13.9
