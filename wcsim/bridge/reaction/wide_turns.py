"""How far a long vehicle swings out of its lane's middle, so that its body stays off the pavement in a bend.

SUMO leads the front of a vehicle along the middle of its lanes and drags its rear along the same line: a bus of 12 m
cuts a corner by more than a metre. A driver takes such a bend wide. Here the line itself is moved sideways, by as
little as keeps the body over the carriageway; where it is too narrow for that, by what leaves the least of it outside.
"""

from __future__ import annotations

import math

import numpy as np

from wcsim.core.jit import exact_kernel
from wcsim.types import F64, U8, ClassId, Ground

STEP_M = 0.5  # places on the line
SIDE_STEP_M = 0.2  # offsets that are tried; from one place to the next they differ by one of these at most
MOST_M = 3.0  # the furthest that a line is moved: no further than the next lane
ALONG_M = 0.5  # the body is looked at in strips of so much, and `SIDE_STEP_M` across
MARGIN_M = 0.05  # the body is looked at as if it were wider by so much on either side
SMOOTH_M = 6.0  # the line's direction is that of a chord so far to either side
OFF_COST, FAR_COST, STEER_COST = 20.0, 0.02, 0.02  # of a square metre, of a metre squared, of a step sideways
ROUNDS = 6  # the body turns with its line, so what it covers is reckoned anew so often
LOW = (ClassId.ROAD, ClassId.CROSSWALK, ClassId.RAIL_TRACK, ClassId.PARKING, ClassId.VOID)
_IS_LOW = np.isin(np.arange(256), [int(c) for c in LOW])
_STATES = round(MOST_M / SIDE_STEP_M)


