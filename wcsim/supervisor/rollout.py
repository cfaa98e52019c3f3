"""The oracle's kernels: where a chair goes when a command is held and then the stick released.

Plain arrays in and out, compiled by numba. The chair is kinematic, with the drive's limits of
speed, acceleration, jerk and turn rate; the street is the raster of `StreetGrid`. Vehicles drive
straight on; people may do otherwise, see `walkers`.

In this order: the roll-outs, the ground below the wheels, solid things, and vehicles.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from wcsim.core.boxes import boxes_touch, gap_to_box
from wcsim.core.constants import GRAVITY_MPS2, KERB_STEP_CM
from wcsim.core.frames import deg2rad
from wcsim.core.jit import compile_exact_kernel
from wcsim.core.joystick import ACCEL, DECEL, JERK, V_MAX, YAW_ACCEL, YAW_MAX, advance_drive
from wcsim.supervisor.walkers import (
    HALF_L,
    HALF_W,
    MIDDLE,
    filter_reachable_people,
    has_possible_person_collision,
    has_steady_person_collision,
    measure_gap_to_person,
    set_people_margins,
)
from wcsim.types import F64, I64, U8, Bool
from wcsim.types.street import AT_EDGE

# How long a roll-out lasts.
HOLD_S: Final = 0.5
STEP_S: Final = 0.05
LONGEST_S: Final = 4.0  # longer for a chair that brakes so softly that it rolls on,
_SPARE_S: Final = 0.5  # with so much to spare,
SOFTEST_S: Final = 60.0  # and never longer than this

# When it goes wrong.
# Table 1's maximum of the roll, below the 27 deg at which the plant tips.
LEAN_LIMIT: Final = math.tan(deg2rad(20.0))
PITCH_LIMIT: Final = math.tan(deg2rad(30.0))
BUMP_MPS: Final = 0.7  # a slower wheel is stopped by a kerb
ASKEW_CM: Final = 8  # a chair that climbs with one side alone gets no higher than this
DEEPENING_M: Final = 0.03  # a chair within a margin may move, if hardly closer
SAME_M: Final = 1e-6  # a difference that is none

# The ground below the wheels.
CELL_CM: Final = 8  # from the middle of a cell to its corner, with the rounding of distances
AROUND_CM: Final = 16  # from the middle of a cell to a corner of the next one, rounded so, too
# A tyre is wide, and rolls over an edge before it falls: it stands until so far beyond.
TYRE_CM: Final = 2
SLOPES_CM: Final = 4  # so much more a rim may rise against the plane of the wheels, on a ramp
CREEPS_MPS: Final = 0.02  # a slower chair stands: its casters trail

# Solid things and vehicles.
CORNER_M: Final = 0.06  # radius of a disc in each corner of the hull
BEYOND_M: Final = 0.1  # of the hull's corners, where a rough distance is enough
# More than two looks at the raster of clearances differ by beyond the way between them.
RASTER_M: Final = 0.3
VEHICLE_MARGIN_M: Final = 0.05

# Columns of the rims (n, 3), which can meet a step up: the place in B, and the step that they take.
RIM_X, RIM_Y, RIM_TAKES_CM = range(3)
# Columns of the vehicles' boxes (n, 9); the margin is set at the start of a roll-out.
BOX_X, BOX_Y, BOX_COS, BOX_SIN, BOX_HALF_L, BOX_HALF_W, BOX_VX, BOX_VY, BOX_MARGIN = range(9)


class ChairShape(NamedTuple):
    """A chair as the kernels take it."""

    hull: F64  # (3,) see the column names of `walkers`
    # (W, 3) where its wheels stand, in B: the left and right drive wheel, then pairs of casters;
    # the last is the trail.
    wheels: F64
    rims: F64  # (n, 3) what can meet a step up, see the column names above


class StreetRasters(NamedTuple):
    """The rasters of a `StreetGrid`."""

    height_cm: U8
    edge_cm: U8
    clearance_dm: U8
    frame_m: F64  # (3,) their origin in W, and the size of a cell


@compile_exact_kernel
def predict_crash_times(
    state: F64,
    waiting: F64,
    commands: F64,
    limits: F64,
    body: ChairShape,
    above_cm: I64,
    reach_m: float,
    land: StreetRasters,
    boxes: F64,
    people: F64,
    tick_s: float,
    margin_m: float,
) -> F64:
    """Seconds until each command goes wrong, infinity when it ends well.

    Args:
        state: (6,) x, y, yaw, v, w of the drive axle, and the acceleration that its drive gives.
        waiting: (M, 2) joystick positions that come before any command, for STEP_S each; shaped
            as these.
        commands: (K, 2) joystick positions without deadband, on the unit disc.
        limits: (8,) of the drive, see `wcsim.core.joystick`.
        body: The chair's.
        above_cm: (W,) how high above the relief its wheels are.
        reach_m: How far it may get.
        land: Around it.
        boxes: (n, 9) vehicles, see the column names above; the margin column is overwritten.
        people: (m, 9) those who walk, see `walkers`; the margin column is overwritten.
        tick_s: How long a command lasts before another one can be given.
        margin_m: Kept of what stands; a chair that is near keeps half of its gap.

    Returns:
        (K,) float64.
    """
    # 1. Allow what is so already: a chair that touches may leave.
    hull = body.hull
    _set_box_margins(state, hull, boxes)
    set_people_margins(state[0], state[1], state[2], hull, people)
    start_gap = _solid_gap(
        state[0], state[1], state[2], hull, land.clearance_dm, land.frame_m, BEYOND_M
    )
    # Never nearer than it is now, nor than DEEPENING_M in all: each step looks again.
    # A tail swings out before a chair has turned away: half of its gap is left to it.
    free_gap = max(start_gap, 0.0)
    allowed_gap = min(margin_m, 0.5 * free_gap, start_gap - SAME_M, free_gap - DEEPENING_M)
    places = _wheel_places(state, body.wheels)
    start_cm, hanging, rims = _stance(state, body, places, above_cm, reach_m, land)
    around = _circle(rims)
    # 2. Find the people who may be met after a command of one tick.
    stands_s = (
        len(waiting) * STEP_S
        + tick_s
        + limits[V_MAX] / limits[DECEL]
        + limits[DECEL] / limits[JERK]
    )
    near = filter_reachable_people(
        state[0], state[1], stands_s * limits[V_MAX], stands_s, hull, people
    )
    # 3. Try each command, held, and released after one tick.
    first_s = np.full(len(commands), np.inf)
    for k in range(len(commands)):
        first_s[k] = _held_goes_wrong_s(
            state, waiting, commands[k], limits, body, allowed_gap, rims, around, places, start_cm,
            hanging, land, boxes, people,
        )  # fmt: skip
        if len(near):
            first_s[k] = min(
                first_s[k],
                _released_meets_s(state, waiting, commands[k], limits, hull, near, tick_s),
            )
        # It goes wrong before any command begins, so it does with every one of them.
        if first_s[k] <= len(waiting) * STEP_S:
            return np.full(len(commands), first_s[k])
    return first_s


@compile_exact_kernel
def compute_max_prediction_s(limits: F64) -> float:
    """Seconds, at most, of a held command and of the way to a stop; of a drive's limits (8,)."""
    straight_s = limits[V_MAX] / limits[DECEL] + (limits[ACCEL] + limits[DECEL]) / limits[JERK]
    return float(min(SOFTEST_S, HOLD_S + max(straight_s, limits[YAW_MAX] / limits[YAW_ACCEL])))


