"""The oracle's kernel: where a chair goes when a command is held for half a second and then the stick let go.

Plain arrays in and out, compiled by numba. The chair is kinematic, with the drive's limits of speed, acceleration, jerk
and turn rate; the street is the raster of `StreetGrid`; others drive straight on, but for people.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from wcsim.core.boxes import boxes_touch, gap_to_box
from wcsim.core.constants import GRAVITY_MPS2, KERB_STEP_CM
from wcsim.core.frames import rad
from wcsim.core.jit import exact_kernel
from wcsim.core.joystick import ACCEL, DECEL, JERK, V_MAX, YAW_ACCEL, YAW_MAX, driven
from wcsim.supervisor.walkers import (
    HALF_L,
    HALF_W,
    MIDDLE,
    near_people,
    person_gap,
    runs_into_any_way,
    runs_into_going_on,
    set_people_margins,
)
from wcsim.types import F64, I64, U8, Bool
from wcsim.types.street import AT_EDGE

HOLD_S = 0.5
STEP_S = 0.05
LONGEST_S = 4.0  # of a roll-out, unless its chair brakes so softly that it rolls on for longer,
_LATE_S = 0.5  # with so much to spare,
SOFTEST_S = 60.0  # and never longer than this

DEEPENING_M = 0.03  # who touches may move, if hardly closer
SAME_M = 1e-6  # a difference that is none
CORNER_M = 0.06  # radius of a disc in each corner of the hull: inside a solid thing the raster knows no depth
ACTOR_MARGIN_M = 0.05
LEAN_LIMIT = math.tan(
    rad(20.0)
)  # Table 1's maximum of the roll, below the 27 deg at which the plant tips
PITCH_LIMIT = math.tan(rad(30.0))

# columns of the actors' table (n, 9); the last is the margin, set at the start of a roll-out
AX, AY, ACOS, ASIN, AHALF_L, AHALF_W, AVX, AVY, AMARGIN = range(9)
BUMP_MPS = 0.7  # a slower wheel is stopped by a kerb
CELL_CM = 8  # from the middle of a cell to its corner, with the rounding of distances
ASKEW_CM = 8  # who climbs with one side alone gets no higher than this
TYRE_CM = 2  # a tyre is wide, and rolls over an edge before it falls: it stands until so far beyond
AROUND_CM = (
    16  # from the middle of a cell to a corner of the next one, with the rounding of distances
)
CREEPS_MPS = 0.02  # who is slower stands: its casters trail
SLOPES_CM = 4  # and so much more a rim may rise against the plane of the wheels, on a ramp
BEYOND_M = 0.1  # of the hull's corners, where a rough distance is enough
RASTER_M = (
    0.3  # more than two looks at the raster of clearances differ by beyond the way between them
)
# columns of what can meet a step up (n, 3): the place in B, and the step in centimetres that it takes
UX, UY, UTAKES_CM = range(3)


class ChairShape(NamedTuple):
    """A chair as the kernels take it."""

    hull: F64  # (3,) see the column names of `walkers`
    wheels: F64  # (W, 3) where its wheels stand, in B: the left and right drive wheel, then pairs of casters; the trail
    rims: F64  # (n, 3) what can meet a step up, see the column names above


class Land(NamedTuple):
    """The rasters of a `StreetGrid`."""

    height_cm: U8
    edge_cm: U8
    clearance_dm: U8
    frame_m: F64  # (3,) their origin in W, and the size of a cell


@exact_kernel
def roll_out(
    state: F64,
    waiting: F64,
    commands: F64,
    limits: F64,
    body: ChairShape,
    above_cm: I64,
    reach_m: float,
    land: Land,
    actors: F64,
    people: F64,
    tick_s: float,
) -> F64:
    """Seconds until each command goes wrong, infinity when it ends well.

    Args:
        state: (6,) x, y, yaw, v, w of the drive axle, and the acceleration that its drive gives.
        waiting: (M, 2) joystick positions that come before any command, for STEP_S each; shaped as these.
        commands: (K, 2) joystick positions without deadband, on the unit disc.
        limits: (8,) of the drive, see `wcsim.core.joystick`.
        body: The chair's.
        above_cm: (W,) how high above the relief its wheels are.
        reach_m: How far it may get.
        land: Around it.
        actors: (n, 9) those who drive, see the column names above; the margin column is overwritten.
        people: (m, 9) those who walk, see `people`; the margin column is overwritten.
        tick_s: How long a command lasts before another one can be given.

    Returns:
        (K,) float64.
    """
    hull = body.hull
    _set_actor_margins(state, hull, actors)
    set_people_margins(state[0], state[1], state[2], hull, people)
    start_gap = _static_gap(
        state[0], state[1], state[2], hull, land.clearance_dm, land.frame_m, BEYOND_M
    )
    # Never deeper than it is now, nor than DEEPENING_M in all: it is asked anew in every step.
    allowed_gap = min(0.0, start_gap - SAME_M, max(start_gap, 0.0) - DEEPENING_M)
    places = _trailing(state, body.wheels)
    start_cm, astray, rims = _stance(state, body, places, above_cm, reach_m, land)
    around = _circle(rims)
    stands_s = (
        len(waiting) * STEP_S
        + tick_s
        + limits[V_MAX] / limits[DECEL]
        + limits[DECEL] / limits[JERK]
    )
    near = near_people(state[0], state[1], stands_s * limits[V_MAX], stands_s, hull, people)
    first_s = np.full(len(commands), np.inf)
    for k in range(len(commands)):
        first_s[k] = _one(
            state, waiting, commands[k], limits, body, allowed_gap, rims, around, places, start_cm, astray, land,
            actors, people,
        )  # fmt: skip
        if len(near):
            first_s[k] = min(
                first_s[k], _let_go(state, waiting, commands[k], limits, hull, near, tick_s)
            )
        # It goes wrong before any command begins, so it does with every one of them.
        if first_s[k] <= len(waiting) * STEP_S:
            return np.full(len(commands), first_s[k])
    return first_s


@exact_kernel
def _stance(
    state: F64, body: ChairShape, places: F64, above_cm: I64, reach_m: float, land: Land
) -> tuple[I64, Bool, F64]:
    """Heights (W,) on which the wheels stand, which of them the raster sees elsewhere, and the rims to look under.

    Mostly a chair stands as high as anything in its reach: then no rim has to be looked under.
    """
    x, y, cos, sin = state[0], state[1], math.cos(state[2]), math.sin(state[2])
    wheels, height_cm, edge_cm, frame_m = body.wheels, land.height_cm, land.edge_cm, land.frame_m
    start_cm, astray = np.empty(len(wheels), np.int64), np.empty(len(wheels), np.bool_)
    for j in range(len(wheels)):
        start_cm[j] = _height_cm(places[j, 0], places[j, 1], TYRE_CM, height_cm, edge_cm, frame_m)
        # A wheel that has left an edge hangs above the ground beside it, and its fall has begun.
        astray[j] = start_cm[j] - above_cm[j] > KERB_STEP_CM
        if abs(above_cm[j] - start_cm[j]) > KERB_STEP_CM:
            start_cm[j] = above_cm[j]
    row, col = _cell(x, y, height_cm.shape, frame_m)
    reach = int(reach_m / frame_m[2]) + 1
    near_cm = height_cm[
        max(0, row - reach) : row + reach + 1, max(0, col - reach) : col + reach + 1
    ]
    highest_cm = int(near_cm.max()) - start_cm.min() + SLOPES_CM
    rims = body.rims[body.rims[:, UTAKES_CM] < highest_cm]
    for i in range(len(rims)):
        # Never higher up a step than it is now: a footplate that stands over one may leave.
        now_cm = _rise_cm(x, y, cos, sin, wheels, start_cm, rims[i], height_cm, edge_cm, frame_m)
        rims[i, UTAKES_CM] = max(rims[i, UTAKES_CM], now_cm)
    return start_cm, astray, rims


@exact_kernel
def rolls_s(limits: F64) -> float:
    """Seconds that a command is held and the chair then takes to stand, at most; of a drive's limits (8,)."""
    straight_s = limits[V_MAX] / limits[DECEL] + (limits[ACCEL] + limits[DECEL]) / limits[JERK]
    return float(min(SOFTEST_S, HOLD_S + max(straight_s, limits[YAW_MAX] / limits[YAW_ACCEL])))


