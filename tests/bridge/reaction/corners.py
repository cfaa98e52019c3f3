"""Every corner of a town that a vehicle may turn at, and what its body covers there besides the carriageway.

The ways are those of the net, without SUMO: its lanes before, inside and behind a junction. What a rigid body that
follows them covers is reckoned twice: along the middle of the lanes, as SUMO leads it, and along the line that
`bridge/reaction/wide_turns.py` lays out for it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from wcsim.bridge.reaction.articulated import piece_lengths
from wcsim.bridge.reaction.wide_turns import STEP_M, _covered_m2, _normals, _offsets_m
from wcsim.core import frames
from wcsim.towns.sumo.net import Connection, Lane, Net
from wcsim.types import F64, ActorKind, Ground

TURNS_RAD = (math.radians(40.0), math.radians(150.0))  # less is a bend of the road, more a turn back
APPROACH_M = 45.0
BEFORE_M = 12.0  # a vehicle begins to swing out so long before a junction
MOST_LANES = 20  # before and behind a corner: nets have lanes of centimetres
TOUCH_M2 = 0.1  # a tenth of a square metre is a cell or two of the raster at a body's edge


@dataclass(frozen=True, slots=True, kw_only=True)
class LongVehicle:
    """Something that is long for a corner."""

    name: str
    vclass: str  # SUMO's
    kind: ActorKind
    length_m: float
    width_m: float
    swings: bool = True  # what runs on rails does not

    @property
    def body_m(self) -> tuple[float, float]:
        """Length and width of its longest rigid piece."""
        return max(piece_lengths(self.kind, self.length_m)), self.width_m


LONGEST = (
    LongVehicle(name="bus 12 m", vclass="bus", kind=ActorKind.BUS, length_m=12.0, width_m=2.55),
    LongVehicle(name="coach 14 m", vclass="coach", kind=ActorKind.BUS, length_m=14.0, width_m=2.55),
    LongVehicle(name="bus 15 m", vclass="bus", kind=ActorKind.BUS, length_m=15.0, width_m=2.55),
    LongVehicle(name="articulated bus 18 m", vclass="bus", kind=ActorKind.BUS, length_m=18.0, width_m=2.55),
    LongVehicle(name="trailer truck 16.5 m", vclass="trailer", kind=ActorKind.TRUCK, length_m=16.5, width_m=2.55),
    LongVehicle(name="tram 45 m", vclass="tram", kind=ActorKind.TRAM, length_m=45.0, width_m=2.4, swings=False),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corner:
    """A way through a junction that turns, of one vehicle class."""

    start: str  # lane ids
    end: str
    left: bool
    line_W_m: F64  # (n, 2) the lanes' middle, in steps of STEP_M
    inside_m: tuple[float, float]  # where the junction begins and ends on it


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """What a body covers besides the carriageway at one corner: the most at a time, in square metres."""

    corner: Corner
    before_m2: float
    after_m2: float
    furthest_m: float  # that its line is moved


def corners_of(net: Net, vclass: str) -> Iterator[Corner]:
    """The turns to either side that a class of vehicles may make, in the net's order."""
    lanes = {lane.id: lane for edge in net.edges for lane in edge.lanes if lane.permits(vclass)}
    following = {f"{c.start}_{c.start_lane}": c.via for c in net.connections if c.start.startswith(":")}
    ways = [way for way in (_way(connection, lanes, following) for connection in net.connections) if way is not None]
    links = _Links(before={}, after={})
    for way in ways:
        links.before.setdefault(way[-1].id, []).append(way)
        links.after.setdefault(way[0].id, []).append(way)
    for way in ways:
        turn_rad = _turn_rad(way)
        if len(way) > 2 and TURNS_RAD[0] <= abs(turn_rad) <= TURNS_RAD[1]:
            yield _corner(way, turn_rad > 0.0, links)


