"""Measures a scene while it runs: how the chairs moved, over what, and among whom.

Of a chair's way it measures how narrow the pavement was, and what the light showed as the chair set
out over a crossing. Of the others around the chairs it measures how near they are, who overtakes,
who gives way and drives on.
"""

import math
from itertools import product
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
"""The results of a scene, over all its seats, by the names of `SceneExpectations`."""

_ALONE_M = 99.0
"""The gap to others when there are none."""
_FASTEST_MPS = 99.0
"""The slowest speed when no vehicle drives."""
# Who is farther away has nothing to do with a chair.
_NEAR_M = 15.0
# From middle to middle, to count as behind or ahead.
_BEHIND_M = 1.5
_BESIDE_M = 3.0
_ALIGNED = 0.7  # cosine: overtaking is going the same way
_DRIVES_MPS, _GIVES_WAY_MPS = 3.0, 1.4

_RIDERS = (ActorKind.BICYCLE, ActorKind.SCOOTER, ActorKind.MOTORCYCLE)

_LOOK_ASIDE_M, _STEP_M = 4.0, 0.05
_PAVEMENT = (ClassId.SIDEWALK, ClassId.LOWERED_KERB)
_OFFSETS_M = np.arange(0.0, _LOOK_ASIDE_M, _STEP_M)

_STANDS_MPS = 0.05
# A chair is put down a little above the ground; what it feels then is not of the scene.
_SETTLED_S = 0.5


class SceneMeter:
    """Adds up what happens in a scene."""

    def __init__(self, first: Snapshot, scene: SceneFile, street: Street, outline: Outline) -> None:
        pairs = zip(first.clients, scene.seats, strict=True)
        self._chairs = [_ChairMeter(client, seat) for client, seat in pairs]
        self._others = _OthersMeter(outline)
        self._way = _WayMeter(street.grid, street.walk, len(scene.seats), outline)

    def add(self, snapshot: Snapshot, dt_s: float) -> None:
        """One tick."""
        for client, chair in zip(snapshot.clients, self._chairs, strict=True):
            chair.add(client, dt_s)
        self._others.add(snapshot)
        self._way.add(snapshot)

    def facts(self) -> Facts:
        """The results."""
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

    def __init__(self, first: ClientSnapshot, seat: SceneSeat) -> None:
        self.crashed = self.arrived = False
        self.travelled_m = self.climb_m = self.drop_m = self.rolled_back_m = self.aside_m = 0.0
        self.roll_rad = self.pitch_rad = self.jolt_mps2 = self.standing_s = 0.0
        self._with_goal = seat.goal_m is not None
        self._start_W_m = first.plant.p_WB_m.copy()
        # Unit vector (2,) from the start to the goal, or ahead where there is none.
        way_m = np.subtract(seat.goal_m or seat.start_m, seat.start_m)
        length_m, yaw_rad = float(np.hypot(*way_m)), first.plant.yaw_rad
        heading = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
        self._ahead_W = way_m / length_m if length_m > 0.1 else heading
        self._backwards_m = self._time_s = 0.0

    def add(self, client: ClientSnapshot, dt_s: float) -> None:
        plant = client.plant
        speed_mps = float(np.hypot(*plant.v_B_mps[:2]))
        rise_m = float(plant.p_WB_m[2] - self._start_W_m[2])
        self._time_s += dt_s
        self.crashed |= client.events.crashed
        self.arrived |= self._with_goal and client.events.arrived
        self.travelled_m += speed_mps * dt_s
        self.standing_s += dt_s * (speed_mps < _STANDS_MPS and not self.arrived)
        self.climb_m, self.drop_m = max(self.climb_m, rise_m), max(self.drop_m, -rise_m)
        self._backwards_m = max(0.0, self._backwards_m - float(plant.v_B_mps[0]) * dt_s)
        self.rolled_back_m = max(self.rolled_back_m, self._backwards_m)
        self.roll_rad = max(self.roll_rad, abs(plant.roll_rad))
        self.pitch_rad = max(self.pitch_rad, abs(plant.pitch_rad))
        if self._time_s > _SETTLED_S:
            peak_mps2 = float(np.abs(client.sensors.imu.accel_peak_mps2).max())
            self.jolt_mps2 = max(self.jolt_mps2, peak_mps2)
        away_m, ahead = plant.p_WB_m[:2] - self._start_W_m[:2], self._ahead_W
        aside_m = abs(float(ahead[0] * away_m[1] - ahead[1] * away_m[0]))
        self.aside_m = max(self.aside_m, aside_m)