@exact_kernel
def _most_steps(limits: F64) -> int:
    """Of a roll-out, after the waiting commands."""
    return int(max(LONGEST_S, rolls_s(limits) + _LATE_S) / STEP_S)


@exact_kernel
def free_distance(state: F64, hull: F64, land: Land, actors: F64, people: F64) -> float:
    """Distance in metres from the chair's footprint to the nearest solid thing or actor, 0 when they touch."""
    nearest = _static_gap(
        state[0], state[1], state[2], hull, land.clearance_dm, land.frame_m, np.inf
    )
    cos, sin = math.cos(state[2]), math.sin(state[2])
    cx, cy = state[0] + hull[MIDDLE] * cos, state[1] + hull[MIDDLE] * sin
    for i in range(len(actors)):
        other = actors[i]
        if _overlap(cx, cy, cos, sin, hull, other[AX], other[AY], other, 0.0):
            return 0.0
        # Of two rectangles that do not overlap one has a corner at the nearest place: both are tried.
        gap = min(
            _corners_to_box(
                cx, cy, cos, sin, hull[HALF_L], hull[HALF_W],
                other[AX], other[AY], other[ACOS], other[ASIN], other[AHALF_L], other[AHALF_W],
            ),
            _corners_to_box(
                other[AX], other[AY], other[ACOS], other[ASIN], other[AHALF_L], other[AHALF_W],
                cx, cy, cos, sin, hull[HALF_L], hull[HALF_W],
            ),
        )  # fmt: skip
        nearest = min(nearest, gap)
    for i in range(len(people)):
        nearest = min(nearest, person_gap(state[0], state[1], state[2], hull, people[i]))
    return max(0.0, nearest)