@compile_exact_kernel
def compute_clearance_m(
    state: F64, hull: F64, land: StreetRasters, boxes: F64, people: F64
) -> float:
    """Metres from the chair's footprint to the nearest solid thing or actor, 0 when they touch."""
    nearest = _solid_gap(
        state[0], state[1], state[2], hull, land.clearance_dm, land.frame_m, np.inf
    )
    cos, sin = math.cos(state[2]), math.sin(state[2])
    cx, cy = state[0] + hull[MIDDLE] * cos, state[1] + hull[MIDDLE] * sin
    for i in range(len(boxes)):
        box = boxes[i]
        if _overlap(cx, cy, cos, sin, hull, box[BOX_X], box[BOX_Y], box, 0.0):
            return 0.0
        # Of two rectangles that do not overlap one has a corner at the nearest place: both are
        # tried.
        gap = min(
            _corners_to_box(
                cx, cy, cos, sin, hull[HALF_L], hull[HALF_W],
                box[BOX_X], box[BOX_Y], box[BOX_COS], box[BOX_SIN],
                box[BOX_HALF_L], box[BOX_HALF_W],
            ),
            _corners_to_box(
                box[BOX_X], box[BOX_Y], box[BOX_COS], box[BOX_SIN],
                box[BOX_HALF_L], box[BOX_HALF_W],
                cx, cy, cos, sin, hull[HALF_L], hull[HALF_W],
            ),
        )  # fmt: skip
        nearest = min(nearest, gap)
    for i in range(len(people)):
        nearest = min(nearest, measure_gap_to_person(state[0], state[1], state[2], hull, people[i]))
    return max(0.0, nearest)


