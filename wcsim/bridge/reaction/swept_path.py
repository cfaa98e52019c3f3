"""Where a vehicle's body will sweep along the lanes that lie ahead of it.

SUMO leads the front bumper along the lane and turns the body so that its tail lies on the same
line; a long vehicle cuts corners. The way is laid out once per lane, as poses of the body half a
metre apart.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from wcsim.types import F64, ActorState

STEP_M = 0.5
AHEAD_M = 70.0  # farther than anything brakes for a chair
TAIL_M = 3.0  # of the way, behind the vehicle's tail
# A way is laid out anew after so much of it, the second where it ends soon.
_FRESH_M, _SHORT_M = 25.0, 5.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneShape:
    """One lane of the net, as the vehicles drive it."""

    id: str
    edge_id: str
    index: int
    points_W_m: F64  # (K, 2) centre line
    length_m: float  # as SUMO counts, which may differ from the line's own length
    width_m: float
    internal: bool  # inside a junction
    shared: bool = False  # people on foot use it too


@dataclass(frozen=True, slots=True, kw_only=True)
class OnLane:
    """Where a vehicle is in its lane."""

    lane_id: str
    along_m: float  # of the front bumper, as SUMO counts
    left_m: float  # of the lane's centre line


@dataclass(frozen=True, slots=True, kw_only=True)
class Brakes:
    """What SUMO lets a vehicle do."""

    service_mps2: float
    emergency_mps2: float


class Roads(Protocol):
    """What the reaction reads of SUMO about a vehicle; actors are named as in `ActorState.id`."""

    @property
    def sublanes(self) -> bool:
        """Whether vehicles can move sideways within their lanes."""

    def on_lane(self, actor_id: str) -> OnLane | None:
        """Where a vehicle is now; None when it is on no lane (teleported, parked, gone)."""

    def lanes_ahead(self, actor_id: str, ahead_m: float) -> tuple[str, ...]:
        """The lane of a vehicle and those on its route, also inside junctions."""

    def lane(self, lane_id: str) -> LaneShape:
        """A lane's shape."""

    def lanes_beside(self, actor_id: str, ahead_m: float) -> tuple[int, ...]:
        """Indices of the lanes directly left and right of a vehicle's, the left one first.

        Only those that its class may use, and on which its route leads on so far.
        """

    def brakes(self, actor_id: str) -> Brakes:
        """A vehicle's brakes."""

    def allowed_mps(self, actor_id: str) -> float:
        """The speed that a vehicle would drive on a free road."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tube:
    """The poses of a vehicle's body along its way, as if it kept to the middle of its lanes."""

    points_W_m: F64  # (K, 2) the line of the front bumper
    arc_m: F64  # (K,)
    # By lane: where it begins on the line, and its own metres per SUMO's.
    start_m: Mapping[str, tuple[float, float]]
    # (n, 4) x, y of the body's middle, cos, sin of its heading; front at first_m + i * STEP_M.
    poses: F64
    first_m: float

    @property
    def end_m(self) -> float:
        """Where the known way ends."""
        return float(self.arc_m[-1])

    def front_m(self, place: OnLane) -> float:
        """Where the front bumper is on the line."""
        start_m, scale = self.start_m[place.lane_id]
        return start_m + scale * place.along_m

    def at(self, at_m: F64) -> F64:
        """Points (n, 2) of the line at these distances, straight on beyond its ends."""
        return _at(self.points_W_m, self.arc_m, at_m)

    def moved(self, arc_m: F64, points_W_m: F64, length_m: float) -> Self:
        """The same way along another line of points (n, 2), at the old line's arcs (n,)."""
        poses = _poses(points_W_m, arc_m, self.first_m, length_m)
        return replace(self, points_W_m=points_W_m, arc_m=arc_m, poses=poses)

    def lane_at(self, front_m: float) -> str:
        """The lane that a place of the line lies in."""
        starts = [(start, name) for name, (start, _) in self.start_m.items()]
        passed = [each for each in starts if each[0] <= front_m + 1e-6]
        return (max(passed) if passed else min(starts))[1]


