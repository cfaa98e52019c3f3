"""Turning round beside kerbs and walls: where a chair has room for it, and how far to back up or creep on for that.

A chair turns about its drive axle, and its front swings out. What it must not touch with any part are walls and kerbs
that rise; over kerbs that fall it may lean, as long as its wheels stay up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wcsim.core.constants import KERB_STEP_CM
from wcsim.core.jit import exact_kernel
from wcsim.types import F64, U8, Ground, Outline

STEP_M = 0.2
FARTHEST_M = 2.4
MARGIN_M = 0.05
RAYS = 72
RAY_STEP_M = 0.05
RAY_STEPS = 19
_CREEP_COST_RAD = 0.35  # creeping on for one metre is worth turning this much less
_NO_TURN_RAD = 0.25  # less than this is not worth the trouble
_DONE_RAD, _DONE_M = 0.2, 0.06
LONGEST_S = 8.0  # whoever has not got there by then looks anew
_ELSEWHERE_M = 0.35  # so far away a turn that was not possible may be

# Wheels and casters stand so much inside the chair's ends, and as wide as its sides.
_WHEELS_IN_M = 0.22


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """What to do to face another way."""

    move_m: float  # first along the heading, negative is backwards
    turn_rad: float  # then on the spot, left positive
    whole: bool = True  # all of what is wanted; else as far as there is room


@dataclass(frozen=True, slots=True, kw_only=True)
class Axle:
    """The chair as it turns: its drive axle in W."""

    x_m: float
    y_m: float
    yaw_rad: float


def plan_turn(
    ground: Ground,
    outline: Outline,
    axle: Axle,
    error_rad: float,
    backwards: bool = True,
    tried: float = 0.0,
) -> Turn:
    """How to turn by `error_rad` (left positive): where there is room, and to the side that has it.

    Args:
        ground: The street from above.
        outline: The chair's box.
        axle: Where the chair stands.
        error_rad: The turn that is wanted, within -pi..pi.
        backwards: Whether the driver can reverse.
        tried: The side (left positive) to which the chair has just turned here as far as it can, 0 for neither: turning
            back again would never end.

    Returns:
        The turn with the shortest way to a place with room for all of it; without one, the place with room for most of
        it; without any, just the turn, or, after one was tried, the way to the farthest place.
    """
    shifts_m = _shifts(backwards)
    cos, sin = math.cos(axle.yaw_rad), math.sin(axle.yaw_rad)
    pivots = np.array([axle.x_m, axle.y_m]) + shifts_m[:, None] * np.array([cos, sin])
    grid = ground.around(pivots[0])
    origin_m = np.array(grid.origin_W_m, np.float64)
    hull, wheels = _boxes(outline)
    room = _room(
        pivots, axle.yaw_rad, hull, wheels, grid.height_cm, grid.clearance_dm, origin_m, grid.cell_m
    )
    reachable = _reachable(shifts_m, room[:, 0] > 0.0)
    left_rad = error_rad % math.tau
    whole, part = [], []
    for index in reachable:
        shift_m = float(shifts_m[index])
        _, to_left_rad, to_right_rad = room[index].tolist()
        for asked_rad, free_rad, side in (
            (left_rad, to_left_rad, 1.0),
            (math.tau - left_rad, to_right_rad, -1.0),
        ):
            cost = _CREEP_COST_RAD * abs(shift_m)
            if free_rad >= asked_rad - 0.05:
                whole.append((cost + 0.2 * asked_rad, shift_m, side * asked_rad))
            elif abs(shift_m) < _ELSEWHERE_M and side * tried < 0.0:
                continue
            elif side * error_rad > 0.0 and free_rad > _NO_TURN_RAD:
                part.append((cost + asked_rad - free_rad, shift_m, side * free_rad))
    if not whole and not part:
        farthest_m = max((float(shifts_m[index]) for index in reachable), key=abs)
        if tried and farthest_m:
            return Turn(move_m=farthest_m, turn_rad=0.0)
        return Turn(move_m=0.0, turn_rad=error_rad)
    _, move_m, turn_rad = min(whole or part)
    return Turn(move_m=move_m, turn_rad=turn_rad, whole=bool(whole))


class Turning:
    """A turn under way."""

    def __init__(self, turn: Turn, axle: Axle, time_s: float) -> None:
        self._turn = turn
        self._from = axle
        self._end_s = time_s + LONGEST_S
        self._moving = turn.move_m != 0.0
        self._left_rad = turn.turn_rad
        self._yaw_rad, self._at = axle.yaw_rad, (axle.x_m, axle.y_m)

    @property
    def turns(self) -> bool:
        """Whether it is a turn at all, and not only a way out of where the chair hangs."""
        return self._turn.turn_rad != 0.0

    def tried(self, axle: Axle) -> float:
        """The side to which the chair has turned as far as it can near this place, 0 for neither; see `plan_turn`."""
        away_m = math.hypot(axle.x_m - self._at[0], axle.y_m - self._at[1])
        return (
            0.0
            if self._turn.whole or away_m > _ELSEWHERE_M
            else math.copysign(1.0, self._turn.turn_rad)
        )

    def next(self, axle: Axle, time_s: float) -> tuple[float, float] | None:
        """How far to go on along the heading (m), and to turn (rad): one of them is 0. None when the turn is over."""
        self._left_rad -= math.remainder(axle.yaw_rad - self._yaw_rad, math.tau)
        self._yaw_rad, self._at = axle.yaw_rad, (axle.x_m, axle.y_m)
        if time_s > self._end_s:
            return None
        if self._moving:
            cos, sin = math.cos(self._from.yaw_rad), math.sin(self._from.yaw_rad)
            gone_m = (axle.x_m - self._from.x_m) * cos + (axle.y_m - self._from.y_m) * sin
            to_go_m = self._turn.move_m - gone_m
            if to_go_m * self._turn.move_m > 0.0 and abs(to_go_m) > _DONE_M:
                return to_go_m, 0.0
            self._moving = False
            self._end_s = time_s + LONGEST_S
        over = self._left_rad * self._turn.turn_rad <= 0.0 or abs(self._left_rad) < _DONE_RAD
        return None if over else (0.0, self._left_rad)


def _boxes(outline: Outline) -> tuple[F64, F64]:
    """(3,) rear, front and half width from the drive axle: of all of the chair, and of its wheels."""
    rear_m, front_m = (
        outline.middle_x_m - 0.5 * outline.length_m,
        outline.middle_x_m + 0.5 * outline.length_m,
    )
    side_m = 0.5 * outline.width_m
    return np.array([rear_m, front_m, side_m]), np.array(
        [rear_m + _WHEELS_IN_M, front_m - _WHEELS_IN_M, side_m]
    )


def _shifts(backwards: bool) -> F64:
    ahead_m = STEP_M * np.arange(1, round(FARTHEST_M / STEP_M) + 1)
    return (
        np.concatenate([[0.0], ahead_m, -ahead_m])
        if backwards
        else np.concatenate([[0.0], ahead_m])
    )


def _reachable(shifts_m: F64, stands: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> list[int]:
    """Indices of the places that a chair gets to without touching anything that it does not touch already."""
    found = [0]
    for side in (1.0, -1.0):
        free = bool(stands[0])
        for index in np.flatnonzero(side * shifts_m > 0.0).tolist():
            if free and not stands[index]:
                break
            free = free or bool(stands[index])
            if free:
                found.append(index)
    return found


@exact_kernel
def _room(
    pivots: F64,
    yaw_rad: float,
    hull: F64,
    wheels: F64,
    height_cm: U8,
    clearance_dm: U8,
    origin_m: F64,
    cell_m: float,
) -> F64:
    """For each pivot (K, 2): whether the chair fits there (1 or 0), and how far it can turn left and right (rad)."""
    found = np.zeros((len(pivots), 3))
    walls_m, drops_m = np.empty(RAYS), np.empty(RAYS)
    for k in range(len(pivots)):
        _look_round(pivots[k], height_cm, clearance_dm, origin_m, cell_m, walls_m, drops_m)
        if not _fits(yaw_rad, hull, wheels, walls_m, drops_m):
            continue
        found[k, 0] = 1.0
        for side in range(2):
            step_rad = (1.0 - 2.0 * side) * math.tau / RAYS
            steps = 0
            while steps < RAYS and _fits(
                yaw_rad + (steps + 1) * step_rad, hull, wheels, walls_m, drops_m
            ):
                steps += 1
            found[k, 1 + side] = steps * abs(step_rad)
    return found


@exact_kernel
def _look_round(
    pivot: F64,
    height_cm: U8,
    clearance_dm: U8,
    origin_m: F64,
    cell_m: float,
    walls_m: F64,
    drops_m: F64,
) -> None:
    """Distance from a pivot to the first wall or rise, and to the first fall, in each direction."""
    rows, cols = height_cm.shape
    for ray in range(RAYS):
        cos, sin = math.cos(ray * math.tau / RAYS), math.sin(ray * math.tau / RAYS)
        walls_m[ray] = drops_m[ray] = np.inf
        before_cm = -1
        for step in range(RAY_STEPS):
            x, y = pivot[0] + step * RAY_STEP_M * cos, pivot[1] + step * RAY_STEP_M * sin
            col = min(max(math.floor((x - origin_m[0]) / cell_m), 0), cols - 1)
            row = min(max(math.floor((y - origin_m[1]) / cell_m), 0), rows - 1)
            here_cm = int(height_cm[row, col])
            if clearance_dm[row, col] == 0 or (
                before_cm >= 0 and here_cm > before_cm + KERB_STEP_CM
            ):
                walls_m[ray] = step * RAY_STEP_M
                break
            if here_cm < before_cm - KERB_STEP_CM and drops_m[ray] == np.inf:
                drops_m[ray] = step * RAY_STEP_M
            before_cm = here_cm


@exact_kernel
def _fits(yaw_rad: float, hull: F64, wheels: F64, walls_m: F64, drops_m: F64) -> bool:
    for ray in range(RAYS):
        angle = ray * math.tau / RAYS - yaw_rad
        cos, sin = math.cos(angle), math.sin(angle)
        if (
            walls_m[ray] < _reach(cos, sin, hull) + MARGIN_M
            or drops_m[ray] < _reach(cos, sin, wheels) + MARGIN_M
        ):
            return False
    return True


@exact_kernel
def _reach(cos: float, sin: float, box_m: F64) -> float:
    """How far a rectangle (rear, front, half width) reaches from the axle in a direction."""
    long = box_m[1] / cos if cos > 1e-9 else (box_m[0] / cos if cos < -1e-9 else np.inf)
    wide = box_m[2] / abs(sin) if abs(sin) > 1e-9 else np.inf
    return float(min(long, wide))
