"""When a chair leaves the pavement over a kerb, away from any crossing."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from wcsim.bridge.reaction.commands import ROADWAY
from wcsim.types import F64, ClassId, Ground, WalkEdge, WalkGraph, WayKind

_FALL_M: Final = 0.03  # a flush or lowered edge is no fall
BESIDE_M: Final = 1.0  # so far beside and before a crossing a chair still uses it
EDGES = (ClassId.KERB, ClassId.LOWERED_KERB, ClassId.VOID)  # neither pavement nor road


class KerbFall:
    """One chair in one episode; needs every tick of it."""

    def __init__(self, ground: Ground, walk: WalkGraph) -> None:
        self._ground = ground
        self._crossings = [edge for edge in walk.edges if edge.kind is WayKind.CROSSING]
        self._raised_m: float | None = None  # of the pavement or verge on which the middle was last, None on the road

    def see(self, middle_W_m: F64) -> bool:
        """Whether the chair's middle (2 or 3,) has just come from pavement or verge onto the carriageway below it."""
        x, y = float(middle_W_m[0]), float(middle_W_m[1])
        surface = self._ground.class_here(x, y)
        if surface in EDGES:
            return False
        raised_m = float(self._ground.raised_at(np.array([x, y])))
        if surface not in ROADWAY:
            self._raised_m = raised_m
            return False
        before_m, self._raised_m = self._raised_m, None
        if before_m is None or before_m - raised_m < _FALL_M or surface == ClassId.CROSSWALK:
            return False
        return not any(away_m(edge, x, y) <= 0.5 * edge.width_m + BESIDE_M for edge in self._crossings)


def away_m(edge: WalkEdge, x_m: float, y_m: float) -> float:
    """Distance from a point to the line of a way."""
    a, b = edge.points_W_m[:-1, :2], edge.points_W_m[1:, :2]
    along, off = b - a, np.array([x_m, y_m]) - a
    share = np.clip((off * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
    return float(np.hypot(*(off - share[:, None] * along).T).min(initial=math.inf))


def nearest_way(walk: WalkGraph, x_m: float, y_m: float) -> str:
    """The id of the walking way that is nearest to a point, "" without any."""
    nearest = min(walk.edges, key=lambda edge: away_m(edge, x_m, y_m), default=None)
    return "" if nearest is None else nearest.sumo_id