def way_ahead(actor: ActorState, place: OnLane, roads: Roads, old: Tube | None) -> Tube:
    """The vehicle's way: the old one while it holds and leads far enough, else a new one."""
    if old is not None and place.lane_id in old.start_m:
        front_m = old.front_m(place)
        short = old.first_m + len(old.poses) * STEP_M - front_m < 0.5 * AHEAD_M
        moved_m = abs(front_m - old.first_m - TAIL_M)
        if moved_m < (_SHORT_M if short else _FRESH_M) or roads.lane(place.lane_id).internal:
            return old
    lanes = [roads.lane(name) for name in roads.lanes_ahead(actor.id, AHEAD_M)]
    heading = np.array([math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)])
    tail_W_m = actor.p_W_m[:2] - 0.5 * actor.size_lwh_m[0] * heading
    return _lay_out(lanes, place.along_m, actor.size_lwh_m[0], tail_W_m, old)


def _lay_out(
    lanes: Sequence[LaneShape], along_m: float, length_m: float, tail_W_m: F64, old: Tube | None
) -> Tube:
    """The way over `lanes`, whose first one the vehicle is in.

    Args:
        lanes: From the vehicle's lane on.
        along_m: The front bumper's place in the first of them, as SUMO counts.
        length_m: The vehicle's length.
        tail_W_m: Middle of its rear now (2,); used where nothing is known of where it came from.
        old: Its way before, if there was one.
    """
    known = old is not None and lanes[0].id in old.start_m
    if old is not None and known:
        start_m = old.start_m[lanes[0].id][0]
        first = max(0, int(np.searchsorted(old.arc_m, start_m - length_m - TAIL_M)) - 1)
        points = old.points_W_m[first:][old.arc_m[first:] < start_m - 1e-6]
    else:
        points = tail_W_m[None] if _scale(lanes[0]) * along_m < length_m else np.zeros((0, 2))
    starts: dict[str, tuple[float, float]] = {}
    arc_m = float(np.hypot(*np.diff(points, axis=0).T).sum()) if len(points) > 1 else 0.0
    for lane in lanes:
        if len(points):
            arc_m += math.dist(points[-1], lane.points_W_m[0])
        # A route may lead over one lane twice; the vehicle is at its first place.
        starts.setdefault(lane.id, (arc_m, _scale(lane)))
        arc_m += _line_m(lane.points_W_m)
        points = np.concatenate([points, lane.points_W_m])
    arcs_m = np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T).cumsum()])
    # Lanes end where the next begin: a doubled point would be a piece without direction.
    moves_on = np.concatenate([[True], np.diff(arcs_m) > 1e-9])
    points, arcs_m = points[moves_on], arcs_m[moves_on]
    first_m = max(0.0, starts[lanes[0].id][0] + _scale(lanes[0]) * along_m - TAIL_M)
    poses = _poses(points, arcs_m, first_m, length_m)
    return Tube(points_W_m=points, arc_m=arcs_m, start_m=starts, poses=poses, first_m=first_m)


def _poses(points: F64, arc_m: F64, first_m: float, length_m: float) -> F64:
    front_m = np.arange(first_m, max(first_m, float(arc_m[-1])) + STEP_M, STEP_M)
    # Bounded, as a single lane of a motorway may be kilometres long.
    front_m = front_m[: math.ceil((AHEAD_M + 2.0 * TAIL_M) / STEP_M) * 4]
    front = _at(points, arc_m, front_m)
    chord = front - _at(points, arc_m, front_m - length_m)
    chord /= np.maximum(np.hypot(*chord.T), 1e-9)[:, None]
    return np.ascontiguousarray(np.hstack([front - 0.5 * length_m * chord, chord]))


def _at(points: F64, arc_m: F64, at_m: F64) -> F64:
    """Points of a line at these distances, going straight on beyond its ends; (n, 2)."""
    p = np.stack([np.interp(at_m, arc_m, points[:, k]) for k in (0, 1)], axis=1)
    if len(points) > 1:
        before, after = at_m < arc_m[0], at_m > arc_m[-1]
        first, last = points[1] - points[0], points[-1] - points[-2]
        p[before] += np.outer(at_m[before] - arc_m[0], first / math.hypot(*first))
        p[after] += np.outer(at_m[after] - arc_m[-1], last / math.hypot(*last))
    return p


def _line_m(points: F64) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _scale(lane: LaneShape) -> float:
    return _line_m(lane.points_W_m) / max(lane.length_m, 1e-6)
