"""How near each joystick position comes to what the chair's own street map shows: no senses but that map are needed.

A cell is in the way when it is higher than the ground around it by more than casters climb: a wall, a person, the upper
edge of a kerb, whether it leads up or down. Of those cells, the ones that somebody who can move has left a trail in
count as what moves. Two exact distance transforms follow, which are read where discs that fill the chair's outline
would be. The numbers are those of `roll_outs.profile`. Kernels: plain arrays in and out; the same in tensors is
`export/map_gaps_graph.py`.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from wcsim.agents.danger.roll_outs import (
    GAP,
    HOLD_S,
    MOVER_GAP,
    MOVER_TOUCH,
    STEP_S,
    STEPS,
    TOUCH,
    TOUCH_M,
    WAY,
    WAY_M,
    gap_code,
)
from wcsim.agents.danger.street_map import BEHIND_M, CELL_M, HALF_M, HIGHEST, LOWEST, SIDE, TRAIL
from wcsim.agents.policies.dynamic_window.arcs import advance
from wcsim.core.jit import exact_kernel
from wcsim.types import F64, U8

I32 = npt.NDArray[np.int32]

RISE_CODES: Final = 13  # 0.077 m in codes of height: more than casters climb, and than noise makes of level ground
SLOPE_CODES: Final = 3  # for each cell of distance: a steep ramp
HIDDEN_CELLS: Final = 3  # of unseen ground may lie between a cell and the lower one: it is hidden behind a kerb's edge
FIRST_ROW: Final = 12  # 3.6 m ahead: farther away noise makes steps of level ground, and no position leads there
NO_GROUND: Final = 400  # code of height where nothing was seen
FAR_CELLS: Final = 10  # farther away nothing matters
STANDS, MOVES = range(2)  # which map of distances
_LENGTHWAYS: Final = 4  # discs of the chair's whole width
_CORNER: Final = 0.3  # radius of those in its corners, of half the width


def discs_of(box: F64) -> F64:
    """(n, 3) middles in B and radii of discs that fill the chair's outline (rear, front, half the width) to 3 cm."""
    rear, front, half = box.tolist()
    small = _CORNER * half
    rows = [(x, 0.0, half) for x in np.linspace(rear + half, front - half, _LENGTHWAYS).tolist()]
    rows += [(x, y, small) for x in (rear + small, front - small) for y in (small - half, half - small)]
    return np.array(rows, np.float64)


@exact_kernel
def in_the_way(picture: U8, out: I32) -> None:
    """Cells that are in the way.

    Args:
        picture: (PLANES, SIDE, SIDE) see `street_map`; its own planes are looked at.
        out: (2, SIDE, SIDE) written: 0 in cells of what stands, and of what moves, FAR_CELLS elsewhere.
    """
    ground, around = np.empty((SIDE, SIDE), np.int32), np.empty((SIDE, SIDE), np.int32)
    for i in range(SIDE):
        for j in range(SIDE):
            ground[i, j] = picture[LOWEST, i, j] if picture[LOWEST, i, j] > 0 else NO_GROUND
    for _ in range(HIDDEN_CELLS):
        _lowest_around(ground, around)
        for i in range(SIDE):
            for j in range(SIDE):
                if picture[LOWEST, i, j] == 0:
                    ground[i, j] = min(ground[i, j], around[i, j] + SLOPE_CODES)
    _lowest_around(ground, around)
    out[:] = FAR_CELLS
    for i in range(FIRST_ROW, SIDE):
        for j in range(SIDE):
            if picture[HIGHEST, i, j] > min(picture[LOWEST, i, j], around[i, j] + SLOPE_CODES) + RISE_CODES:
                out[MOVES if picture[TRAIL, i, j] > 0 else STANDS, i, j] = 0


@exact_kernel
def _lowest_around(ground: I32, out: I32) -> None:
    """The least of each cell and the eight around it."""
    wide = np.empty((SIDE, SIDE), np.int32)
    for i in range(SIDE):
        for j in range(SIDE):
            wide[i, j] = min(ground[i, j], min(ground[i, max(j - 1, 0)], ground[i, min(j + 1, SIDE - 1)]))
    for i in range(SIDE):
        above, below = wide[max(i - 1, 0)], wide[min(i + 1, SIDE - 1)]
        for j in range(SIDE):
            out[i, j] = min(wide[i, j], min(above[j], below[j]))


