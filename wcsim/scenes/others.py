"""What the others do around the chairs of a scene: how near they come, who overtakes, who gives way and drives on."""

from __future__ import annotations

import math
from typing import Literal

from wcsim.core.boxes import Box, box_of, boxes_touch, gap_to_box
from wcsim.scenes.facts import ALONE_M, FASTEST_MPS
from wcsim.types import ActorKind, ActorState, ClientSnapshot, Outline, Snapshot

Group = Literal["vehicle", "rider", "person", "chair"]

NEAR_M = 15.0  # who is farther away has nothing to do with a chair
BEHIND_M = 1.5  # from middle to middle, to count as behind or ahead
BESIDE_M = 3.0
_ALIGNED = 0.7  # cosine: overtaking is going the same way
_DRIVES_MPS, _GIVES_WAY_MPS = 3.0, 1.4

_RIDERS = (ActorKind.BICYCLE, ActorKind.SCOOTER, ActorKind.MOTORCYCLE)


class OthersMeter:
    """Adds up what others do near any chair; all of them have one outline."""

    def __init__(self, outline: Outline) -> None:
        self._outline = outline
        self.closest_m: dict[Group, float] = dict.fromkeys(("vehicle", "rider", "person", "chair"), ALONE_M)
        self.seen: set[str] = set()
        self.overtook: set[tuple[int, str]] = set()  # by seat and actor
        self.gave_way: set[str] = set()
        self.went_on: set[str] = set()
        self.made_way_m = 0.0
        self.slowest_mps = FASTEST_MPS
        self._behind: set[tuple[int, str]] = set()
        self._drove: set[str] = set()

    def add(self, snapshot: Snapshot) -> None:
        """One tick."""
        self.seen.update(actor.id for actor in snapshot.actors)
        boxes = [chair_box(client, self._outline) for client in snapshot.clients]
        for i, box in enumerate(boxes):
            for other in boxes[:i]:
                self._come_near("chair", box_gap_m(box, other))
            for actor in snapshot.actors:
                if math.dist(actor.p_W_m[:2], box[:2]) < NEAR_M + 0.5 * actor.size_lwh_m[0]:
                    self._come_near(_group(actor), box_gap_m(box, box_of(actor)))
                    self._passing(i, box, actor)
                    self._giving_way(actor)

    def _come_near(self, group: Group, gap_m: float) -> None:
        self.closest_m[group] = min(self.closest_m[group], gap_m)

    def _passing(self, seat: int, box: Box, actor: ActorState) -> None:
        x, y, cos, sin, _, _ = box
        dx, dy = float(actor.p_W_m[0]) - x, float(actor.p_W_m[1]) - y
        along_m, aside_m = dx * cos + dy * sin, dy * cos - dx * sin
        if abs(aside_m) > BESIDE_M or cos * math.cos(actor.yaw_rad) + sin * math.sin(actor.yaw_rad) < _ALIGNED:
            return
        if along_m < -BEHIND_M:
            self._behind.add((seat, actor.id))
        elif along_m > BEHIND_M and (seat, actor.id) in self._behind:
            self.overtook.add((seat, actor.id))

    def _giving_way(self, actor: ActorState) -> None:
        if actor.kind is ActorKind.PEDESTRIAN:
            self.made_way_m = max(self.made_way_m, abs(actor.deflect_m))
            return
        speed_mps = math.hypot(actor.v_W_mps[0], actor.v_W_mps[1])
        if speed_mps > _DRIVES_MPS:
            self._drove.add(actor.id)
            if actor.id in self.gave_way:
                self.went_on.add(actor.id)
        if actor.id in self._drove:
            self.slowest_mps = min(self.slowest_mps, speed_mps)
            if speed_mps < _GIVES_WAY_MPS:
                self.gave_way.add(actor.id)


def chair_box(client: ClientSnapshot, outline: Outline) -> Box:
    """The box on the ground of a chair with this outline."""
    x, y, _ = client.plant.p_WB_m.tolist()
    cos, sin = math.cos(client.plant.yaw_rad), math.sin(client.plant.yaw_rad)
    return x + outline.middle_x_m * cos, y + outline.middle_x_m * sin, cos, sin, *outline.half_lw_m


def box_gap_m(a: Box, b: Box) -> float:
    """Smallest distance between two boxes, 0 when they overlap.

    >>> box_gap_m((0.0, 0.0, 1.0, 0.0, 1.0, 0.5), (3.0, 0.0, 0.0, 1.0, 1.0, 0.5))
    1.5
    """
    if boxes_touch(*a, *b):
        return 0.0
    return max(0.0, min(gap_to_box(*corner, *other) for one, other in ((a, b), (b, a)) for corner in _corners(one)))


def _corners(box: Box) -> list[tuple[float, float]]:
    x, y, cos, sin, long_m, wide_m = box
    ends = ((i * long_m, j * wide_m) for i in (-1, 1) for j in (-1, 1))
    return [(x + a * cos - b * sin, y + a * sin + b * cos) for a, b in ends]


def _group(actor: ActorState) -> Group:
    if actor.kind is ActorKind.PEDESTRIAN:
        return "person"
    if actor.kind is ActorKind.WHEELCHAIR:
        return "chair"
    return "rider" if actor.kind in _RIDERS else "vehicle"
