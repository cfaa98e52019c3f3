"""Measures a scene while it runs: how the chairs moved, over what, and among whom.

What a scene's chairs drive over: how narrow the pavement was, and what the light showed as they
began to cross.

What the others do around the chairs of a scene: how near they come, who overtakes, who gives way
and drives on.
"""

import math
from typing import Literal

import numpy as np

from wcsim.config.scene import SceneFile, SceneSeat
from wcsim.core import frames
from wcsim.core.boxes import Box, box_from_actor, boxes_touch, gap_to_box
from wcsim.types import (
    F64,
    ActorKind,
    ActorState,
    ClassId,
    ClientSnapshot,
    Ground,
    Outline,
    Snapshot,
    Street,
    WalkEdge,
    WalkGraph,
    WayKind,
)
from wcsim.users.crossing import is_red

Group = Literal["vehicle", "rider", "person", "chair"]
Facts = dict[str, float]
"""What a scene came to, over all its seats, by the names of `SceneExpectations`, which says what each is."""

ALONE_M = 99.0
"""The gap to others when there are none."""
FASTEST_MPS = 99.0
"""The slowest speed when no vehicle drives."""
NEAR_M = 15.0  # who is farther away has nothing to do with a chair
BEHIND_M = 1.5  # from middle to middle, to count as behind or ahead
BESIDE_M = 3.0
_ALIGNED = 0.7  # cosine: overtaking is going the same way
_DRIVES_MPS, _GIVES_WAY_MPS = 3.0, 1.4

_RIDERS = (ActorKind.BICYCLE, ActorKind.SCOOTER, ActorKind.MOTORCYCLE)


class _OthersMeter:
    """Adds up what others do near any chair; all of them have one outline."""

    def __init__(self, outline: Outline) -> None:
        self._outline = outline
        self.closest_m: dict[Group, float] = dict.fromkeys(
            ("vehicle", "rider", "person", "chair"), ALONE_M
        )
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
        boxes = [_chair_box(client, self._outline) for client in snapshot.clients]
        for i, box in enumerate(boxes):
            for other in boxes[:i]:
                self._come_near("chair", _box_gap_m(box, other))
            for actor in snapshot.actors:
                if math.dist(actor.p_W_m[:2], box[:2]) < NEAR_M + 0.5 * actor.size_lwh_m[0]:
                    self._come_near(_group(actor), _box_gap_m(box, box_from_actor(actor)))
                    self._passing(i, box, actor)
                    self._giving_way(actor)

    def _come_near(self, group: Group, gap_m: float) -> None:
        self.closest_m[group] = min(self.closest_m[group], gap_m)

    def _passing(self, seat: int, box: Box, actor: ActorState) -> None:
        x, y, cos, sin, _, _ = box
        dx, dy = float(actor.p_W_m[0]) - x, float(actor.p_W_m[1]) - y
        along_m, aside_m = dx * cos + dy * sin, dy * cos - dx * sin
        if (
            abs(aside_m) > BESIDE_M
            or cos * math.cos(actor.yaw_rad) + sin * math.sin(actor.yaw_rad) < _ALIGNED
        ):
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


def _chair_box(client: ClientSnapshot, outline: Outline) -> Box:
    """The box on the ground of a chair with this outline."""
    x, y, _ = client.plant.p_WB_m.tolist()
    cos, sin = math.cos(client.plant.yaw_rad), math.sin(client.plant.yaw_rad)
    return x + outline.middle_x_m * cos, y + outline.middle_x_m * sin, cos, sin, *outline.half_lw_m


def _box_gap_m(a: Box, b: Box) -> float:
    """Smallest distance between two boxes, 0 when they overlap.

    >>> _box_gap_m((0.0, 0.0, 1.0, 0.0, 1.0, 0.5), (3.0, 0.0, 0.0, 1.0, 1.0, 0.5))
    1.5
    """
    if boxes_touch(*a, *b):
        return 0.0
    return max(
        0.0,
        min(
            gap_to_box(*corner, *other)
            for one, other in ((a, b), (b, a))
            for corner in _corners(one)
        ),
    )


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


