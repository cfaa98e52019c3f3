"""People step aside for a wheelchair: an offset beside SUMO's pose, because SUMO itself does not know the chair.

The offset is a vector in W, so that it stays continuous when a person turns; it moves by at most 0.8 m/s, only onto
walkable ground that is clear of solid things and of others, and goes back to nothing after the person has passed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from wcsim.bridge.street import CHAIR_HALF_WIDTH_M, PERSON_GAP_M, ChairInStreet
from wcsim.types import F64, ActorKind, ActorState, ClassId, StreetGrid

SIDESTEP_MPS = 0.8
LOOK_AHEAD_M = 4.0
LOOK_BEHIND_M = 1.3  # a chair that was passed counts until the person is clear of its rear
SPARE_M = 0.1  # more than the gap at which a person stops, so that who stepped aside walks on
FURTHEST_M = 1.5
SOLID_GAP_M = 0.3
PERSON_APART_M = 0.45
CHAIR_APART_M = 0.85
WALKABLE = (ClassId.SIDEWALK, ClassId.CROSSWALK, ClassId.TERRAIN)


class Deflection:
    """Offsets of all persons near a wheelchair."""

    def __init__(self, grid: StreetGrid, tick_s: float) -> None:
        self._grid = grid
        self._step_m = SIDESTEP_MPS * tick_s
        self._offsets: dict[str, F64] = {}  # by actor id, (2,)

    def shifted(self, actors: Sequence[ActorState]) -> tuple[ActorState, ...]:
        """The actors where they really walk; `deflect_m` is the offset's part to their left."""
        return tuple(self._shift(actor) if actor.id in self._offsets else actor for actor in actors)

    def update(self, actors: Sequence[ActorState], chairs: Sequence[ChairInStreet]) -> None:
        """Move every offset by one tick; `actors` as SUMO has them, without offsets."""
        places = {a.id: a.p_W_m[:2] + self._offsets.get(a.id, 0.0) for a in actors if a.kind is ActorKind.PEDESTRIAN}
        offsets: dict[str, F64] = {}
        for actor in actors:
            if actor.kind is not ActorKind.PEDESTRIAN:
                continue
            now = self._offsets.get(actor.id, np.zeros(2))
            people = ((place, PERSON_APART_M) for name, place in places.items() if name != actor.id)
            others = chain(people, ((chair.p_W_m, CHAIR_APART_M) for chair in chairs))  # few persons ever look at them
            moved = self._moved(actor.p_W_m[:2], now, self._wish(actor, now, chairs), others)
            if moved.any():
                offsets[actor.id] = moved
        self._offsets = offsets

    def _shift(self, actor: ActorState) -> ActorState:
        offset = self._offsets[actor.id]
        left = np.array([-math.sin(actor.yaw_rad), math.cos(actor.yaw_rad)])
        p_W_m = np.array([*(actor.p_W_m[:2] + offset), actor.p_W_m[2]])
        return replace(actor, p_W_m=p_W_m, deflect_m=float(offset @ left))

    def _wish(self, actor: ActorState, now: F64, chairs: Sequence[ChairInStreet]) -> F64:
        """Where this person would like its offset to be: beside the nearest chair in its way, or nowhere."""
        ahead = np.array([math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)])
        left = np.array([-ahead[1], ahead[0]])
        need_m = CHAIR_HALF_WIDTH_M + 0.5 * actor.size_lwh_m[1] + PERSON_GAP_M + SPARE_M
        best, wish = math.inf, np.zeros(2)
        for chair in chairs:
            gap = chair.p_W_m - actor.p_W_m[:2]
            ahead_m, aside_m = float(gap @ ahead), float(gap @ left)
            if not -LOOK_BEHIND_M < ahead_m < LOOK_AHEAD_M or abs(aside_m) >= need_m or abs(ahead_m) >= best:
                continue
            best = abs(ahead_m)
            options = sorted((aside_m - need_m, aside_m + need_m), key=lambda m: (abs(m - float(now @ left)), m))
            free = [m for m in options if abs(m) <= FURTHEST_M and self._walkable(actor.p_W_m[:2] + m * left)]
            wish = free[0] * left if free else now
        return np.asarray(wish, np.float64)

    def _moved(self, from_W_m: F64, now: F64, wish: F64, others: Iterable[tuple[F64, float]]) -> F64:
        """One tick's step towards the wish, unless it leads too near to somebody or off the walkable ground."""
        way = wish - now
        length_m = float(np.hypot(*way))
        if length_m < 1e-9:
            return wish
        moved = now + way * min(1.0, self._step_m / length_m)
        here, there = from_W_m + now, from_W_m + moved
        crowded = any(
            np.hypot(*(there - other)) < min(apart_m, np.hypot(*(here - other))) for other, apart_m in others
        )
        back = float(np.hypot(*moved)) < float(np.hypot(*now))
        return now if crowded or not (back or self._walkable(there)) else np.asarray(moved, np.float64)

    def _walkable(self, p_W_m: F64) -> bool:
        clear = float(self._grid.clearance_at(p_W_m)) >= SOLID_GAP_M
        return clear and int(self._grid.class_at(p_W_m)) in WALKABLE