@exact_kernel
def distances(cells: I32, out: F64) -> bool:
    """Distances to the nearest cell that is 0.

    Args:
        cells: (SIDE, SIDE) 0 or FAR_CELLS; used up.
        out: (SIDE, SIDE) written: metres between middles, at most FAR_CELLS * CELL_M.

    Returns:
        Whether there is any.
    """
    squares = np.full((SIDE, SIDE), FAR_CELLS * FAR_CELLS, np.int32)
    there = False
    for i in range(SIDE):
        row, found = cells[i], False
        for j in range(SIDE):
            found = found or row[j] == 0
        if not found:
            continue
        there = True
        for j in range(1, SIDE):
            row[j] = min(row[j], row[j - 1] + 1)
        for j in range(SIDE - 2, -1, -1):
            row[j] = min(row[j], row[j + 1] + 1)
        for other in range(max(i - FAR_CELLS + 1, 0), min(i + FAR_CELLS, SIDE)):
            away, into = (other - i) * (other - i), squares[other]
            for j in range(SIDE):
                into[j] = min(into[j], row[j] * row[j] + away)
    for i in range(SIDE):
        for j in range(SIDE):
            out[i, j] = CELL_M * math.sqrt(squares[i, j])
    return there


@exact_kernel
def map_profile(start: F64, commands: F64, limits: F64, discs: F64, picture: U8, out: U8) -> None:
    """How near each command brings the chair to what its street map shows; see `roll_outs.profile` for the numbers.

    Args:
        start: (6,) the state when the command reaches the chair, see `arcs`.
        commands: (K, 2) joystick positions as the drive takes them.
        limits: (7,) of the drive.
        discs: (n, 3) see `discs_of`.
        picture: (PLANES, SIDE, SIDE) of now.
        out: (K, NUMBERS) written.
    """
    cells, away_m = np.empty((2, SIDE, SIDE), np.int32), np.empty((2, SIDE, SIDE))
    in_the_way(picture, cells)
    there = (distances(cells[STANDS], away_m[STANDS]), distances(cells[MOVES], away_m[MOVES]))
    rest, now, gaps = np.zeros(2), np.empty(6), np.empty(2)
    for k in range(len(commands)):
        now[:] = start
        least_m, touch = np.full(2, np.inf), np.full(2, STEPS)
        for i in range(STEPS):
            held = i * STEP_S < HOLD_S - 1e-9
            if not held and now[3] == 0.0 and now[4] == 0.0 and now[5] == 0.0:
                break
            advance(now, commands[k] if held else rest, limits, STEP_S)
            _gaps(now, discs, away_m, there, gaps)
            for which in range(2):
                least_m[which] = min(least_m[which], gaps[which])
                if gaps[which] < TOUCH_M:
                    touch[which] = min(touch[which], i)
        out[k, GAP], out[k, TOUCH] = gap_code(least_m[STANDS]), 255 * touch[STANDS] // STEPS
        out[k, MOVER_GAP], out[k, MOVER_TOUCH] = gap_code(least_m[MOVES]), 255 * touch[MOVES] // STEPS
        out[k, WAY] = int(255.0 * min(math.hypot(now[0] - start[0], now[1] - start[1]) / WAY_M, 1.0))


@exact_kernel
def _gaps(now: F64, discs: F64, away_m: F64, there: tuple[bool, bool], out: F64) -> None:
    """Room (2,) around the chair in a state (6,), to what stands and to what moves; below 0 it is inside."""
    cos, sin = math.cos(now[2]), math.sin(now[2])
    out[:] = np.inf
    for n in range(len(discs)):
        x = now[0] + cos * discs[n, 0] - sin * discs[n, 1]
        y = now[1] + sin * discs[n, 0] + cos * discs[n, 1]
        row = min(max(SIDE - 0.5 - (x + BEHIND_M) / CELL_M, 0.0), SIDE - 1.001)
        column = min(max((HALF_M - y) / CELL_M - 0.5, 0.0), SIDE - 1.001)
        i, j = int(row), int(column)
        down, right = row - i, column - j
        for which in range(2):
            if there[which]:
                far = away_m[which]
                above = (1.0 - right) * far[i, j] + right * far[i, j + 1]
                below = (1.0 - right) * far[i + 1, j] + right * far[i + 1, j + 1]
                out[which] = min(out[which], (1.0 - down) * above + down * below - discs[n, 2])