@exact_kernel
def _one(
    state: F64,
    waiting: F64,
    command: F64,
    limits: F64,
    body: ChairShape,
    allowed_gap: float,
    rims: F64,
    around: tuple[float, float, float],
    places: F64,
    start_cm: I64,
    astray: Bool,
    land: Land,
    actors: F64,
    people: F64,
) -> float:
    # Unpacked once: a tuple of arrays that is handed on costs more than what is done with it.
    hull, wheels, height_cm, edge_cm, frame_m = (
        body.hull,
        body.wheels,
        land.height_cm,
        land.edge_cm,
        land.frame_m,
    )
    x, y, yaw, v, w, a = state[0], state[1], state[2], state[3], state[4], state[5]
    before, before2, now = start_cm.copy(), start_cm.copy(), start_cm.copy()
    aside, at = astray.copy(), places.copy()
    gap_m, furthest_m = 0.0, abs(hull[MIDDLE]) + hull[HALF_L]
    sticks, held = _sticks(waiting, command, HOLD_S, limits)
    for i in range(len(sticks)):
        if i >= held and v == 0.0 and abs(w) < 1e-3:
            break
        v_before = abs(v)
        x, y, yaw, v, w, a = _moved(x, y, yaw, v, w, a, sticks[i], limits)
        # Solid things come no nearer than by the way: until they may touch, the raster is not asked.
        gap_m -= (max(v_before, abs(v)) + abs(w) * furthest_m) * STEP_S
        if gap_m < RASTER_M:
            gap_m = _static_gap(x, y, yaw, hull, land.clearance_dm, frame_m, BEYOND_M)
        later_s = (i + 1) * STEP_S
        cos, sin = math.cos(yaw), math.sin(yaw)
        falls, stops = False, False
        for j in range(len(wheels)):
            ahead_m, trail_m = wheels[j, 0] + wheels[j, 2], wheels[j, 2]
            px, py = x + ahead_m * cos - wheels[j, 1] * sin, y + ahead_m * sin + wheels[j, 1] * cos
            if trail_m > 0.0:
                # A caster is drawn after its swivel.
                dx, dy = at[j, 0] - px, at[j, 1] - py
                share = trail_m / max(math.sqrt(dx * dx + dy * dy), SAME_M)
                px, py = px + share * dx, py + share * dy
                at[j, 0], at[j, 1] = px, py
            # As in `_height_cm`, written out: that is not inlined here, and such a call costs more than the look.
            row, col = _cell(px, py, height_cm.shape, frame_m)
            now[j] = height_cm[row, col]
            if abs(int(edge_cm[row, col]) - AT_EDGE) <= CELL_CM + TYRE_CM:
                now[j] = _height_beside_edge_cm(px, py, TYRE_CM, height_cm, edge_cm, frame_m)
            # Where it cannot stand it does not: a caster that has swung round at a kerb.
            if now[j] - start_cm[j] > KERB_STEP_CM and aside[j]:
                now[j] = start_cm[j]
            else:
                aside[j] = False
            # Down a step, or fast up one, within two samples, so that a raster's soft edge counts.
            up = now[j] - min(before[j], before2[j])
            stops |= up > ASKEW_CM
            falls |= max(before[j], before2[j]) - now[j] > KERB_STEP_CM or (
                up > KERB_STEP_CM and abs(v) > BUMP_MPS
            )
        # In a turn the chair leans as on a slope of v w / g.
        lean = 0.01 * (now[0] - now[1]) / (wheels[0, 1] - wheels[1, 1]) + v * w / GRAVITY_MPS2
        pitch = 0.01 * 0.5 * (now[2] + now[3] - now[0] - now[1]) / (wheels[2, 0] - wheels[0, 0])
        for j in range(0, len(wheels), 2):
            # Who climbs a flank with one side slides off it.
            falls |= not stops and abs(now[j] - now[j + 1]) > max(
                ASKEW_CM, abs(start_cm[j] - start_cm[j + 1])
            )
        if (
            falls
            or abs(lean) > LEAN_LIMIT
            or abs(pitch) > PITCH_LIMIT
            or _bumps(x, y, cos, sin, wheels, now, rims, around, height_cm, edge_cm, frame_m)
            or gap_m < allowed_gap
            or _touches(x, y, cos, sin, hull, later_s, actors)
            or runs_into_going_on(x, y, yaw, v, w, hull, later_s, people)
        ):
            return later_s
        # A step that a slow wheel cannot climb ends the drive.
        if stops:
            break
        before2[:] = before
        before[:] = now
    return np.inf


