"""Where each joystick position would bring the chair, as numbers for a network: how near to what, and over which cells.

Kernels: plain arrays in and out. Each position is held for half a second and then let go, as the oracle rolls it out.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from wcsim.agents.danger.street_map import BEHIND_M, CELL_M, HALF_M, SIDE
from wcsim.agents.policies.dynamic_window.arcs import advance, box_gap
from wcsim.core.jit import exact_kernel
from wcsim.types import F64, U8

I32 = npt.NDArray[np.int32]

HOLD_S: Final = 0.5
STEP_S, STEPS = 0.1, 16
NEAR_M: Final = 0.6  # farther away nothing matters
INSIDE_M: Final = 0.2  # deeper inside nothing matters
TOUCH_M: Final = 0.03
WAY_M: Final = 2.0  # farther a chair does not come
# numbers for each action, uint8
GAP, TOUCH, MOVER_GAP, MOVER_TOUCH, WAY = range(5)
NUMBERS: Final = 5
# places of the chair that are looked at in each slice of time, and slices
SLICES: Final = 3
EACH_SLICE: Final = 4  # steps of a slice


@exact_kernel
def profile(start: F64, later_s: float, commands: F64, limits: F64, box: F64, points: F64, out: U8) -> None:
    """How near each command brings the chair to what is in the way.

    Args:
        start: (6,) the state when the command reaches the chair, see `arcs`.
        later_s: When that is, from now on.
        commands: (K, 2) joystick positions as the drive takes them.
        limits: (7,) of the drive.
        box: (3,) rear, front, half the width of the chair in B.
        points: (n, 5) what is in the way, in B of now, and how fast it moves over the ground.
        out: (K, NUMBERS) written: least distance and time of the first touch, of what stands and of what moves, and
            how far the chair goes; 255 is far, late and long.
    """
    rest, now = np.zeros(2), np.empty(6)
    for k in range(len(commands)):
        now[:] = start
        gap, mover_gap, touch, mover_touch = NEAR_M, NEAR_M, STEPS, STEPS
        for i in range(STEPS):
            held = i * STEP_S < HOLD_S - 1e-9
            if not held and now[3] == 0.0 and abs(now[4]) < 1e-3:
                break
            advance(now, commands[k] if held else rest, limits, STEP_S)
            cos, sin, at_s = math.cos(now[2]), math.sin(now[2]), later_s + (i + 1) * STEP_S
            for n in range(len(points)):
                dx = points[n, 0] + at_s * points[n, 2] - now[0]
                dy = points[n, 1] + at_s * points[n, 3] - now[1]
                if max(abs(dx), abs(dy)) > box[1] + NEAR_M:
                    continue
                away = box_gap(dx, dy, cos, sin, box)
                if points[n, 2] != 0.0 or points[n, 3] != 0.0:
                    mover_gap = min(mover_gap, away)
                    if away < TOUCH_M:
                        mover_touch = min(mover_touch, i)
                else:
                    gap = min(gap, away)
                    if away < TOUCH_M:
                        touch = min(touch, i)
        out[k, GAP], out[k, TOUCH] = gap_code(gap), 255 * touch // STEPS
        out[k, MOVER_GAP], out[k, MOVER_TOUCH] = gap_code(mover_gap), 255 * mover_touch // STEPS
        out[k, WAY] = int(255.0 * min(math.hypot(now[0] - start[0], now[1] - start[1]) / WAY_M, 1.0))


@exact_kernel
def gap_code(gap_m: float) -> int:
    """From -0.2 m, inside, to 0.6 m."""
    return int(255.0 * min(max((gap_m + INSIDE_M) / (NEAR_M + INSIDE_M), 0.0), 1.0))


def hull_and_wheels(box: F64, wheels_m: F64) -> F64:
    """(n, 3) points of the chair in B that sweep over the ground; the last column is 1 for a wheel, else 0."""
    rear, front, half = box.tolist()
    middle = 0.5 * (rear + front)
    hull = [(x, y) for x in (rear, middle, front) for y in (-half, 0.0, half)]
    rows = [(x, y, 0.0) for x, y in hull] + [(x, y, 1.0) for x, y in wheels_m.tolist()]
    return np.array(rows, np.float64)


@exact_kernel
def sweep(starts: F64, commands: F64, limits: F64, chair: F64, out: I32) -> None:
    """Over which cells of a street map each command brings the chair.

    Args:
        starts: (B, 6) states when the commands reach the chairs, see `arcs`.
        commands: (K, 2) joystick positions as the drive takes them.
        limits: (7,) of the drive.
        chair: (n, 3) see `hull_and_wheels`.
        out: (B, K, SLICES * 4 * n) written: flat indices into (2 * SLICES, SIDE, SIDE) maps, those of the hull first.
    """
    rest, now = np.zeros(2), np.empty(6)
    plane = SIDE * SIDE
    for b in range(len(starts)):
        for k in range(len(commands)):
            now[:] = starts[b]
            place = 0
            for i in range(SLICES * EACH_SLICE):
                held = i * STEP_S < HOLD_S - 1e-9
                advance(now, commands[k] if held else rest, limits, STEP_S)
                cos, sin = math.cos(now[2]), math.sin(now[2])
                for p in range(len(chair)):
                    x = now[0] + cos * chair[p, 0] - sin * chair[p, 1]
                    y = now[1] + sin * chair[p, 0] + cos * chair[p, 1]
                    row = min(max(SIDE - 1 - math.floor((x + BEHIND_M) / CELL_M), 0), SIDE - 1)
                    column = min(max(math.floor((HALF_M - y) / CELL_M), 0), SIDE - 1)
                    which = i // EACH_SLICE + (SLICES if chair[p, 2] > 0.0 else 0)
                    out[b, k, place] = which * plane + row * SIDE + column
                    place += 1
