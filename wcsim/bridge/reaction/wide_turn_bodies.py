"""Long vehicles take bends wide: where each is shown, beside where SUMO has it.

SUMO itself is told nothing. What moves is the line that front and rear follow (`bridge/reaction/wide_turns.py`), so
that the body stays one box which drives along its own heading; the mirror, the cameras, the oracle and the reaction all
see it there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from wcsim.bridge.reaction.articulated import piece_lengths
from wcsim.bridge.reaction.commands import is_person
from wcsim.bridge.reaction.swept_path import AHEAD_M, TAIL_M, Roads, Tube, moved_line, points_of, way_ahead
from wcsim.bridge.reaction.wide_turns import STEP_M, normals, offsets_m
from wcsim.core import frames
from wcsim.core.joystick import towards
from wcsim.types import F64, ActorKind, ActorState, Ground

LONG_M = 7.0  # what is shorter keeps off the pavement by itself
LINE_ERROR_M = 0.1  # between the line laid out ahead and where the body comes to run
JUMP_M = 2.0  # SUMO has put it elsewhere when it is so much further than its speed leads it
ASIDE_SHARE = 0.6  # of the way it drives that a body is moved sideways at most, where its way has become another one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Way:
    """A vehicle's way and how far it swings out along it."""

    tube: Tube
    first_m: float  # of the offsets on the way's line
    offsets_m: F64  # (n,) to the left, in steps of STEP_M
    left: F64  # (n, 2) that direction

    def at_m(self, line_m: F64) -> F64:
        """The offsets at these places of the line."""
        return np.interp(line_m, self.first_m + STEP_M * np.arange(len(self.offsets_m)), self.offsets_m)

    def left_of(self, line_m: F64) -> F64:
        """The directions (n, 2) to the left of these places of the line."""
        known_m = self.first_m + STEP_M * np.arange(len(self.left))
        return np.stack([np.interp(line_m, known_m, self.left[:, k]) for k in (0, 1)], axis=1)

    @property
    def straight(self) -> bool:
        """Whether it stays in the middle of its lanes."""
        return not self.offsets_m.any()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Driven:
    """What is remembered of a vehicle from tick to tick."""

    way: _Way | None
    front_W_m: F64  # (2,) as SUMO has it
    aside_m: tuple[float, float]  # of its front and rear, to the left
    left: F64  # (2, 2) that direction, of each of them
    speed_mps: float  # as SUMO has it
    shown_W_m: F64  # (2,) where it is shown: its middle, or the front of one that bends
    yaw_rad: float = 0.0
    v_W_mps: F64 | None = None  # (2,) of that place; None for one that has just come near