@exact_kernel
def _let_go(
    state: F64, waiting: F64, command: F64, limits: F64, hull: F64, people: F64, tick_s: float
) -> float:
    """Seconds until the chair runs into somebody, whatever they do, when a command lasts one tick; or infinity."""
    x, y, yaw, v, w, a = state[0], state[1], state[2], state[3], state[4], state[5]
    sticks, held = _sticks(waiting, command, tick_s, limits)
    for i in range(len(sticks)):
        if i >= held and v == 0.0 and abs(w) < 1e-3:
            break
        x, y, yaw, v, w, a = _moved(x, y, yaw, v, w, a, sticks[i], limits)
        if runs_into_any_way(x, y, yaw, v, w, hull, (i + 1) * STEP_S, people):
            return (i + 1) * STEP_S
    return np.inf


@exact_kernel
def _sticks(waiting: F64, command: F64, held_s: float, limits: F64) -> tuple[F64, int]:
    """Joystick positions (n, 2) of a roll-out's steps, and the step at which the stick is let go."""
    # A hair less: rounding of the quotient must not add a step.
    waits, held = len(waiting), len(waiting) + math.ceil(held_s / STEP_S - 1e-6)
    sticks = np.zeros((waits + _most_steps(limits), 2))
    sticks[:waits] = waiting
    sticks[waits:held] = command
    return sticks, held


