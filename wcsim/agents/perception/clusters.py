"""Who could move: the pixels of people, riders and vehicles, put together by where they are on the ground."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.ndimage import label

from wcsim.core.jit import exact_kernel
from wcsim.types import F32, F64, I64, U8, Bool, ClassId

CELL_M = 0.2
AHEAD_M, ASIDE_M = 12.0, 8.0  # how far movers are looked for
LOW_M, HIGH_M = 0.15, 2.2  # above the ground: what a mover shows between them counts
_ROWS, _COLUMNS = round(AHEAD_M / CELL_M), 2 * round(ASIDE_M / CELL_M)
FEWEST_PX = 4  # less is noise
_FRINGE_PX = 3  # beside a mover, its class is painted on what is behind it
MOST = 24  # movers at once
_MOST_CELLS = 1024
_WALK: Final = (ClassId.PERSON, ClassId.RIDER, ClassId.BICYCLE, ClassId.MOTORCYCLE)
_DRIVE: Final = (ClassId.CAR, ClassId.TRUCK, ClassId.BUS, ClassId.TRAIN)
STANDS, WALKS, DRIVES = range(3)
# columns of a cluster (m, 11): middle and extent in O; pixels, those of walkers; first and last column of the picture;
# mean depth
X, Y, LEAST_X, MOST_X, LEAST_Y, MOST_Y, PIXELS, WALKERS, FIRST, LAST, DEPTH = range(11)


def kinds() -> U8:
    """Table (256,) uint8 from a pixel's class to STANDS, WALKS or DRIVES."""
    table = np.full(256, STANDS, np.uint8)
    table[list(_WALK)] = WALKS
    table[list(_DRIVE)] = DRIVES
    return table


def find_clusters(
    kind: U8, depth_m: F32, rays: F32, eye: F64, far_m: float, up: F64, pose_O: F64
) -> tuple[F64, F64, I64]:
    """Group pixels that could move.

    Args:
        kind: (H, W) STANDS, WALKS or DRIVES.
        depth_m: (H * W,) along the optical axis.
        rays: (H * W, 3) directions in B per metre of depth.
        eye: (3,) where the camera is, in B.
        far_m: Depths from here on are no measurement.
        up: (3,) the direction up in B.
        pose_O: (3,) of the chair.

    Returns:
        The clusters (m, 11), see the column names; the middles of the cells that are taken (k, 2) in B; and whose they
        are (k,), -1 for nobody's.
    """
    cells, points = np.full((_ROWS, _COLUMNS), -1, np.int64), np.empty((_MOST_CELLS, 2))
    count = _gather(kind.reshape(-1), depth_m, rays, eye, far_m, up, cells, points)
    # Touching cells have one owner; owners are numbered as their first cells are, and those beyond MOST left out.
    taken, owner = cells >= 0, np.empty(count, np.int64)
    owner[cells[taken]] = label(taken, np.ones((3, 3)))[0][taken]
    _, first, whose = np.unique(owner, return_index=True, return_inverse=True)
    owner = np.argsort(np.argsort(first))[whose]
    owner[owner >= MOST] = -1
    clusters = np.zeros((MOST, 11))
    kept = _measure(
        kind.reshape(-1),
        kind.shape[1],
        depth_m,
        rays,
        eye,
        far_m,
        up,
        cells,
        pose_O,
        owner,
        clusters,
    )
    return clusters[:kept], points[:count], owner


@exact_kernel
def _cell(depth: float, ray: F32, eye: F64, far_m: float, up: F64) -> tuple[int, int, float, float]:
    """Row and column of a pixel, -1 for none, and where it is in B."""
    if not 0.0 < depth < far_m:
        return -1, -1, 0.0, 0.0
    x, y, z = eye[0] + depth * ray[0], eye[1] + depth * ray[1], eye[2] + depth * ray[2]
    height = max(z, up[0] * x + up[1] * y + up[2] * z)
    row, column = math.floor(x / CELL_M), math.floor((y + ASIDE_M) / CELL_M)
    if not (LOW_M < height < HIGH_M and 0 <= row < _ROWS and 0 <= column < _COLUMNS):
        return -1, -1, 0.0, 0.0
    return row, column, x, y


@exact_kernel
def _gather(
    kind: U8, depth_m: F32, rays: F32, eye: F64, far_m: float, up: F64, cells: I64, points: F64
) -> int:
    """Number the cells in which there are pixels that could move; returns how many."""
    count = 0
    for n in range(len(kind)):
        if kind[n] == STANDS or count >= len(points):
            continue
        row, column, _, _ = _cell(depth_m[n], rays[n], eye, far_m, up)
        if row >= 0 and cells[row, column] < 0:
            cells[row, column] = count
            points[count, 0] = (row + 0.5) * CELL_M
            points[count, 1] = (column + 0.5) * CELL_M - ASIDE_M
            count += 1
    return count


@exact_kernel
def _measure(
    kind: U8, width: int, depth_m: F32, rays: F32, eye: F64, far_m: float, up: F64, cells: I64, pose: F64,
    owner: I64, clusters: F64,
) -> int:  # fmt: skip
    """Add up the pixels of each cluster, and move those that are kept to the front; returns how many."""
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
    number = np.full(MOST, -1, np.int64)
    kept = 0
    for c in range(MOST):
        if clusters[c, PIXELS] >= FEWEST_PX and not _is_fringe(clusters, c):
            number[c] = kept
            clusters[kept] = clusters[c]
            kept += 1
    for n in range(len(owner)):
        if owner[n] >= 0:
            owner[n] = number[owner[n]]
    return kept


@exact_kernel
def _is_fringe(clusters: F64, index: int) -> bool:
    """Whether a cluster is what is seen behind the border of a nearer, larger one."""
    one = clusters[index]
    for c in range(MOST):
        other = clusters[c]
        nearer = other[DEPTH] < one[DEPTH] - CELL_M and other[PIXELS] > one[PIXELS]
        if (
            nearer
            and one[FIRST] >= other[FIRST] - _FRINGE_PX
            and one[LAST] <= other[LAST] + _FRINGE_PX
        ):
            return True
    return False


def beside_movers(points_B_m: F64, cells_B_m: F64) -> Bool:
    """(n,) which of the points belong to a cell of `cells_B_m` (k, 2)."""
    near = np.zeros(len(points_B_m), np.bool_)
    _mark_near(points_B_m, cells_B_m, near)
    return near


@exact_kernel
def _mark_near(points: F64, cells: F64, near: Bool) -> None:
    for n in range(len(points)):
        for k in range(len(cells)):
            if (
                abs(points[n, 0] - cells[k, 0]) < 1.5 * CELL_M
                and abs(points[n, 1] - cells[k, 1]) < 1.5 * CELL_M
            ):
                near[n] = True
                break