# --- roll-outs ---


@compile_exact_kernel
def _held_goes_wrong_s(
    state: F64, waiting: F64, command: F64, limits: F64, body: ChairShape, allowed_gap: float,
    rims: F64, around: tuple[float, float, float], places: F64, start_cm: I64, hanging: Bool,
    land: StreetRasters, boxes: F64, people: F64,
) -> float:  # fmt: skip
    """Seconds until a command that is held for HOLD_S goes wrong, or infinity."""
    # Unpacked once: a tuple of arrays that is passed on costs more than what is done with it.
    hull = body.hull
    wheels = body.wheels
    height_cm = land.height_cm
    edge_cm = land.edge_cm
    frame_m = land.frame_m
    x, y, yaw, v, w, a = state[0], state[1], state[2], state[3], state[4], state[5]
    before2 = start_cm.copy()
    before = start_cm.copy()
    now = start_cm.copy()
    hangs = hanging.copy()
    at = places.copy()
    gap_m = 0.0
    furthest_m = abs(hull[MIDDLE]) + hull[HALF_L]
    sticks, held = _sticks(waiting, command, HOLD_S, limits)
    for i in range(len(sticks)):
        if i >= held and v == 0.0 and abs(w) < 1e-3:
            break
        # 1. Drive a step.
        v_before = abs(v)
        x, y, yaw, v, w, a = _moved(x, y, yaw, v, w, a, sticks[i], limits)
        later_s = (i + 1) * STEP_S
        cos, sin = math.cos(yaw), math.sin(yaw)
        # 2. Solid things come no nearer than by the way: until they may touch, skip the raster.
        gap_m -= (max(v_before, abs(v)) + abs(w) * furthest_m) * STEP_S
        if gap_m < RASTER_M:
            gap_m = _solid_gap(x, y, yaw, hull, land.clearance_dm, frame_m, BEYOND_M)
        # 3. The height below each wheel; a step down is a fall, one up may stop the chair.
        falls, stops = False, False
        for j in range(len(wheels)):
            trail_m = wheels[j, 2]
            px, py = _in_W(x, y, cos, sin, wheels[j, 0] + trail_m, wheels[j, 1])
            if trail_m > 0.0:
                # A caster is drawn after its swivel.
                dx, dy = at[j, 0] - px, at[j, 1] - py
                share = trail_m / max(math.sqrt(dx * dx + dy * dy), SAME_M)
                px, py = px + share * dx, py + share * dy
                at[j, 0], at[j, 1] = px, py
            # As in `_height_cm`, written out: that is not inlined here, and such a call costs more
            # than the look.
            row, col = _cell(px, py, height_cm.shape, frame_m)
            now[j] = height_cm[row, col]
            if abs(int(edge_cm[row, col]) - AT_EDGE) <= CELL_CM + TYRE_CM:
                now[j] = _height_beside_edge_cm(px, py, TYRE_CM, height_cm, edge_cm, frame_m)
            # Where it cannot stand it does not: a caster that has swung round at a kerb.
            if now[j] - start_cm[j] > KERB_STEP_CM and hangs[j]:
                now[j] = start_cm[j]
            else:
                hangs[j] = False
            # Down a step, or fast up one, within two samples, so that a raster's soft edge counts.
            up = now[j] - min(before[j], before2[j])
            stops |= up > ASKEW_CM
            falls |= max(before[j], before2[j]) - now[j] > KERB_STEP_CM or (
                up > KERB_STEP_CM and abs(v) > BUMP_MPS
            )
        # 4. Whether it has gone wrong.
        if (
            falls
            or _tips(now, start_cm, wheels, v * w, stops)
            or _bumps(x, y, cos, sin, wheels, now, rims, around, height_cm, edge_cm, frame_m)
            or gap_m < allowed_gap
            or _touches(x, y, cos, sin, hull, later_s, boxes)
            or has_steady_person_collision(x, y, yaw, v, w, hull, later_s, people)
        ):
            return later_s
        # A step that a slow wheel cannot climb ends the drive.
        if stops:
            break
        before2[:] = before
        before[:] = now
    return np.inf