def sweep(corner: Corner, vehicle: LongVehicle, ground: Ground) -> Sweep:
    """What a vehicle covers at a corner, as SUMO leads it and as it is shown."""
    line, found = corner.line_W_m, np.zeros(len(corner.line_W_m))
    if vehicle.swings:
        found = _offsets_m(line, vehicle.body_m, ground, np.zeros(0))
    before_m2, after_m2 = (
        _most_m2(corner, line_W_m, vehicle.body_m, ground)
        for line_W_m in (line, line + found[:, None] * _normals(line))
    )
    return Sweep(
        corner=corner, before_m2=before_m2, after_m2=after_m2, furthest_m=float(np.abs(found).max(initial=0.0))
    )


def _most_m2(corner: Corner, line_W_m: F64, body_m: tuple[float, float], ground: Ground) -> float:
    """The most that the body covers off the carriageway while its front comes near the junction and its rear leaves."""
    covered = _covered_m2(line_W_m, body_m, ground)
    fronts_m = STEP_M * (np.arange(len(covered)) + len(line_W_m) - len(covered))
    first_m, last_m = corner.inside_m
    there = (fronts_m > first_m - BEFORE_M) & (fronts_m < last_m + body_m[0])
    return float(covered[there].max(initial=0.0))


Way = list[Lane]  # a lane, those inside a junction, and the lane behind it


@dataclass(frozen=True, slots=True, kw_only=True)
class _Links:
    """The ways that lead to each lane, and those that lead on from it."""

    before: dict[str, list[Way]]
    after: dict[str, list[Way]]


def _way(connection: Connection, lanes: dict[str, Lane], following: dict[str, str]) -> Way | None:
    """The lanes of a connection between streets; None where it is none, or for others."""
    start, end = (
        lanes.get(f"{edge}_{index}")
        for edge, index in ((connection.start, connection.start_lane), (connection.end, connection.end_lane))
    )
    if start is None or end is None or start.internal:
        return None
    return [start, *_inside(connection.via, lanes, following), end]


def _inside(via: str, lanes: dict[str, Lane], following: dict[str, str]) -> list[Lane]:
    found: list[Lane] = []
    while via in lanes and lanes[via] not in found:
        found.append(lanes[via])
        via = following.get(via, "")
    return found


def _turn_rad(way: Way) -> float:
    return frames.wrap_angle(_heading(way[-1].points_m[:2]) - _heading(way[0].points_m[-2:]))


def _heading(points: F64) -> float:
    dx, dy = points[-1] - points[0]
    return math.atan2(dy, dx)


def _corner(way: Way, left: bool, links: _Links) -> Corner:
    """A corner with the straightest way to it and on from it, of `APPROACH_M` where the net has so much."""
    before, behind = [way[0]], [way[-1]]
    while sum(lane.length_m for lane in before) < APPROACH_M and links.before.get(before[0].id):
        before = min(links.before[before[0].id], key=lambda one: abs(_turn_rad(one)))[:-1] + before
        if len(before) > MOST_LANES:
            break
    while sum(lane.length_m for lane in behind) < APPROACH_M and links.after.get(behind[-1].id):
        behind = behind + min(links.after[behind[-1].id], key=lambda one: abs(_turn_rad(one)))[1:]
        if len(behind) > MOST_LANES:
            break
    first, inside, last = (
        np.concatenate([lane.points_m for lane in lanes] or [np.zeros((0, 2))]) for lanes in (before, way[1:-1], behind)
    )
    points = np.concatenate([first, inside, last])
    arc_m = np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T).cumsum()])
    into_m, out_m = arc_m[len(first) - 1], arc_m[len(first) + len(inside)]
    at_m = np.arange(max(0.0, into_m - APPROACH_M), min(arc_m[-1], out_m + APPROACH_M), STEP_M)
    line_W_m = np.stack([np.interp(at_m, arc_m, points[:, 0]), np.interp(at_m, arc_m, points[:, 1])], axis=1)
    inside_m = float(into_m - at_m[0]), float(out_m - at_m[0])
    return Corner(start=way[0].id, end=way[-1].id, left=left, line_W_m=line_W_m, inside_m=inside_m)
