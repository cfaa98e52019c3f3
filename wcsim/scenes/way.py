"""What a scene's chairs drive over: how narrow the pavement was, and what the light showed as they began to cross."""

from __future__ import annotations

import numpy as np

from wcsim.scenes.facts import ALONE_M
from wcsim.scenes.others import chair_box
from wcsim.types import F64, ClassId, Ground, Outline, Snapshot, WalkEdge, WalkGraph, WayKind
from wcsim.users.crossing import Crossing, is_red

LOOK_ASIDE_M, STEP_M = 4.0, 0.05
_PAVEMENT = (ClassId.SIDEWALK, ClassId.LOWERED_KERB)
_OFFSETS_M = np.arange(0.0, LOOK_ASIDE_M, STEP_M)


class WayMeter:
    """Adds up what the chairs' ways are like."""

    def __init__(self, ground: Ground, walk: WalkGraph, seats: int, outline: Outline) -> None:
        self._outline = outline
        self.narrowest_m = ALONE_M
        self.red_starts = self.green_starts = 0
        self._ground = ground
        crossings = [edge for edge in walk.edges if edge.kind is WayKind.CROSSING and _length_m(edge) > 0.0]
        self._lights = [edge for edge in crossings if edge.tls_id]
        self._on: list[set[str]] = [set() for _ in range(seats)]  # the crossings that each chair is on

    def add(self, snapshot: Snapshot) -> None:
        """One tick."""
        for seat, client in enumerate(snapshot.clients):
            x, y, cos, sin, long_m, _ = chair_box(client, self._outline)
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
            red = is_red(_crossing(edge), snapshot.signals)
            self.red_starts += red
            self.green_starts += not red
        self._on[seat] = set(on)


def _free_width_m(ground: Ground, here_W_m: F64, left_W: F64) -> float:
    """How wide the free pavement is across a point (2,), along a unit vector; at most twice `LOOK_ASIDE_M`."""
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


def _crossing(edge: WalkEdge) -> Crossing:
    ends = [(float(x), float(y)) for x, y in (edge.points_W_m[0], edge.points_W_m[-1])]
    return Crossing(
        start_m=0.0,
        end_m=_length_m(edge),
        start_W_m=ends[0],
        end_W_m=ends[1],
        tls_id=edge.tls_id,
        tls_links=edge.tls_links,
    )