@compile_exact_kernel
def _released_meets_s(
    state: F64, waiting: F64, command: F64, limits: F64, hull: F64, people: F64, tick_s: float
) -> float:
    """Seconds until the chair runs into a person, whatever people do, or infinity.

    The command lasts one tick.
    """
    x, y, yaw, v, w, a = state[0], state[1], state[2], state[3], state[4], state[5]
    sticks, held = _sticks(waiting, command, tick_s, limits)
    for i in range(len(sticks)):
        if i >= held and v == 0.0 and abs(w) < 1e-3:
            break
        x, y, yaw, v, w, a = _moved(x, y, yaw, v, w, a, sticks[i], limits)
        if has_possible_person_collision(x, y, yaw, v, w, hull, (i + 1) * STEP_S, people):
            return (i + 1) * STEP_S
    return np.inf


@compile_exact_kernel
def _sticks(waiting: F64, command: F64, held_s: float, limits: F64) -> tuple[F64, int]:
    """Joystick positions (n, 2) of a roll-out's steps, and the step that releases the stick."""
    waits = len(waiting)
    # A hair less: rounding of the quotient must not add a step.
    held = waits + math.ceil(held_s / STEP_S - 1e-6)
    steps = int(max(LONGEST_S, compute_max_prediction_s(limits) + _SPARE_S) / STEP_S)
    sticks = np.zeros((waits + steps, 2))
    sticks[:waits] = waiting
    sticks[waits:held] = command
    return sticks, held


@compile_exact_kernel
def _moved(
    x: float, y: float, yaw: float, v: float, w: float, a: float, stick: F64, limits: F64
) -> tuple[float, float, float, float, float, float]:
    """Pose, speeds and acceleration a step later."""
    v_before, yaw_before = v, yaw
    v, w, a = advance_drive(v, w, a, stick[0], stick[1], limits, STEP_S)
    yaw += w * STEP_S
    # Mean speed along the mean heading: with those of one end the way would err by the first order
    # of the step.
    way = 0.5 * (v_before + v) * STEP_S
    x += way * math.cos(0.5 * (yaw_before + yaw))
    y += way * math.sin(0.5 * (yaw_before + yaw))
    return x, y, yaw, v, w, a


@compile_exact_kernel
def _in_W(
    x: float, y: float, cos: float, sin: float, ahead: float, left: float
) -> tuple[float, float]:
    """A point of the chair, `ahead` and `left` of its drive axle."""
    return x + ahead * cos - left * sin, y + ahead * sin + left * cos


# --- the ground below the wheels ---


