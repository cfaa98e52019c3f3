"""Where the chairs of the reaction bench stand and roll out: drawn from the seed, where traffic comes by."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.reaction.engineless_world import ReactionStage
from wcsim.errors import TownError
from wcsim.towns.sumo.net import Lane, LaneKind, Net
from wcsim.types import F64, ActorState

KINDS = ("pavement", "bike_lane", "zebra", "carriageway")
_LANES = {
    "pavement": (LaneKind.SIDEWALK,),
    "bike_lane": (LaneKind.BIKE, LaneKind.SHARED),
    "zebra": (LaneKind.CROSSING,),
    "carriageway": (LaneKind.MOTOR,),
}
_CANDIDATES = 60
_FROM_ENDS_M = 12.0
_SCOUT_EVERY_S = 1.0
_SEEN_M = 2.5  # traffic this near to a place comes by there
MOVING_MPS = 3.0
GAP_M = 0.05  # between the front of a chair and the lane that it rolls out to


@dataclass(frozen=True, slots=True, kw_only=True)
class ChairPlace:
    """Where a chair stands."""

    kind: str
    p_W_m: tuple[float, float]
    yaw_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RollOut:
    """A way across a lane in mid-block: the chair's front starts at the lane's right edge."""

    start_W_m: tuple[float, float]  # middle of the chair
    yaw_rad: float
    lane_p_W_m: tuple[float, float]  # on the lane's middle, where the chair will cross it
    lane_yaw_rad: float
    lane_width_m: float

    def arrives_s(self, actor: ActorState) -> float:
        """Seconds until a vehicle in this lane would be there; infinite for one that is past it, and everybody else."""
        dx, dy = actor.p_W_m[0] - self.lane_p_W_m[0], actor.p_W_m[1] - self.lane_p_W_m[1]
        cos, sin = math.cos(self.lane_yaw_rad), math.sin(self.lane_yaw_rad)
        speed_mps = float(actor.v_W_mps[0] * cos + actor.v_W_mps[1] * sin)
        before_m = -(dx * cos + dy * sin) - 0.5 * actor.size_lwh_m[0]
        beside = abs(dy * cos - dx * sin) > 0.5 * self.lane_width_m
        if not actor.id.startswith("v:") or beside or speed_mps < MOVING_MPS or before_m < -3.0:
            return math.inf
        return float(before_m) / speed_mps


def busy_places(
    net: Net, stage: ReactionStage, scout_s: float, rng: np.random.Generator
) -> dict[str, tuple[ChairPlace, ...]]:
    """Places of every kind that the net has, those first where the most traffic comes by."""
    drawn = [place for kind in KINDS for place in _drawn(net, kind, rng)]
    counts = _passers(stage, np.array([place.p_W_m for place in drawn]).reshape(-1, 2), scout_s)
    order = [i for i in np.argsort(-counts, kind="stable") if counts[i] > 0]
    return {kind: tuple(drawn[i] for i in order if drawn[i].kind == kind) for kind in KINDS}


def roll_outs(net: Net, stage: ReactionStage, many: int, scout_s: float, rng: np.random.Generator) -> Sequence[RollOut]:
    """Ways across lanes that have traffic, the busiest first. Raises TownError when the net has none."""
    lanes = [lane for lane in _rightmost(net) if _length_m(lane) > 3.0 * _FROM_ENDS_M]
    if not lanes:
        raise TownError("bench reaction: no street long enough to roll out in mid-block; choose another town")
    ways = [_roll_out(lanes[int(rng.integers(len(lanes)))], stage.half_m[0], rng) for _ in range(_CANDIDATES)]
    counts = _passers(stage, np.array([way.lane_p_W_m for way in ways]), scout_s, MOVING_MPS)
    order = np.argsort(-counts, kind="stable")[: max(1, min(many, 8))]
    return [ways[i] for i in order]


def _drawn(net: Net, kind: str, rng: np.random.Generator) -> list[ChairPlace]:
    lanes = [lane for lane in net.lanes(*_LANES[kind]) if not lane.internal]
    ends_m = 0.0 if kind == "zebra" else _FROM_ENDS_M
    long = [lane for lane in lanes if _length_m(lane) > 2.0 * ends_m + 2.0]
    if not long:
        return []
    weight = np.array([_length_m(lane) for lane in long])
    places = []
    for i in rng.choice(len(long), _CANDIDATES, p=weight / weight.sum()):
        lane = long[i]
        at_m = rng.uniform(ends_m, _length_m(lane) - ends_m)
        aside_m = rng.uniform(-1.0, 1.0) * max(0.0, 0.5 * lane.width_m - 0.5)
        point, yaw_rad = _along(lane.points_m, at_m, aside_m)
        turned_rad = float(rng.choice((0.0, math.pi, 0.5 * math.pi, rng.uniform(-math.pi, math.pi))))
        places.append(ChairPlace(kind=kind, p_W_m=point, yaw_rad=yaw_rad + turned_rad))
    return places


def _rightmost(net: Net) -> list[Lane]:
    """The motor lane of each street that lies nearest to its pavement."""
    found = []
    for edge in net.edges:
        motor = [lane for lane in edge.lanes if lane.kind is LaneKind.MOTOR and not lane.internal]
        found += motor[:1]
    return found


def _roll_out(lane: Lane, half_length_m: float, rng: np.random.Generator) -> RollOut:
    at_m = rng.uniform(_FROM_ENDS_M, _length_m(lane) - _FROM_ENDS_M)
    middle, yaw_rad = _along(lane.points_m, at_m, 0.0)
    start, _ = _along(lane.points_m, at_m, -0.5 * lane.width_m - GAP_M - half_length_m)
    return RollOut(
        start_W_m=start,
        yaw_rad=yaw_rad + 0.5 * math.pi,
        lane_p_W_m=middle,
        lane_yaw_rad=yaw_rad,
        lane_width_m=lane.width_m,
    )


def _passers(stage: ReactionStage, places_W_m: F64, scout_s: float, faster_mps: float = -1.0) -> F64:
    """How often somebody (faster than this) was near each place, while the street runs without a chair."""
    counts = np.zeros(len(places_W_m))
    if not len(places_W_m):
        return counts
    for _ in range(round(scout_s / _SCOUT_EVERY_S)):
        for _ in range(round(_SCOUT_EVERY_S / stage.tick_s)):
            stage.tick(())
        near = [a for a in stage.near(places_W_m, 12.0) if float(np.hypot(*a.v_W_mps[:2])) > faster_mps]
        seen = np.array([a.p_W_m[:2] for a in near]).reshape(-1, 2)
        if len(seen):
            gap_m = np.linalg.norm(places_W_m[:, None] - seen[None], axis=2)
            counts += (gap_m < _SEEN_M).sum(axis=1)
    return counts


def _along(points: F64, at_m: float, left_m: float) -> tuple[tuple[float, float], float]:
    """A point of a line at a distance from its start, moved to the left, and the line's heading there."""
    arc_m = np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T).cumsum()])
    i = int(np.clip(np.searchsorted(arc_m, at_m, side="right") - 1, 0, len(points) - 2))
    step = points[i + 1] - points[i]
    yaw_rad = math.atan2(step[1], step[0])
    x, y = points[i] + step * (at_m - arc_m[i]) / max(float(arc_m[i + 1] - arc_m[i]), 1e-9)
    return (float(x - left_m * math.sin(yaw_rad)), float(y + left_m * math.cos(yaw_rad))), yaw_rad


def _length_m(lane: Lane) -> float:
    return float(np.hypot(*np.diff(lane.points_m, axis=0).T).sum())
