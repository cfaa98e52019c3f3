"""Over which cells of a street map each joystick position would bring the chair.

Kernels: plain arrays in and out. Each position is held for half a second and then let go, as the oracle rolls it out.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from wcsim.agents.danger.street_map import BEHIND_M, CELL_M, HALF_M, SIDE
from wcsim.agents.policies.dynamic_window.arcs import advance
from wcsim.core.jit import exact_kernel
from wcsim.types import F64

I32 = npt.NDArray[np.int32]

HOLD_S: Final = 0.5
STEP_S: Final = 0.1
# places of the chair that are looked at in each slice of time, and slices
SLICES: Final = 3
EACH_SLICE: Final = 4  # steps of a slice


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
                # A hair less: rounding of the product must not add a step.
                held = i * STEP_S < HOLD_S - 1e-9
                advance(now, commands[k] if held else rest, limits, STEP_S)
                cos, sin = math.cos(now[2]), math.sin(now[2])
                for p in range(len(chair)):
                    x = now[0] + cos * chair[p, 0] - sin * chair[p, 1]
                    y = now[1] + sin * chair[p, 0] + cos * chair[p, 1]
                    # Clamped: what leaves the map is read at its edge, as there is no cell that says "unknown".
                    row = min(max(SIDE - 1 - math.floor((x + BEHIND_M) / CELL_M), 0), SIDE - 1)
                    column = min(max(math.floor((HALF_M - y) / CELL_M), 0), SIDE - 1)
                    which = i // EACH_SLICE + (SLICES if chair[p, 2] > 0.0 else 0)
                    out[b, k, place] = which * plane + row * SIDE + column
                    place += 1