@exact_kernel
def _moved(
    x: float, y: float, yaw: float, v: float, w: float, a: float, stick: F64, limits: F64
) -> tuple[float, float, float, float, float, float]:
    """Pose, speeds and acceleration a step later."""
    v_before, yaw_before = v, yaw
    v, w, a = driven(v, w, a, stick[0], stick[1], limits, STEP_S)
    yaw += w * STEP_S
    # Mean speed along the mean heading: with those of one end the way would err by the first order of the step.
    way = 0.5 * (v_before + v) * STEP_S
    x += way * math.cos(0.5 * (yaw_before + yaw))
    y += way * math.sin(0.5 * (yaw_before + yaw))
    return x, y, yaw, v, w, a


@exact_kernel
def _bumps(
    x: float,
    y: float,
    cos: float,
    sin: float,
    wheels: F64,
    now: I64,
    rims: F64,
    around: tuple[float, float, float],
    height_cm: U8,
    edge_cm: U8,
    frame_m: F64,
) -> bool:
    """Whether one of `rims` meets a step of the ground that it does not take."""
    # Only a kerb that cuts the circle around them, or the cells beside it, is one to them.
    cx, cy, radius_m = around
    row, col = _cell(x + cx * cos - cy * sin, y + cx * sin + cy * cos, edge_cm.shape, frame_m)
    if abs(int(edge_cm[row, col]) - AT_EDGE) > 100.0 * radius_m + AROUND_CM:
        return False
    for i in range(len(rims)):
        rise_cm = _rise_cm(x, y, cos, sin, wheels, now, rims[i], height_cm, edge_cm, frame_m)
        if rise_cm > rims[i, UTAKES_CM]:
            return True
    return False


@exact_kernel
def _rise_cm(
    x: float,
    y: float,
    cos: float,
    sin: float,
    wheels: F64,
    now: I64,
    rim: F64,
    height_cm: U8,
    edge_cm: U8,
    frame_m: F64,
) -> float:
    """By how much the ground at a rim lies above the plane on which the wheels stand (W,)."""
    px, py = x + rim[UX] * cos - rim[UY] * sin, y + rim[UX] * sin + rim[UY] * cos
    axle_cm = 0.5 * (now[0] + now[1])
    ahead_cm = (0.5 * (now[2] + now[3]) - axle_cm) * rim[UX] / wheels[2, 0]
    return float(_height_cm(px, py, 0, height_cm, edge_cm, frame_m) - axle_cm - ahead_cm)


@exact_kernel
def _circle(places: F64) -> tuple[float, float, float]:
    """One around places (n, 2 or more) in B: its middle, and its radius in metres; none for no places."""
    if not len(places):
        return 0.0, 0.0, 0.0
    x, y = (
        0.5 * (places[:, 0].min() + places[:, 0].max()),
        0.5 * (places[:, 1].min() + places[:, 1].max()),
    )
    return x, y, np.sqrt((places[:, 0] - x) ** 2 + (places[:, 1] - y) ** 2).max()


@exact_kernel
def _cell(x: float, y: float, shape: tuple[int, int], frame_m: F64) -> tuple[int, int]:
    """Row and column of a place; of one outside those of the nearest cell."""
    row, col = math.floor((y - frame_m[1]) / frame_m[2]), math.floor((x - frame_m[0]) / frame_m[2])
    return min(max(row, 0), shape[0] - 1), min(max(col, 0), shape[1] - 1)