@compile_exact_kernel
def _tips(now: I64, start_cm: I64, wheels: F64, aside_mps2: float, stops: bool) -> bool:
    """Whether a chair with its wheels at these heights (W,) leans too far.

    In a turn it leans as on a slope of v w / g. One that climbs with one side slides off it.
    """
    lean = 0.01 * (now[0] - now[1]) / (wheels[0, 1] - wheels[1, 1]) + aside_mps2 / GRAVITY_MPS2
    pitch = 0.01 * 0.5 * (now[2] + now[3] - now[0] - now[1]) / (wheels[2, 0] - wheels[0, 0])
    tips = abs(lean) > LEAN_LIMIT or abs(pitch) > PITCH_LIMIT
    for j in range(0, len(wheels), 2):
        tips |= not stops and abs(now[j] - now[j + 1]) > max(
            ASKEW_CM, abs(start_cm[j] - start_cm[j + 1])
        )
    return bool(tips)


@compile_exact_kernel
def _wheel_places(state: F64, wheels: F64) -> F64:
    """Places (W, 2) in W where the wheels stand: casters behind the way of their swivels."""
    cos, sin, v, w = math.cos(state[2]), math.sin(state[2]), state[3], state[4]
    at = np.empty((len(wheels), 2))
    for j in range(len(wheels)):
        swivel_m, left_m, trail_m = wheels[j, 0] + wheels[j, 2], wheels[j, 1], wheels[j, 2]
        # Of a chair that stands they are behind, too.
        ahead, left = v + CREEPS_MPS - w * left_m, w * swivel_m
        share = trail_m / max(math.sqrt(ahead**2 + left**2), SAME_M)
        at[j] = _in_W(state[0], state[1], cos, sin, swivel_m - share * ahead, left_m - share * left)
    return at


@compile_exact_kernel
def _stance(
    state: F64, body: ChairShape, places: F64, above_cm: I64, reach_m: float, land: StreetRasters
) -> tuple[I64, Bool, F64]:
    """Heights (W,) on which the wheels stand, which of them hang, and the rims to look under.

    A wheel that has left an edge hangs above the ground beside it, and its fall has begun. Mostly
    a chair stands as high as anything in its reach: then no rim has to be looked under.
    """
    x, y, cos, sin = state[0], state[1], math.cos(state[2]), math.sin(state[2])
    wheels, height_cm, edge_cm, frame_m = body.wheels, land.height_cm, land.edge_cm, land.frame_m
    start_cm, hanging = np.empty(len(wheels), np.int64), np.empty(len(wheels), np.bool_)
    for j in range(len(wheels)):
        start_cm[j] = _height_cm(places[j, 0], places[j, 1], TYRE_CM, height_cm, edge_cm, frame_m)
        hanging[j] = start_cm[j] - above_cm[j] > KERB_STEP_CM
        if abs(above_cm[j] - start_cm[j]) > KERB_STEP_CM:
            start_cm[j] = above_cm[j]
    row, col = _cell(x, y, height_cm.shape, frame_m)
    reach = int(reach_m / frame_m[2]) + 1
    near_cm = height_cm[
        max(0, row - reach) : row + reach + 1, max(0, col - reach) : col + reach + 1
    ]
    highest_cm = int(near_cm.max()) - start_cm.min() + SLOPES_CM
    rims = body.rims[body.rims[:, RIM_TAKES_CM] < highest_cm]
    for i in range(len(rims)):
        # Never higher up a step than it is now: a footplate that stands over one may leave.
        now_cm = _rise_cm(x, y, cos, sin, wheels, start_cm, rims[i], height_cm, edge_cm, frame_m)
        rims[i, RIM_TAKES_CM] = max(rims[i, RIM_TAKES_CM], now_cm)
    return start_cm, hanging, rims


@compile_exact_kernel
def _circle(places: F64) -> tuple[float, float, float]:
    """The middle and radius in metres of a circle around places (n, 2 or more) in B; 0 for none."""
    if not len(places):
        return 0.0, 0.0, 0.0
    x = 0.5 * (places[:, 0].min() + places[:, 0].max())
    y = 0.5 * (places[:, 1].min() + places[:, 1].max())
    return x, y, np.sqrt((places[:, 0] - x) ** 2 + (places[:, 1] - y) ** 2).max()


