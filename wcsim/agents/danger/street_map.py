"""The street from above as a picture around the chair: what its camera showed in the last seconds, and what moves.

Cells of 0.1 m lie in the odometric frame O and are written anew whenever they are seen; the picture is read out of them
around the chair, 1.6 m behind its axle to 4.8 m ahead. Its first row is the farthest ahead, its first column the
farthest to the left.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from wcsim.core.jit import exact_kernel
from wcsim.types import F32, F64, U8, Bool, ClassId

I64 = npt.NDArray[np.int64]

SIDE: Final = 64  # cells of the picture each way
CELL_M: Final = 0.1
BEHIND_M: Final = 1.6
HALF_M: Final = 0.5 * SIDE * CELL_M
# planes of the picture, uint8
HIGHEST, LOWEST, AGE, TRAIL, KIND = range(5)
PLANES: Final = 5
RASTER: Final = 160  # cells of the raster each way: more than twice as far as the picture reaches
KEEP_TICKS: Final = 40
TRAIL_TICKS: Final = 20
LOW_M, SPAN_M = -0.5, 1.5  # heights above the axle's ground that the codes 1 to 255 stand for
HEAD_M: Final = 1.8  # what hangs higher passes above
MOVER_M: Final = 0.2  # a person or vehicle shows something above this
REACH_M: Final = 7.5
# columns of a cell
_KEY_X, _KEY_Y, _TICK, _MOVER, _CLASS = range(5)
_PAVED, _ROAD, _EARTH, _OTHER = range(1, 5)


def kinds_of_ground() -> U8:
    """Table (256,) uint8 from a pixel's class to a kind of ground, 0 for what is none."""
    table = np.zeros(256, np.uint8)
    table[[ClassId.SIDEWALK, ClassId.KERB, ClassId.LOWERED_KERB]] = _PAVED
    table[[ClassId.ROAD, ClassId.PARKING, ClassId.RAIL_TRACK, ClassId.CROSSWALK]] = _ROAD
    table[[ClassId.GROUND, ClassId.TERRAIN]] = _EARTH
    table[[ClassId.BUILDING, ClassId.WALL, ClassId.FENCE]] = _OTHER
    return table


def movers() -> Bool:
    """Table (256,) of the classes that may move."""
    table = np.zeros(256, np.bool_)
    table[ClassId.PERSON : ClassId.BICYCLE + 1] = True
    return table


class StreetMap:
    """The raster of one chair.

    Args:
        rays: (n, 3) directions in B per metre of depth.
        eye_B_m: (3,) where the camera is.
        far_m: Depths from here on are no measurement.
    """

    def __init__(self, rays: F32, eye_B_m: F64, far_m: float) -> None:
        self._rays, self._eye_B_m, self._far_m = rays, eye_B_m, far_m
        self._kinds, self._movers = kinds_of_ground(), movers()
        self._cells = np.zeros((RASTER, RASTER, 5), np.int64)
        self._heights_m = np.zeros((RASTER, RASTER, 2), np.float32)
        self.forget()

    def forget(self) -> None:
        """Know nothing."""
        # Heights stay: they are read only where a cell has a tick.
        self._cells[:] = 0
        self._tick = 0

    def see(self, depth_m: F32, class_id: U8, pose_O: F64) -> None:
        """Take in a picture: depth (n,) along the optical axis, 0 for none, and classes (n,) of the same pixels."""
        self._tick += 1
        _write(
            depth_m, class_id, self._rays, self._eye_B_m, self._far_m, pose_O, self._tick,
            self._kinds, self._movers, self._cells, self._heights_m,
        )  # fmt: skip

    def picture(self, pose_O: F64, out: U8) -> None:
        """Write the picture (PLANES, SIDE, SIDE) around a chair at `pose_O` (3,)."""
        _read(pose_O, self._tick, self._cells, self._heights_m, out)


@exact_kernel
def _write(
    depth: F32, classes: U8, rays: F32, eye: F64, far_m: float, pose: F64, tick: int, kinds: U8, movers: Bool,
    cells: I64, heights: F32,
) -> None:  # fmt: skip
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for n in range(len(depth)):
        if not 0.0 < depth[n] < far_m:
            continue
        x, y, z = eye[0] + depth[n] * rays[n, 0], eye[1] + depth[n] * rays[n, 1], eye[2] + depth[n] * rays[n, 2]
        if z > HEAD_M or max(abs(x), abs(y)) > REACH_M:
            continue
        ix = math.floor((pose[0] + cos * x - sin * y) / CELL_M)
        iy = math.floor((pose[1] + sin * x + cos * y) / CELL_M)
        cell, height = cells[ix % RASTER, iy % RASTER], heights[ix % RASTER, iy % RASTER]
        kind = kinds[classes[n]]
        # The raster wraps around: a key tells a place from another one that falls into the same cell.
        if cell[_KEY_X] != ix or cell[_KEY_Y] != iy:
            cell[_KEY_X], cell[_KEY_Y], cell[_MOVER] = ix, iy, 0
            cell[_TICK] = 0
        # The newest picture replaces what older ones said; within it heights are gathered.
        if cell[_TICK] != tick:
            cell[_TICK], cell[_CLASS] = tick, kind
            height[0] = height[1] = z
        else:
            height[0], height[1] = max(height[0], z), min(height[1], z)
            if kind > 0:
                cell[_CLASS] = kind
        if movers[classes[n]] and z > MOVER_M:
            cell[_MOVER] = tick


@exact_kernel
def _read(pose: F64, tick: int, cells: I64, heights: F32, out: U8) -> None:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    out[:] = 0
    for i in range(SIDE):
        for j in range(SIDE):
            bx, by = (SIDE - i - 0.5) * CELL_M - BEHIND_M, HALF_M - (j + 0.5) * CELL_M
            x, y = pose[0] + cos * bx - sin * by, pose[1] + sin * bx + cos * by
            ix, iy = math.floor(x / CELL_M), math.floor(y / CELL_M)
            cell = cells[ix % RASTER, iy % RASTER]
            if cell[_TICK] == 0 or cell[_KEY_X] != ix or cell[_KEY_Y] != iy:
                continue
            # Codes fall with age, so that a network can trust what it saw just now more than what may have moved.
            age = tick - cell[_TICK]
            if age <= KEEP_TICKS:
                out[HIGHEST, i, j] = _height_code(heights[ix % RASTER, iy % RASTER, 0])
                out[LOWEST, i, j] = _height_code(heights[ix % RASTER, iy % RASTER, 1])
                out[AGE, i, j] = 255 - 5 * age
                out[KIND, i, j] = 60 * cell[_CLASS]
            if cell[_MOVER] > 0 and tick - cell[_MOVER] <= TRAIL_TICKS:
                out[TRAIL, i, j] = 255 - 12 * (tick - cell[_MOVER])


@exact_kernel
def _height_code(height_m: float) -> int:
    return 1 + int(254.0 * min(max((height_m - LOW_M) / SPAN_M, 0.0), 1.0))