def normals(line_W_m: F64) -> F64:
    """Unit vectors (n, 2) to the left of a line of places (n, 2) that are `STEP_M` apart, without its kinks."""
    reach = min(round(SMOOTH_M / STEP_M), max(len(line_W_m) - 1, 1))
    at = np.arange(len(line_W_m))
    along = line_W_m[np.minimum(at + reach, at[-1])] - line_W_m[np.maximum(at - reach, 0)]
    along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def offsets_m(line_W_m: F64, body_m: tuple[float, float], ground: Ground, held_m: F64) -> F64:
    """How far to the left each place of a line is moved.

    Args:
        line_W_m: (n, 2) the way of the front's middle, in steps of `STEP_M`.
        body_m: Length and width of the longest rigid piece that follows it.
        ground: What it drives on.
        held_m: (k,) offsets of the first k places, which have been driven already.

    Returns:
        (n,) offsets; nothing but zeros where the body covers no pavement.
    """
    found = np.zeros(len(line_W_m))
    found[: len(held_m)] = held_m
    behind = max(1, round(body_m[0] / STEP_M))
    if len(line_W_m) <= behind + 2:
        return found
    wide_m, left = (body_m[0], body_m[1] + 2.0 * MARGIN_M), normals(line_W_m)
    if not covered_m2(line_W_m + found[:, None] * left, wide_m, ground).any():
        return found
    best, least = found, np.inf
    for _ in range(ROUNDS + 1):
        moved = line_W_m + found[:, None] * left
        off_m2 = _covered(_profiles(moved, behind, wide_m, ground, _STATES), wide_m[1])
        now = float(off_m2[:, off_m2.shape[1] // 2].sum())
        if now < least - 1e-9:
            best, least = found, now
        else:
            break
        if now == 0.0:
            break
        found = _cheapest(off_m2, found, behind // 2, len(held_m))
    return best


def covered_m2(line_W_m: F64, body_m: tuple[float, float], ground: Ground) -> F64:
    """(n - k,) how much of the body is off the carriageway, at each place of its front from its own length k on."""
    behind = max(1, round(body_m[0] / STEP_M))
    return np.asarray(_covered(_profiles(line_W_m, behind, body_m, ground, 0), body_m[1])[:, 0])


def _profiles(line_W_m: F64, behind: int, body_m: tuple[float, float], ground: Ground, aside: int) -> F64:
    """(poses, strips) square metres off the carriageway in each lengthwise strip beside the body's middle line.

    The strips make up the body's width when it is moved by up to `aside` of them to either side.
    """
    front, rear = line_W_m[behind:], line_W_m[:-behind]
    chord = front - rear
    chord /= np.maximum(np.hypot(*chord.T), 1e-9)[:, None]
    middle = front - 0.5 * body_m[0] * chord
    strips = 2 * (aside + _half_strips(body_m[1])) + 1
    found = np.zeros((len(front), strips))
    for row, (x, y), (cos, sin) in zip(found, middle.tolist(), chord.tolist(), strict=True):
        grid = ground.around(np.array((x, y)))
        _fill(row, grid.ground_class, *grid.origin_W_m, grid.cell_m, _IS_LOW, x, y, cos, sin, 0.5 * body_m[0])
    return found


@exact_kernel
def _fill(
    row: F64, classes: U8, first_x: float, first_y: float, cell_m: float, is_low: np.ndarray,
    x: float, y: float, cos: float, sin: float, half_m: float,
) -> None:  # fmt: skip
    rows, cols = classes.shape
    count = max(1, math.ceil(2.0 * half_m / ALONG_M))
    along_m = 2.0 * half_m / count
    middle = len(row) // 2
    for i in range(len(row)):
        aside = (i - middle) * SIDE_STEP_M
        for k in range(count):
            ahead = -half_m + (k + 0.5) * along_m
            col = math.floor((x + ahead * cos - aside * sin - first_x) / cell_m)
            line = math.floor((y + ahead * sin + aside * cos - first_y) / cell_m)
            if 0 <= col < cols and 0 <= line < rows and not is_low[classes[line, col]]:
                row[i] += along_m * SIDE_STEP_M


def _covered(profile: F64, width_m: float) -> F64:
    """(poses, offsets) square metres off the carriageway that the body covers when it is moved to the left by each."""
    wide = _half_strips(width_m)
    sums = np.concatenate([np.zeros((len(profile), 1)), np.cumsum(profile, axis=1)], axis=1)
    at = np.arange(profile.shape[1] - 2 * wide)
    return np.asarray(sums[:, at + 2 * wide + 1] - sums[:, at])


def _half_strips(width_m: float) -> int:
    """Strips to either side of the middle one that make up a width."""
    return math.ceil(0.5 * (width_m / SIDE_STEP_M - 1.0))


def _cheapest(off_m2: F64, now_m: F64, lag: int, held: int) -> F64:
    """The offsets with the least cost over the whole line, each one step of `SIDE_STEP_M` at most from the one before.

    `off_m2` says what the body covers when it is moved on from `now_m`; its middle is `lag` places behind its front.
    """
    states = np.arange(-_STATES, _STATES + 1)
    cost = np.tile(FAR_COST * (states * SIDE_STEP_M) ** 2, (len(now_m), 1))
    first = np.rint(now_m / SIDE_STEP_M).astype(np.int64)
    for pose, covered in enumerate(off_m2):
        place = pose + lag
        at = np.minimum(np.maximum(states - first[place] + _STATES, 0), 2 * _STATES)
        cost[place] += OFF_COST * covered[at]
    for place in range(held):
        cost[place, states != first[place]] = np.inf
    chosen = (_path(cost, held) - _STATES) * SIDE_STEP_M
    chosen[:held] = now_m[:held]
    return chosen


@exact_kernel
def _path(cost: F64, held: int) -> F64:
    """The cheapest state (n,) in each row of (n, states), from row to row the same or one beside; free when held."""
    count, states = cost.shape
    total = cost[0].copy()
    came = np.zeros((count, states), np.int8)
    for place in range(1, count):
        new = np.empty(states)
        for state in range(states):
            best, step = total[state], 0
            for side in (-1, 1):
                if 0 <= state + side < states and total[state + side] + STEER_COST < best:
                    best, step = total[state + side] + STEER_COST, side
            if place < held and best == np.inf:  # what was driven is what it was, however steep
                best = total.min()
            new[state], came[place, state] = best + cost[place, state], step
        total = new
    chosen = np.zeros(count)
    at = np.argmin(total)
    for place in range(count - 1, -1, -1):
        chosen[place] = at
        at += came[place, at]
    return chosen