class SwingOut:
    """All long vehicles near a wheelchair."""

    def __init__(self, ground: Ground, tick_s: float) -> None:
        self._ground = ground
        self._tick_s = tick_s
        self._driven: dict[str, _Driven] = {}
        self._lines: dict[str, tuple[Tube, _Way, Tube]] = {}

    def shown(self, actors: Sequence[ActorState], roads: Roads) -> tuple[ActorState, ...]:
        """The actors of now, SUMO's own places given; long vehicles beside theirs where they swing out.

        Who has left its lanes (parked, stopped by its plan) stays as far aside as it was.
        """
        driven: dict[str, _Driven] = {}
        found = []
        for actor in actors:
            if actor.size_lwh_m[0] < LONG_M or actor.kind is ActorKind.TRAM or is_person(actor):
                found.append(actor)
                continue
            now = driven[actor.id] = self._followed(actor, roads)
            found.append(actor if now.aside_m == (0.0, 0.0) else _beside(actor, now))
        self._driven = driven
        self._lines = {name: line for name, line in self._lines.items() if name in driven}
        return tuple(found)

    def led(self, actor: ActorState) -> ActorState:
        """The actor as its driver reckons: as fast as SUMO drives it, whose line is shorter, and a little wider."""
        known = self._driven.get(actor.id)
        if known is None or known.v_W_mps is None or known.aside_m == (0.0, 0.0):
            return actor
        length_m, width_m, height_m = actor.size_lwh_m
        return replace(
            actor,
            v_W_mps=known.speed_mps * frames.forward(actor.yaw_rad, actor.pitch_rad),
            size_lwh_m=(length_m, width_m + 2.0 * LINE_ERROR_M, height_m),
        )

    def line(self, actor: ActorState, tube: Tube) -> Tube:
        """The way that a vehicle's body sweeps when it swings out, for one that keeps to the middle of its lanes."""
        known = self._driven.get(actor.id)
        if known is None or known.way is None or known.way.straight:
            return tube
        way, old = known.way, self._lines.get(actor.id)
        if old is not None and old[0] is tube and old[1] is way:
            return old[2]
        shift_m = _shift_m(tube, way.tube)
        if shift_m is None:
            return tube
        at_m = np.arange(float(tube.arc_m[0]), tube.end_m, STEP_M)
        aside_m = way.at_m(at_m - shift_m)
        line_W_m = points_of(tube, at_m) + aside_m[:, None] * way.left_of(at_m - shift_m)
        moved = moved_line(tube, at_m, line_W_m, actor.size_lwh_m[0])
        self._lines[actor.id] = tube, way, moved
        return moved

    def _followed(self, actor: ActorState, roads: Roads) -> _Driven:
        """Where a vehicle has come to since the last tick."""
        old = self._driven.get(actor.id)
        front_W_m = _front(actor)
        speed_mps = float(np.linalg.norm(actor.v_W_mps))
        if old is not None and np.array_equal(front_W_m, old.front_W_m):
            return replace(old, speed_mps=speed_mps)
        if old is not None and math.dist(front_W_m, old.front_W_m) > speed_mps * self._tick_s + JUMP_M:
            old = None
        way, aside_m, left = self._aside(actor, roads, old)
        if old is not None:  # onto another way by degrees
            most_m = ASIDE_SHARE * math.dist(front_W_m, old.front_W_m)
            aside_m = towards(old.aside_m[0], aside_m[0], most_m), towards(old.aside_m[1], aside_m[1], most_m)
        shown_W_m, yaw_rad = _place(actor, front_W_m, aside_m, left)
        v_W_mps = None if old is None else (shown_W_m - old.shown_W_m) / self._tick_s
        return _Driven(
            way=way,
            front_W_m=front_W_m,
            aside_m=aside_m,
            left=left,
            speed_mps=speed_mps,
            shown_W_m=shown_W_m,
            yaw_rad=yaw_rad,
            v_W_mps=v_W_mps,
        )

    def _aside(
        self, actor: ActorState, roads: Roads, old: _Driven | None
    ) -> tuple[_Way | None, tuple[float, float], F64]:
        """A vehicle's way, how far aside its front and rear should be, and the directions of that."""
        place = roads.on_lane(actor.id)
        if place is None:
            here = np.array([-math.sin(actor.yaw_rad), math.cos(actor.yaw_rad)])
            return (None, (0.0, 0.0), np.stack([here, here])) if old is None else (None, old.aside_m, old.left)
        before = None if old is None else old.way
        tube = way_ahead(actor, place, roads, None if before is None else before.tube)
        line_m = tube.front_m(place)
        known = before is not None and before.tube is tube
        way = before if before is not None and known else self._laid_out(actor, tube, line_m, before)
        both_m = np.array([line_m, line_m - actor.size_lwh_m[0]])
        ahead_m, behind_m = way.at_m(both_m).tolist()
        return way, (ahead_m, behind_m), way.left_of(both_m)

    def _laid_out(self, actor: ActorState, tube: Tube, line_m: float, old: _Way | None) -> _Way:
        first_m = line_m - actor.size_lwh_m[0] - TAIL_M
        at_m = np.arange(first_m, min(line_m + AHEAD_M, tube.end_m), STEP_M)
        line_W_m = points_of(tube, at_m)
        left, held_m = normals(line_W_m), np.zeros(0)
        shift_m = None if old is None else _shift_m(tube, old.tube)
        if old is not None and shift_m is not None:  # what has been driven stays as it was
            driven_m = at_m[at_m <= line_m] - shift_m
            held_m, left[: len(driven_m)] = old.at_m(driven_m), old.left_of(driven_m)
        body_m = max(piece_lengths(actor.kind, actor.size_lwh_m[0])), actor.size_lwh_m[1]
        return _Way(
            tube=tube,
            first_m=first_m,
            offsets_m=offsets_m(line_W_m, body_m, self._ground, held_m),
            left=left,
        )


def _front(actor: ActorState) -> F64:
    length_m = actor.size_lwh_m[0]
    return frames.front_from_centre(actor.p_W_m, actor.yaw_rad, actor.pitch_rad, length_m)[:2]


def _shift_m(tube: Tube, other: Tube) -> float | None:
    """How much further on the one line the lanes begin than on the other; None when they share no lane."""
    for name, (start_m, _) in tube.start_m.items():
        if name in other.start_m:
            return start_m - other.start_m[name][0]
    return None


def _place(actor: ActorState, front_W_m: F64, aside_m: tuple[float, float], left: F64) -> tuple[F64, float]:
    """Where a vehicle is shown (2,), as in `_Driven`, and its yaw."""
    flat_m = actor.size_lwh_m[0] * math.cos(actor.pitch_rad)
    heading = np.array([math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)])
    front = front_W_m + aside_m[0] * left[0]
    x, y = (front - front_W_m + flat_m * heading - aside_m[1] * left[1]).tolist()
    long = math.hypot(x, y)
    bends = len(piece_lengths(actor.kind, actor.size_lwh_m[0])) > 1
    return (front if bends else front - 0.5 * flat_m / long * np.array([x, y])), math.atan2(y, x)


def _beside(actor: ActorState, now: _Driven) -> ActorState:
    """The actor where it is shown."""
    ahead = frames.forward(now.yaw_rad, actor.pitch_rad)
    bends = len(piece_lengths(actor.kind, actor.size_lwh_m[0])) > 1
    middle = now.shown_W_m - (0.5 * actor.size_lwh_m[0] * ahead[:2] if bends else 0.0)
    moved = middle - actor.p_W_m[:2]
    v_W_mps = actor.v_W_mps
    if now.v_W_mps is not None and v_W_mps.any():
        v_W_mps = np.array([*now.v_W_mps, v_W_mps[2]])
    return replace(
        actor,
        p_W_m=np.array([*middle, actor.p_W_m[2]]),
        yaw_rad=now.yaw_rad,
        v_W_mps=v_W_mps,
        deflect_m=float(moved[1] * math.cos(actor.yaw_rad) - moved[0] * math.sin(actor.yaw_rad)),
    )
