"""Where the chairs of the reaction bench stand: drawn from the seed, where traffic comes by."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.reaction.engineless_world import ReactionStage
from wcsim.towns.sumo.net import Lane, LaneKind, Net
from wcsim.types import F64

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


@dataclass(frozen=True, slots=True, kw_only=True)
class ChairPlace:
    """Where a chair stands."""

    kind: str
    p_W_m: tuple[float, float]
    yaw_rad: float


def busy_places(
    net: Net, stage: ReactionStage, scout_s: float, rng: np.random.Generator
) -> dict[str, tuple[ChairPlace, ...]]:
    """Places of every kind that the net has, those first where the most traffic comes by."""
    drawn = [place for kind in KINDS for place in _drawn(net, kind, rng)]
    counts = _passers(stage, np.array([place.p_W_m for place in drawn]).reshape(-1, 2), scout_s)
    order = [i for i in np.argsort(-counts, kind="stable") if counts[i] > 0]
    return {kind: tuple(drawn[i] for i in order if drawn[i].kind == kind) for kind in KINDS}


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


def _passers(stage: ReactionStage, places_W_m: F64, scout_s: float) -> F64:
    """How often somebody was near each place, while the street runs without a chair."""
    counts = np.zeros(len(places_W_m))
    if not len(places_W_m):
        return counts
    for _ in range(round(scout_s / _SCOUT_EVERY_S)):
        for _ in range(round(_SCOUT_EVERY_S / stage.tick_s)):
            stage.tick(())
        seen = np.array([a.p_W_m[:2] for a in stage.near(places_W_m, 12.0)]).reshape(-1, 2)
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
