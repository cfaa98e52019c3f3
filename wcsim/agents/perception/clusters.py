"""Movers in a picture: pixels of people, riders and vehicles, grouped by place on the ground."""

import math
from typing import Final

import numpy as np
from scipy.ndimage import label

from wcsim.agents.perception.depth_image import CameraView
from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F32, F64, I64, U8, Bool, ClassId

FEWEST_PX: Final = 4  # less is noise
STANDS, WALKS, DRIVES = range(3)
# Columns of a cluster (m, 11): middle and extent in O; pixels, those of walkers; first and last
# column of the picture; mean depth.
X, Y, LEAST_X, MOST_X, LEAST_Y, MOST_Y, PIXELS, WALKERS, FIRST, LAST, DEPTH = range(11)
_WALK: Final = (ClassId.PERSON, ClassId.RIDER, ClassId.BICYCLE, ClassId.MOTORCYCLE)
_DRIVE: Final = (ClassId.CAR, ClassId.TRUCK, ClassId.BUS, ClassId.TRAIN)
_CELL_M: Final = 0.2
# How far movers are searched for, ahead as behind, and to each side.
_ALONG_M: Final = 12.0
_ASIDE_M: Final = 8.0
_AXLE_ROW: Final = round(_ALONG_M / _CELL_M)
_ROWS: Final = 2 * _AXLE_ROW
_COLUMNS: Final = 2 * round(_ASIDE_M / _CELL_M)
# Above the ground: only what a mover shows between them counts.
_LOW_M: Final = 0.15
_HIGH_M: Final = 2.2
# Beside a mover, so many columns of its class are painted on what is behind it.
_FRINGE_PX: Final = 3
_MOST: Final = 24  # clusters at once
_MOST_CELLS: Final = 1024


def make_class_mobility_table() -> U8:
    """Table (256,) uint8 from a pixel's class to STANDS, WALKS or DRIVES."""
    table = np.full(256, STANDS, np.uint8)
    table[list(_WALK)] = WALKS
    table[list(_DRIVE)] = DRIVES
    return table


def find_movable_clusters(kind: U8, view: CameraView, up: F64, pose_O: F64) -> tuple[F64, F64, I64]:
    """Group pixels that could move.

    Args:
        kind: (H, W) STANDS, WALKS or DRIVES.
        view: Of the same pixels.
        up: (3,) the direction up in B.
        pose_O: (3,) of the chair.

    Returns:
        The clusters (m, 11), see the column names; the middles (k, 2) in B of the cells with such
        pixels; and the number of each cell's cluster (k,), -1 for none.
    """
    # 1. Which cells have such pixels.
    cells = np.full((_ROWS, _COLUMNS), -1, np.int64)
    points = np.empty((_MOST_CELLS, 2))
    seen = view.depth_m, view.rays, view.eye_B_m, view.far_m, up, cells
    count = _number_cells(kind.reshape(-1), *seen, points)
    # 2. Touching cells have one owner. Owners are numbered in the order of their first cells, and
    # those beyond _MOST are left out.
    taken = cells >= 0
    owner = np.empty(count, np.int64)
    owner[cells[taken]] = label(taken, np.ones((3, 3)))[0][taken]
    _, first, owner_index = np.unique(owner, return_index=True, return_inverse=True)
    owner = np.argsort(np.argsort(first))[owner_index]
    owner[owner >= _MOST] = -1
    # 3. Measure each cluster, and drop noise and fringes.
    clusters = np.zeros((_MOST, 11))
    found = _measure(kind.reshape(-1), kind.shape[1], *seen, pose_O, owner, clusters)
    return clusters[:found], points[:count], owner


@compile_exact_kernel
def mask_points_near_cells(points_B_m: F64, cells_B_m: F64) -> Bool:
    """(n,) which of the points lie in a cell of `cells_B_m` (k, 2), or right beside it."""
    near = np.zeros(len(points_B_m), np.bool_)
    for n in range(len(points_B_m)):
        for k in range(len(cells_B_m)):
            if (
                abs(points_B_m[n, 0] - cells_B_m[k, 0]) < 1.5 * _CELL_M
                and abs(points_B_m[n, 1] - cells_B_m[k, 1]) < 1.5 * _CELL_M
            ):
                near[n] = True
                break
    return near