class _OthersMeter:
    """Adds up what others do near any chair; all of them have one outline."""

    def __init__(self, outline: Outline) -> None:
        self._outline = outline
        groups: tuple[Group, ...] = ("vehicle", "rider", "person", "chair")
        self.closest_m = dict.fromkeys(groups, _ALONE_M)
        self.seen: set[str] = set()
        self.overtook: set[tuple[int, str]] = set()  # by seat and actor
        self.gave_way: set[str] = set()
        self.went_on: set[str] = set()
        self.made_way_m = 0.0
        self.slowest_mps = _FASTEST_MPS
        self._behind: set[tuple[int, str]] = set()
        self._drove: set[str] = set()

    def add(self, snapshot: Snapshot) -> None:
        """One tick."""
        self.seen.update(actor.id for actor in snapshot.actors)
        boxes = [_chair_box(client, self._outline) for client in snapshot.clients]
        for i, box in enumerate(boxes):
            for other in boxes[:i]:
                self._note_gap("chair", _box_gap_m(box, other))
            for actor in snapshot.actors:
                if math.dist(actor.p_W_m[:2], box[:2]) >= _NEAR_M + 0.5 * actor.size_lwh_m[0]:
                    continue
                group: Group = "rider" if actor.kind in _RIDERS else "vehicle"
                if actor.kind is ActorKind.PEDESTRIAN:
                    group = "person"
                if actor.kind is ActorKind.WHEELCHAIR:
                    group = "chair"
                self._note_gap(group, _box_gap_m(box, box_from_actor(actor)))
                self._note_passing(i, box, actor)
                self._note_giving_way(actor)

    def _note_gap(self, group: Group, gap_m: float) -> None:
        self.closest_m[group] = min(self.closest_m[group], gap_m)

    def _note_passing(self, seat: int, box: Box, actor: ActorState) -> None:
        x, y, cos, sin, _, _ = box
        dx, dy = float(actor.p_W_m[0]) - x, float(actor.p_W_m[1]) - y
        along_m, aside_m = dx * cos + dy * sin, dy * cos - dx * sin
        aligned = cos * math.cos(actor.yaw_rad) + sin * math.sin(actor.yaw_rad)
        if abs(aside_m) > _BESIDE_M or aligned < _ALIGNED:
            return
        if along_m < -_BEHIND_M:
            self._behind.add((seat, actor.id))
        elif along_m > _BEHIND_M and (seat, actor.id) in self._behind:
            self.overtook.add((seat, actor.id))

    def _note_giving_way(self, actor: ActorState) -> None:
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


class _WayMeter:
    """Adds up what the chairs' ways are like."""

    def __init__(self, ground: Ground, walk: WalkGraph, seats: int, outline: Outline) -> None:
        self._outline = outline
        self.narrowest_m = _ALONE_M
        self.red_starts = self.green_starts = 0
        self._ground = ground
        lights = [edge for edge in walk.edges if edge.kind is WayKind.CROSSING and edge.tls_id]
        self._lights = [edge for edge in lights if _length_m(edge) > 0.0]
        # The crossings that each chair is on.
        self._on: list[set[str]] = [set() for _ in range(seats)]

    def add(self, snapshot: Snapshot) -> None:
        """One tick."""
        for seat, client in enumerate(snapshot.clients):
            x, y, cos, sin, long_m, _ = _chair_box(client, self._outline)
            here_W_m = np.array([x, y])
            if int(self._ground.class_at(here_W_m)) in _PAVEMENT:
                width_m = _free_width_m(self._ground, here_W_m, np.array([-sin, cos]))
                self.narrowest_m = min(self.narrowest_m, width_m)
            front_W_m = here_W_m + long_m * np.array([cos, sin])
            on = {edge.sumo_id: edge for edge in self._lights if _is_on(edge, front_W_m)}
            # The light of each crossing that the chair's front has reached now.
            for edge in (edge for name, edge in on.items() if name not in self._on[seat]):
                red = is_red(edge, snapshot.signals)
                self.red_starts += red
                self.green_starts += not red
            self._on[seat] = set(on)


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
    gaps_m = []
    # Boxes apart are nearest to each other at a corner.
    for (x, y, cos, sin, long_m, wide_m), other in ((a, b), (b, a)):
        for ahead_m, left_m in product((-long_m, long_m), (-wide_m, wide_m)):
            corner = x + ahead_m * cos - left_m * sin, y + ahead_m * sin + left_m * cos
            gaps_m.append(gap_to_box(*corner, *other))
    return max(0.0, min(gaps_m))


def _free_width_m(ground: Ground, here_W_m: F64, left_W: F64) -> float:
    """How wide the free pavement is across a point (2,), at most twice `_LOOK_ASIDE_M`."""
    width_m = 0.0
    for side in (1.0, -1.0):
        points = here_W_m + side * _OFFSETS_M[:, None] * left_W
        stops = (ground.clearance_at(points) <= 0.0) | ~np.isin(ground.class_at(points), _PAVEMENT)
        width_m += _STEP_M * float(stops.argmax() if stops.any() else len(_OFFSETS_M))
    return width_m


def _is_on(edge: WalkEdge, p_W_m: F64) -> bool:
    length_m = _length_m(edge)
    way = (edge.points_W_m[-1] - edge.points_W_m[0]) / length_m
    dx, dy = p_W_m - edge.points_W_m[0]
    along_m, aside_m = dx * way[0] + dy * way[1], dy * way[0] - dx * way[1]
    return bool(0.0 <= along_m <= length_m and abs(aside_m) <= 0.5 * edge.width_m)


def _length_m(edge: WalkEdge) -> float:
    return float(np.hypot(*(edge.points_W_m[-1] - edge.points_W_m[0])))