@compile_exact_kernel
def _bumps(
    x: float, y: float, cos: float, sin: float, wheels: F64, now: I64, rims: F64,
    around: tuple[float, float, float], height_cm: U8, edge_cm: U8, frame_m: F64,
) -> bool:  # fmt: skip
    """Whether one of `rims` meets a step of the ground that it does not take."""
    # Only a kerb that cuts the circle around them, or the cells beside it, is one to them.
    px, py = _in_W(x, y, cos, sin, around[0], around[1])
    row, col = _cell(px, py, edge_cm.shape, frame_m)
    if abs(int(edge_cm[row, col]) - AT_EDGE) > 100.0 * around[2] + AROUND_CM:
        return False
    for i in range(len(rims)):
        rise_cm = _rise_cm(x, y, cos, sin, wheels, now, rims[i], height_cm, edge_cm, frame_m)
        if rise_cm > rims[i, RIM_TAKES_CM]:
            return True
    return False


@compile_exact_kernel
def _rise_cm(
    x: float, y: float, cos: float, sin: float, wheels: F64, now: I64, rim: F64,
    height_cm: U8, edge_cm: U8, frame_m: F64,
) -> float:  # fmt: skip
    """By how much the ground at a rim lies above the plane on which the wheels stand (W,)."""
    px, py = _in_W(x, y, cos, sin, rim[RIM_X], rim[RIM_Y])
    axle_cm = 0.5 * (now[0] + now[1])
    ahead_cm = (0.5 * (now[2] + now[3]) - axle_cm) * rim[RIM_X] / wheels[2, 0]
    return float(_height_cm(px, py, 0, height_cm, edge_cm, frame_m) - axle_cm - ahead_cm)


@compile_exact_kernel
def _cell(x: float, y: float, shape: tuple[int, int], frame_m: F64) -> tuple[int, int]:
    """Row and column of a place; of one outside those of the nearest cell."""
    row, col = math.floor((y - frame_m[1]) / frame_m[2]), math.floor((x - frame_m[0]) / frame_m[2])
    return min(max(row, 0), shape[0] - 1), min(max(col, 0), shape[1] - 1)


@compile_exact_kernel
def _height_cm(
    x: float, y: float, carried_cm: int, height_cm: U8, edge_cm: U8, frame_m: F64
) -> int:
    """Height of the ground that carries what is there, up to `carried_cm` beyond an edge.

    Not interpolated: between two cells a kerb would become a ramp.
    """
    row, col = _cell(x, y, height_cm.shape, frame_m)
    if abs(int(edge_cm[row, col]) - AT_EDGE) > CELL_CM + carried_cm:
        return int(height_cm[row, col])
    return _height_beside_edge_cm(x, y, carried_cm, height_cm, edge_cm, frame_m)