LOOK_ASIDE_M, STEP_M = 4.0, 0.05
_PAVEMENT = (ClassId.SIDEWALK, ClassId.LOWERED_KERB)
_OFFSETS_M = np.arange(0.0, LOOK_ASIDE_M, STEP_M)


class _WayMeter:
    """Adds up what the chairs' ways are like."""

    def __init__(self, ground: Ground, walk: WalkGraph, seats: int, outline: Outline) -> None:
        self._outline = outline
        self.narrowest_m = ALONE_M
        self.red_starts = self.green_starts = 0
        self._ground = ground
        crossings = [
            edge for edge in walk.edges if edge.kind is WayKind.CROSSING and _length_m(edge) > 0.0
        ]
        self._lights = [edge for edge in crossings if edge.tls_id]
        self._on: list[set[str]] = [
            set() for _ in range(seats)
        ]  # the crossings that each chair is on

    def add(self, snapshot: Snapshot) -> None:
        """One tick."""
        for seat, client in enumerate(snapshot.clients):
            x, y, cos, sin, long_m, _ = _chair_box(client, self._outline)
            here_W_m = np.array([x, y])
            if int(self._ground.class_at(here_W_m)) in _PAVEMENT:
                width_m = _free_width_m(self._ground, here_W_m, np.array([-sin, cos]))
                self.narrowest_m = min(self.narrowest_m, width_m)
            front_W_m = here_W_m + long_m * np.array([cos, sin])
            self._cross(seat, front_W_m, snapshot)

    def _cross(self, seat: int, front_W_m: F64, snapshot: Snapshot) -> None:
        """Note the light of each crossing that a chair's front has reached now."""
        on = {edge.sumo_id: edge for edge in self._lights if _is_on(edge, front_W_m)}
        for edge in (edge for name, edge in on.items() if name not in self._on[seat]):
            red = is_red(edge, snapshot.signals)
            self.red_starts += red
            self.green_starts += not red
        self._on[seat] = set(on)


def _free_width_m(ground: Ground, here_W_m: F64, left_W: F64) -> float:
    """How wide the free pavement is across a point (2,), along a unit vector.

    At most twice `LOOK_ASIDE_M`.
    """
    width_m = 0.0
    for side in (1.0, -1.0):
        points = here_W_m + side * _OFFSETS_M[:, None] * left_W
        stops = (ground.clearance_at(points) <= 0.0) | ~np.isin(ground.class_at(points), _PAVEMENT)
        width_m += STEP_M * float(stops.argmax() if stops.any() else len(_OFFSETS_M))
    return width_m


def _is_on(edge: WalkEdge, p_W_m: F64) -> bool:
    length_m = _length_m(edge)
    way = (edge.points_W_m[-1] - edge.points_W_m[0]) / length_m
    dx, dy = p_W_m - edge.points_W_m[0]
    along_m, aside_m = dx * way[0] + dy * way[1], dy * way[0] - dx * way[1]
    return bool(0.0 <= along_m <= length_m and abs(aside_m) <= 0.5 * edge.width_m)


def _length_m(edge: WalkEdge) -> float:
    return float(np.hypot(*(edge.points_W_m[-1] - edge.points_W_m[0])))


STANDS_MPS = 0.05
_SETTLED_S = (
    0.5  # a chair is put down a little above the ground; what it feels then is not of the scene
)