@exact_kernel
def _height_cm(
    x: float, y: float, carried_cm: int, height_cm: U8, edge_cm: U8, frame_m: F64
) -> int:
    """Of the ground that carries what is there, up to so far beyond an edge.

    Not interpolated: between two cells a kerb would become a ramp.
    """
    row, col = _cell(x, y, height_cm.shape, frame_m)
    if abs(int(edge_cm[row, col]) - AT_EDGE) > CELL_CM + carried_cm:
        return int(height_cm[row, col])
    return _height_beside_edge_cm(x, y, carried_cm, height_cm, edge_cm, frame_m)


@exact_kernel
def _height_beside_edge_cm(
    x: float, y: float, carried_cm: int, height_cm: U8, edge_cm: U8, frame_m: F64
) -> int:
    """Of the ground in a cell that a kerb cuts: as in the nearest middle of a cell on the same side."""
    rows, cols = height_cm.shape
    row, col = (y - frame_m[1]) / frame_m[2] - 0.5, (x - frame_m[0]) / frame_m[2] - 0.5
    c0, r0 = min(max(math.floor(col), 0), cols - 2), min(max(math.floor(row), 0), rows - 2)
    fc, fr = min(max(col - c0, 0.0), 1.0), min(max(row - r0, 0.0), 1.0)
    shares = ((1.0 - fr) * (1.0 - fc), (1.0 - fr) * fc, fr * (1.0 - fc), fr * fc)
    # The side is told by the distance, which has a sign, between the four middles around.
    side = float(carried_cm)
    for k in range(4):
        side += shares[k] * (edge_cm[r0 + k // 2, c0 + k % 2] - AT_EDGE + 0.5)
    best, found = -1.0, int(height_cm[r0 + round(fr), c0 + round(fc)])
    for k in range(4):
        r, c = r0 + k // 2, c0 + k % 2
        if shares[k] > best and (edge_cm[r, c] >= AT_EDGE) == (side >= 0.0):
            best, found = shares[k], int(height_cm[r, c])
    return found


@exact_kernel
def _touches(
    x: float, y: float, cos: float, sin: float, hull: F64, later_s: float, actors: F64
) -> bool:
    cx, cy = x + hull[MIDDLE] * cos, y + hull[MIDDLE] * sin
    for i in range(len(actors)):
        other = actors[i]
        ox, oy = other[AX] + later_s * other[AVX], other[AY] + later_s * other[AVY]
        if _overlap(cx, cy, cos, sin, hull, ox, oy, other, other[AMARGIN]):
            return True
    return False


@exact_kernel
def _set_actor_margins(state: F64, hull: F64, actors: F64) -> None:
    """Others get a small margin, except those who stand within it already: they would forbid every move."""
    cos, sin = math.cos(state[2]), math.sin(state[2])
    cx, cy = state[0] + hull[MIDDLE] * cos, state[1] + hull[MIDDLE] * sin
    for i in range(len(actors)):
        other = actors[i]
        near = _overlap(cx, cy, cos, sin, hull, other[AX], other[AY], other, ACTOR_MARGIN_M)
        other[AMARGIN] = 0.0 if near else ACTOR_MARGIN_M


@exact_kernel
def _static_gap(
    x: float, y: float, yaw: float, hull: F64, clearance_dm: U8, frame_m: F64, beyond_m: float
) -> float:
    """Distance from the footprint to the nearest solid thing, negative inside it; a rough one further than `beyond_m`.

    Three discs as wide as the chair, and a small one in each corner, stand for the rectangle.
    """
    cos, sin = math.cos(yaw), math.sin(yaw)
    cx, cy = x + hull[MIDDLE] * cos, y + hull[MIDDLE] * sin
    middle = _clearance(cx, cy, clearance_dm, frame_m)
    corner = math.sqrt(hull[HALF_L] ** 2 + hull[HALF_W] ** 2)
    # A lower bound is enough where all is far: one look at the raster instead of eight.
    if middle > corner + beyond_m:
        return middle - corner
    gap = np.inf
    for i in range(-1, 2):
        ahead = i * max(0.0, hull[HALF_L] - hull[HALF_W])
        gap = min(
            gap,
            _clearance(cx + ahead * cos, cy + ahead * sin, clearance_dm, frame_m) - hull[HALF_W],
        )
    for i in range(4):
        ahead = (hull[HALF_L] - CORNER_M) * (1.0 if i < 2 else -1.0)
        left = (hull[HALF_W] - CORNER_M) * (1.0 if i % 2 == 0 else -1.0)
        px, py = cx + ahead * cos - left * sin, cy + ahead * sin + left * cos
        gap = min(gap, _clearance(px, py, clearance_dm, frame_m) - CORNER_M)
    return gap


@exact_kernel
def _clearance(x: float, y: float, clearance_dm: U8, frame_m: F64) -> float:
    """The raster between its cell centres, in metres."""
    col = (x - frame_m[0]) / frame_m[2] - 0.5
    row = (y - frame_m[1]) / frame_m[2] - 0.5
    rows, cols = clearance_dm.shape
    # Interpolated: whole decimetres would make the gap jump while the chair creeps.
    c0 = min(max(math.floor(col), 0), cols - 2)
    r0 = min(max(math.floor(row), 0), rows - 2)
    fc = min(max(col - c0, 0.0), 1.0)
    fr = min(max(row - r0, 0.0), 1.0)
    low = (1.0 - fc) * clearance_dm[r0, c0] + fc * clearance_dm[r0, c0 + 1]
    high = (1.0 - fc) * clearance_dm[r0 + 1, c0] + fc * clearance_dm[r0 + 1, c0 + 1]
    return float(0.0 + 0.1 * ((1.0 - fr) * low + fr * high))


@exact_kernel
def _trailing(state: F64, wheels: F64) -> F64:
    """Places (W, 2) in W where the wheels of a chair stand: casters behind the way of their swivels."""
    x, y, cos, sin, v, w = (
        state[0],
        state[1],
        math.cos(state[2]),
        math.sin(state[2]),
        state[3],
        state[4],
    )
    at = np.empty((len(wheels), 2))
    for j in range(len(wheels)):
        swivel_m, left_m, trail_m = wheels[j, 0] + wheels[j, 2], wheels[j, 1], wheels[j, 2]
        # Of a chair that stands they are behind, too.
        ahead, left = v + CREEPS_MPS - w * left_m, w * swivel_m
        share = trail_m / max(math.sqrt(ahead**2 + left**2), SAME_M)
        px, py = swivel_m - share * ahead, left_m - share * left
        at[j, 0], at[j, 1] = x + px * cos - py * sin, y + px * sin + py * cos
    return at


@exact_kernel
def _overlap(
    cx: float,
    cy: float,
    cos: float,
    sin: float,
    hull: F64,
    ox: float,
    oy: float,
    other: F64,
    margin: float,
) -> bool:
    """Whether the chair's rectangle meets another one (separating axes), the other one grown by `margin`."""
    half_l, half_w = other[AHALF_L] + margin, other[AHALF_W] + margin
    return boxes_touch(
        cx,
        cy,
        cos,
        sin,
        hull[HALF_L],
        hull[HALF_W],
        ox,
        oy,
        other[ACOS],
        other[ASIN],
        half_l,
        half_w,
    )


@exact_kernel
def _corners_to_box(
    ax: float, ay: float, acos: float, asin: float, al: float, aw: float,
    bx: float, by: float, bcos: float, bsin: float, bl: float, bw: float,
) -> float:  # fmt: skip
    """The least distance from the corners of rectangle a to rectangle b."""
    least = np.inf
    for i in range(4):
        sl = al if i < 2 else -al
        sw = aw if i % 2 == 0 else -aw
        x, y = ax + sl * acos - sw * asin, ay + sl * asin + sw * acos
        least = min(least, max(0.0, gap_to_box(x, y, bx, by, bcos, bsin, bl, bw)))
    return least