@compile_exact_kernel
def _height_beside_edge_cm(
    x: float, y: float, carried_cm: int, height_cm: U8, edge_cm: U8, frame_m: F64
) -> int:
    """The same in a cell that a kerb cuts: as in the nearest middle of a cell on the same side."""
    rows, cols = height_cm.shape
    row, col = (y - frame_m[1]) / frame_m[2] - 0.5, (x - frame_m[0]) / frame_m[2] - 0.5
    c0, r0 = min(max(math.floor(col), 0), cols - 2), min(max(math.floor(row), 0), rows - 2)
    fc, fr = min(max(col - c0, 0.0), 1.0), min(max(row - r0, 0.0), 1.0)
    shares = ((1.0 - fr) * (1.0 - fc), (1.0 - fr) * fc, fr * (1.0 - fc), fr * fc)
    # The side follows from the distance, which has a sign, between the four middles around.
    side = float(carried_cm)
    for k in range(4):
        side += shares[k] * (edge_cm[r0 + k // 2, c0 + k % 2] - AT_EDGE + 0.5)
    best, found = -1.0, int(height_cm[r0 + round(fr), c0 + round(fc)])
    for k in range(4):
        r, c = r0 + k // 2, c0 + k % 2
        if shares[k] > best and (edge_cm[r, c] >= AT_EDGE) == (side >= 0.0):
            best, found = shares[k], int(height_cm[r, c])
    return found


# --- solid things ---


@compile_exact_kernel
def _solid_gap(
    x: float, y: float, yaw: float, hull: F64, clearance_dm: U8, frame_m: F64, beyond_m: float
) -> float:
    """Metres from the footprint to the nearest solid thing, negative inside it.

    Three discs as wide as the chair, and a small one in each corner, stand for the rectangle:
    inside a solid thing the raster knows no depth. Beyond `beyond_m` the distance is a rough one.
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
        px, py = cx + ahead * cos, cy + ahead * sin
        gap = min(gap, _clearance(px, py, clearance_dm, frame_m) - hull[HALF_W])
    for i in range(4):
        ahead = (hull[HALF_L] - CORNER_M) * (1.0 if i < 2 else -1.0)
        left = (hull[HALF_W] - CORNER_M) * (1.0 if i % 2 == 0 else -1.0)
        px, py = _in_W(cx, cy, cos, sin, ahead, left)
        gap = min(gap, _clearance(px, py, clearance_dm, frame_m) - CORNER_M)
    return gap


@compile_exact_kernel
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


# --- vehicles ---


@compile_exact_kernel
def _set_box_margins(state: F64, hull: F64, boxes: F64) -> None:
    """Set a small margin, except for those within it already: they would forbid every move."""
    cos, sin = math.cos(state[2]), math.sin(state[2])
    cx, cy = state[0] + hull[MIDDLE] * cos, state[1] + hull[MIDDLE] * sin
    for i in range(len(boxes)):
        box = boxes[i]
        near = _overlap(cx, cy, cos, sin, hull, box[BOX_X], box[BOX_Y], box, VEHICLE_MARGIN_M)
        box[BOX_MARGIN] = 0.0 if near else VEHICLE_MARGIN_M


@compile_exact_kernel
def _touches(
    x: float, y: float, cos: float, sin: float, hull: F64, later_s: float, boxes: F64
) -> bool:
    cx, cy = x + hull[MIDDLE] * cos, y + hull[MIDDLE] * sin
    for i in range(len(boxes)):
        box = boxes[i]
        ox, oy = box[BOX_X] + later_s * box[BOX_VX], box[BOX_Y] + later_s * box[BOX_VY]
        if _overlap(cx, cy, cos, sin, hull, ox, oy, box, box[BOX_MARGIN]):
            return True
    return False


@compile_exact_kernel
def _overlap(
    cx: float, cy: float, cos: float, sin: float, hull: F64,
    ox: float, oy: float, box: F64, margin: float,
) -> bool:  # fmt: skip
    """Whether the chair's rectangle meets a box at (ox, oy), which is grown by `margin`."""
    return boxes_touch(
        cx, cy, cos, sin, hull[HALF_L], hull[HALF_W],
        ox, oy, box[BOX_COS], box[BOX_SIN], box[BOX_HALF_L] + margin, box[BOX_HALF_W] + margin,
    )  # fmt: skip


@compile_exact_kernel
def _corners_to_box(
    ax: float, ay: float, acos: float, asin: float, al: float, aw: float,
    bx: float, by: float, bcos: float, bsin: float, bl: float, bw: float,
) -> float:  # fmt: skip
    """The least distance from the corners of rectangle a to rectangle b."""
    least = np.inf
    for i in range(4):
        ahead = al if i < 2 else -al
        left = aw if i % 2 == 0 else -aw
        x, y = _in_W(ax, ay, acos, asin, ahead, left)
        least = min(least, max(0.0, gap_to_box(x, y, bx, by, bcos, bsin, bl, bw)))
    return least
