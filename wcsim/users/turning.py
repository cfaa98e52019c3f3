"""Turning in place beside kerbs and walls: where there is room, and how to get to such a place.

A chair turns about its drive axle, and its front swings out. No part of it may touch walls and
kerbs that rise. Over kerbs that fall it may lean, as long as its wheels stay up.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.core.constants import KERB_STEP_CM
from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F64, U8, Bool, Ground, Outline

_STEP_M: Final = 0.2
_FARTHEST_M: Final = 2.4
_MARGIN_M: Final = 0.05
_RAYS: Final = 72
_RAY_STEP_M: Final = 0.05
_RAY_STEPS: Final = 19
_CREEP_COST_RAD: Final = 0.35  # creeping on for one metre is worth turning this much less
_TURN_COST: Final = 0.2
_NO_TURN_RAD: Final = 0.25  # less than this is not worth the trouble
_LACKING_RAD: Final = 0.05  # room that lacks no more than this is enough
_DONE_RAD: Final = 0.2
_DONE_M: Final = 0.06
_LONGEST_S: Final = 8.0  # a chair that is not there by then plans anew
_ELSEWHERE_M: Final = 0.35  # so far away a turn that was not possible may be
# Wheels and casters stand so much inside the chair's ends, and as wide as its sides.
_WHEELS_IN_M: Final = 0.22


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnPlan:
    """What to do to face another way."""

    move_m: float  # first along the heading, negative is backwards
    turn_rad: float  # then in place, left positive
    complete: bool = True  # all of the requested turn; else as far as there is room


@dataclass(frozen=True, slots=True, kw_only=True)
class AxlePose:
    """The chair as it turns: its drive axle in W."""

    x_m: float
    y_m: float
    yaw_rad: float


def plan_turn(
    ground: Ground,
    outline: Outline,
    axle: AxlePose,
    error_rad: float,
    backwards: bool = True,
    tried: float = 0.0,
) -> TurnPlan:
    """How to turn by `error_rad` (left positive): where there is room, and to the side that has it.

    Args:
        ground: The street from above.
        outline: The chair's box.
        axle: Where the chair stands.
        error_rad: The requested turn, within -pi..pi.
        backwards: Whether the driver can reverse.
        tried: The side (left positive) to which the chair has just turned here as far as it can, 0
            for neither: turning back again would never end.

    Returns:
        The turn with the shortest way to a place with room for all of it. Without one, the place
        with room for most of it. Without any, just the turn, or, after one was tried, the way to
        the farthest place.
    """
    # 1. Measure the room at places along the heading, as far as the chair gets to them.
    ahead_m = _STEP_M * np.arange(1, round(_FARTHEST_M / _STEP_M) + 1)
    shifts_m: F64 = np.concatenate([[0.0], ahead_m, -ahead_m] if backwards else [[0.0], ahead_m])
    heading = np.array([math.cos(axle.yaw_rad), math.sin(axle.yaw_rad)])
    pivots = np.array([axle.x_m, axle.y_m]) + shifts_m[:, None] * heading
    grid = ground.around(pivots[0])
    rear_m = outline.middle_x_m - 0.5 * outline.length_m
    front_m = outline.middle_x_m + 0.5 * outline.length_m
    side_m = 0.5 * outline.width_m
    room = _measure_room(
        pivots,
        axle.yaw_rad,
        np.array([rear_m, front_m, side_m]),
        np.array([rear_m + _WHEELS_IN_M, front_m - _WHEELS_IN_M, side_m]),
        grid.height_cm,
        grid.clearance_dm,
        np.array(grid.origin_W_m, np.float64),
        grid.cell_m,
    )
    reachable = _reachable(shifts_m, room[:, 0] > 0.0)

    # 2. Collect (cost, shift, turn) of complete turns and of partial ones, to both sides.
    left_rad = error_rad % math.tau
    complete, partial = [], []
    for index in reachable:
        shift_m = float(shifts_m[index])
        cost = _CREEP_COST_RAD * abs(shift_m)
        _, free_left_rad, free_right_rad = room[index].tolist()
        for side, needed_rad, free_rad in (
            (1.0, left_rad, free_left_rad),
            (-1.0, math.tau - left_rad, free_right_rad),
        ):
            if free_rad >= needed_rad - _LACKING_RAD:
                complete.append((cost + _TURN_COST * needed_rad, shift_m, side * needed_rad))
            elif abs(shift_m) < _ELSEWHERE_M and side * tried < 0.0:
                continue
            elif side * error_rad > 0.0 and free_rad > _NO_TURN_RAD:
                partial.append((cost + needed_rad - free_rad, shift_m, side * free_rad))

    # 3. Choose the cheapest.
    if complete or partial:
        _, move_m, turn_rad = min(complete or partial)
        return TurnPlan(move_m=move_m, turn_rad=turn_rad, complete=bool(complete))
    farthest_m = max((float(shifts_m[index]) for index in reachable), key=abs)
    if tried and farthest_m:
        return TurnPlan(move_m=farthest_m, turn_rad=0.0)
    return TurnPlan(move_m=0.0, turn_rad=error_rad)


class ActiveTurn:
    """A turn under way."""

    def __init__(self, plan: TurnPlan, axle: AxlePose, time_s: float) -> None:
        self._plan = plan
        self._start = axle
        self._last = axle
        self._end_s = time_s + _LONGEST_S
        self._is_moving = plan.move_m != 0.0
        self._left_rad = plan.turn_rad

    @property
    def turns(self) -> bool:
        """Whether it is a turn at all, and not only a way out of where the chair hangs."""
        return self._plan.turn_rad != 0.0

    def tried_side(self, axle: AxlePose) -> float:
        """The side to which the chair has turned as far as it can near this place, 0 for neither.

        See `plan_turn`.
        """
        away_m = math.hypot(axle.x_m - self._last.x_m, axle.y_m - self._last.y_m)
        if self._plan.complete or away_m > _ELSEWHERE_M:
            return 0.0
        return math.copysign(1.0, self._plan.turn_rad)

    def advance(self, axle: AxlePose, time_s: float) -> tuple[float, float] | None:
        """How far to go on along the heading (m) and to turn (rad), from where the axle is now.

        One of them is 0. None when the turn is over.
        """
        self._left_rad -= math.remainder(axle.yaw_rad - self._last.yaw_rad, math.tau)
        self._last = axle
        if time_s > self._end_s:
            return None
        if self._is_moving:
            cos, sin = math.cos(self._start.yaw_rad), math.sin(self._start.yaw_rad)
            driven_m = (axle.x_m - self._start.x_m) * cos + (axle.y_m - self._start.y_m) * sin
            to_go_m = self._plan.move_m - driven_m
            if to_go_m * self._plan.move_m > 0.0 and abs(to_go_m) > _DONE_M:
                return to_go_m, 0.0
            self._is_moving = False
            self._end_s = time_s + _LONGEST_S
        is_over = self._left_rad * self._plan.turn_rad <= 0.0 or abs(self._left_rad) < _DONE_RAD
        return None if is_over else (0.0, self._left_rad)


def _reachable(shifts_m: F64, fits: Bool) -> list[int]:
    """Indices of the places that a chair gets to without touching more than it does already."""
    found = [0]
    for side in (1.0, -1.0):
        free = bool(fits[0])
        for index in np.flatnonzero(side * shifts_m > 0.0).tolist():
            if free and not fits[index]:
                break
            free = free or bool(fits[index])
            if free:
                found.append(index)
    return found


@compile_exact_kernel
def _measure_room(
    pivots: F64,
    yaw_rad: float,
    hull: F64,
    wheels: F64,
    height_cm: U8,
    clearance_dm: U8,
    origin_m: F64,
    cell_m: float,
) -> F64:
    """(K, 3) for each pivot (K, 2): whether the chair fits there (1 or 0), free rad left and right.

    `hull` and `wheels` are (3,) rear, front and half width from the drive axle: of all of the
    chair, and of its wheels.
    """
    found = np.zeros((len(pivots), 3))
    walls_m, drops_m = np.empty(_RAYS), np.empty(_RAYS)
    for k in range(len(pivots)):
        _scan_around(pivots[k], height_cm, clearance_dm, origin_m, cell_m, walls_m, drops_m)
        if not _fits(yaw_rad, hull, wheels, walls_m, drops_m):
            continue
        found[k, 0] = 1.0
        for side in range(2):
            step_rad = (1.0 - 2.0 * side) * math.tau / _RAYS
            steps = 0
            while steps < _RAYS and _fits(
                yaw_rad + (steps + 1) * step_rad, hull, wheels, walls_m, drops_m
            ):
                steps += 1
            found[k, 1 + side] = steps * abs(step_rad)
    return found


@compile_exact_kernel
def _scan_around(
    pivot: F64,
    height_cm: U8,
    clearance_dm: U8,
    origin_m: F64,
    cell_m: float,
    walls_m: F64,
    drops_m: F64,
) -> None:
    """Fill in the distance from a pivot to the first wall or rise, and first fall, by ray."""
    rows, cols = height_cm.shape
    for ray in range(_RAYS):
        cos, sin = math.cos(ray * math.tau / _RAYS), math.sin(ray * math.tau / _RAYS)
        walls_m[ray] = drops_m[ray] = np.inf
        before_cm = -1
        for step in range(_RAY_STEPS):
            x, y = pivot[0] + step * _RAY_STEP_M * cos, pivot[1] + step * _RAY_STEP_M * sin
            col = min(max(math.floor((x - origin_m[0]) / cell_m), 0), cols - 1)
            row = min(max(math.floor((y - origin_m[1]) / cell_m), 0), rows - 1)
            here_cm = int(height_cm[row, col])
            if clearance_dm[row, col] == 0 or (
                before_cm >= 0 and here_cm > before_cm + KERB_STEP_CM
            ):
                walls_m[ray] = step * _RAY_STEP_M
                break
            if here_cm < before_cm - KERB_STEP_CM and drops_m[ray] == np.inf:
                drops_m[ray] = step * _RAY_STEP_M
            before_cm = here_cm


@compile_exact_kernel
def _fits(yaw_rad: float, hull: F64, wheels: F64, walls_m: F64, drops_m: F64) -> bool:
    for ray in range(_RAYS):
        angle = ray * math.tau / _RAYS - yaw_rad
        cos, sin = math.cos(angle), math.sin(angle)
        if (
            walls_m[ray] < _reach(cos, sin, hull) + _MARGIN_M
            or drops_m[ray] < _reach(cos, sin, wheels) + _MARGIN_M
        ):
            return False
    return True


@compile_exact_kernel
def _reach(cos: float, sin: float, box_m: F64) -> float:
    """How far a rectangle (rear, front, half width) reaches from the axle in a direction."""
    along_m = across_m = np.inf
    if cos > 1e-9:
        along_m = box_m[1] / cos
    elif cos < -1e-9:
        along_m = box_m[0] / cos
    if abs(sin) > 1e-9:
        across_m = box_m[2] / abs(sin)
    return float(min(along_m, across_m))