class SceneMeter:
    """Adds up what happens in a scene."""

    def __init__(self, first: Snapshot, scene: SceneFile, street: Street, outline: Outline) -> None:
        self._chairs = [
            _ChairMeter(client, seat)
            for client, seat in zip(first.clients, scene.seats, strict=True)
        ]
        self._others = _OthersMeter(outline)
        self._way = _WayMeter(street.grid, street.walk, len(scene.seats), outline)

    def add(self, snapshot: Snapshot, dt_s: float) -> None:
        """One tick."""
        for client, chair in zip(snapshot.clients, self._chairs, strict=True):
            chair.add(client, dt_s)
        self._others.add(snapshot)
        self._way.add(snapshot)

    def facts(self) -> Facts:
        """What it came to."""
        chairs, others, way = self._chairs, self._others, self._way
        largest = ("climb_m", "drop_m", "rolled_back_m", "aside_m", "jolt_mps2")
        return {
            "crashed": any(chair.crashed for chair in chairs),
            "arrivals": sum(chair.arrived for chair in chairs),
            "travelled_m": sum(chair.travelled_m for chair in chairs),
            **{name: max(getattr(chair, name) for chair in chairs) for name in largest},
            "narrowest_m": way.narrowest_m,
            "max_roll_deg": frames.rad2deg(max(chair.roll_rad for chair in chairs)),
            "max_pitch_deg": frames.rad2deg(max(chair.pitch_rad for chair in chairs)),
            "standing_s": sum(chair.standing_s for chair in chairs),
            "red_starts": way.red_starts,
            "green_starts": way.green_starts,
            "closest_actor_m": min(others.closest_m.values()),
            **{f"closest_{group}_m": gap_m for group, gap_m in others.closest_m.items()},
            "overtaken": len(others.overtook),
            "slowest_mps": others.slowest_mps,
            "gave_way": len(others.gave_way),
            "went_on": len(others.went_on),
            "made_way_m": others.made_way_m,
            "actors_seen": len(others.seen),
        }


class _ChairMeter:
    """How one chair moved."""

    def __init__(self, first: ClientSnapshot, wanted: SceneSeat) -> None:
        self.crashed = self.arrived = False
        self.travelled_m = self.climb_m = self.drop_m = self.rolled_back_m = self.aside_m = 0.0
        self.roll_rad = self.pitch_rad = self.jolt_mps2 = self.standing_s = 0.0
        self._with_goal = wanted.goal_m is not None
        self._start_W_m = first.plant.p_WB_m.copy()
        self._ahead_W = _direction(first.plant.yaw_rad, wanted)
        self._backwards_m = self._time_s = 0.0

    def add(self, client: ClientSnapshot, dt_s: float) -> None:
        plant = client.plant
        speed_mps = float(np.hypot(*plant.v_B_mps[:2]))
        rise_m = float(plant.p_WB_m[2] - self._start_W_m[2])
        self._time_s += dt_s
        self.crashed |= client.events.crashed
        self.arrived |= self._with_goal and client.events.arrived
        self.travelled_m += speed_mps * dt_s
        self.standing_s += dt_s * (speed_mps < STANDS_MPS and not self.arrived)
        self.climb_m, self.drop_m = max(self.climb_m, rise_m), max(self.drop_m, -rise_m)
        self._backwards_m = max(0.0, self._backwards_m - float(plant.v_B_mps[0]) * dt_s)
        self.rolled_back_m = max(self.rolled_back_m, self._backwards_m)
        self.roll_rad = max(self.roll_rad, abs(plant.roll_rad))
        self.pitch_rad = max(self.pitch_rad, abs(plant.pitch_rad))
        if self._time_s > _SETTLED_S:
            self.jolt_mps2 = max(
                self.jolt_mps2, float(np.abs(client.sensors.imu.accel_peak_mps2).max())
            )
        away_m = plant.p_WB_m[:2] - self._start_W_m[:2]
        self.aside_m = max(
            self.aside_m, abs(float(self._ahead_W[0] * away_m[1] - self._ahead_W[1] * away_m[0]))
        )


def _direction(yaw_rad: float, wanted: SceneSeat) -> F64:
    """Unit vector (2,) from a seat's start to its goal, or ahead where it has none."""
    way_m = np.subtract(wanted.goal_m or wanted.start_m, wanted.start_m)
    length_m = float(np.hypot(*way_m))
    return way_m / length_m if length_m > 0.1 else np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