@compile_exact_kernel
def _cell(depth: float, ray: F32, eye: F64, far_m: float, up: F64) -> tuple[int, int, float, float]:
    """Row and column of a pixel, -1 outside the grid, and its place in B."""
    if not 0.0 < depth < far_m:
        return -1, -1, 0.0, 0.0
    x, y, z = eye[0] + depth * ray[0], eye[1] + depth * ray[1], eye[2] + depth * ray[2]
    height = max(z, up[0] * x + up[1] * y + up[2] * z)
    row = math.floor(x / _CELL_M) + _AXLE_ROW
    column = math.floor((y + _ASIDE_M) / _CELL_M)
    if not (_LOW_M < height < _HIGH_M and 0 <= row < _ROWS and 0 <= column < _COLUMNS):
        return -1, -1, 0.0, 0.0
    return row, column, x, y


@compile_exact_kernel
def _number_cells(
    kind: U8, depth_m: F32, rays: F32, eye: F64, far_m: float, up: F64, cells: I64, points: F64
) -> int:
    """Write numbers and middles of the cells with pixels that could move; returns how many."""
    count = 0
    for n in range(len(kind)):
        if kind[n] == STANDS or count >= len(points):
            continue
        row, column, _, _ = _cell(depth_m[n], rays[n], eye, far_m, up)
        if row >= 0 and cells[row, column] < 0:
            cells[row, column] = count
            points[count, 0] = (row - _AXLE_ROW + 0.5) * _CELL_M
            points[count, 1] = (column + 0.5) * _CELL_M - _ASIDE_M
            count += 1
    return count


@compile_exact_kernel
def _measure(
    kind: U8, width: int, depth_m: F32, rays: F32, eye: F64, far_m: float, up: F64, cells: I64,
    pose: F64, owner: I64, clusters: F64,
) -> int:  # fmt: skip
    """Write the columns of the clusters, valid ones first, and their numbers into `owner`.

    Returns:
        How many are valid.
    """
    clusters[:, LEAST_X] = clusters[:, LEAST_Y] = clusters[:, FIRST] = np.inf
    clusters[:, MOST_X] = clusters[:, MOST_Y] = clusters[:, LAST] = -np.inf
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for n in range(len(kind)):
        if kind[n] == STANDS:
            continue
        row, column, bx, by = _cell(depth_m[n], rays[n], eye, far_m, up)
        if row < 0 or cells[row, column] < 0 or owner[cells[row, column]] < 0:
            continue
        one = clusters[owner[cells[row, column]]]
        x, y = pose[0] + cos * bx - sin * by, pose[1] + sin * bx + cos * by
        one[X] += x
        one[Y] += y
        one[LEAST_X], one[MOST_X] = min(one[LEAST_X], x), max(one[MOST_X], x)
        one[LEAST_Y], one[MOST_Y] = min(one[LEAST_Y], y), max(one[MOST_Y], y)
        one[PIXELS] += 1
        one[WALKERS] += kind[n] == WALKS
        one[FIRST], one[LAST] = min(one[FIRST], n % width), max(one[LAST], n % width)
        one[DEPTH] += depth_m[n]
    for one in clusters:
        if one[PIXELS] > 0:
            one[X] /= one[PIXELS]
            one[Y] /= one[PIXELS]
            one[DEPTH] /= one[PIXELS]
    number = np.full(_MOST, -1, np.int64)
    valid = 0
    for c in range(_MOST):
        if clusters[c, PIXELS] >= FEWEST_PX and not _is_fringe(clusters, c):
            number[c] = valid
            clusters[valid] = clusters[c]
            valid += 1
    for n in range(len(owner)):
        if owner[n] >= 0:
            owner[n] = number[owner[n]]
    return valid


@compile_exact_kernel
def _is_fringe(clusters: F64, index: int) -> bool:
    """Whether a cluster is the background at the border of a nearer, larger one."""
    one = clusters[index]
    for c in range(_MOST):
        other = clusters[c]
        nearer = other[DEPTH] < one[DEPTH] - _CELL_M and other[PIXELS] > one[PIXELS]
        if (
            nearer
            and one[FIRST] >= other[FIRST] - _FRINGE_PX
            and one[LAST] <= other[LAST] + _FRINGE_PX
        ):
            return True
    return False
