"""The street as rasters, drawn from the mesh's own triangles so that both always agree."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
import shapely
from shapely import Polygon

from wcsim.errors import TownError
from wcsim.jit import exact_kernel
from wcsim.towns.ground import Ground
from wcsim.types import F64, U8, ClassId, StreetGrid

CELL_M = 0.1
FAR_DM = 255
MAX_CELLS = 300_000_000  # three bytes each while a town is loaded, and more while it is built
_SHIFT = 4  # bits of sub-cell precision for cv2


def build_grid(ground: Ground, footprints: list[Polygon]) -> StreetGrid:
    """Ground height and class at the middle of each cell, and the distance to the nearest solid footprint.

    Raises TownError for a town too large to be held as one grid.
    """
    xy_m = ground.vertices_W_m[:, :2]
    origin_m = np.floor(xy_m.min(axis=0))
    cols, rows = (int(n) for n in np.ceil((xy_m.max(axis=0) - origin_m) / CELL_M))
    if rows * cols > MAX_CELLS:
        raise TownError(
            f"the town spans {cols * CELL_M / 1000:.1f} x {rows * CELL_M / 1000:.1f} km; expected at most "
            f"{MAX_CELLS * CELL_M**2 / 1e6:.0f} km2: clip it with netconvert --keep-edges.in-boundary"
        )
    height_cm = np.zeros((rows, cols), dtype=np.uint8)  # centimetres above z = 0
    ground_class = np.full((rows, cols), ClassId.VOID, dtype=np.uint8)
    triangles = ground.vertices_W_m[ground.faces].copy()
    triangles[:, :, :2] = (triangles[:, :, :2] - origin_m) / CELL_M - 0.5  # in cells; a cell's middle is an integer
    _fill(triangles, ground.face_class, height_cm, ground_class)
    return StreetGrid(
        origin_W_m=(float(origin_m[0]), float(origin_m[1])),
        cell_m=CELL_M,
        height_cm=height_cm,
        z_base_m=0.0,
        ground_class=ground_class,
        clearance_dm=_clearance_dm(footprints, origin_m, (rows, cols)),
    )


@exact_kernel
def _fill(triangles: F64, classes: U8, height_cm: U8, ground_class: U8) -> None:
    """Write every cell whose middle lies in a triangle (borders belong to the later one)."""
    rows, cols = height_cm.shape
    for t in range(triangles.shape[0]):
        ax, ay, az = triangles[t, 0]
        bx, by, bz = triangles[t, 1]
        cx, cy, cz = triangles[t, 2]
        twice = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if twice <= 0.0:
            continue
        gx = ((bz - az) * (cy - ay) - (cz - az) * (by - ay)) / twice
        gy = ((cz - az) * (bx - ax) - (bz - az) * (cx - ax)) / twice
        first = max(0, int(np.ceil(min(ay, by, cy))))
        last = min(rows - 1, int(np.floor(max(ay, by, cy))))
        for row in range(first, last + 1):
            low, high = 1e18, -1e18
            for k in range(3):
                px, py = triangles[t, k, 0], triangles[t, k, 1]
                qx, qy = triangles[t, (k + 1) % 3, 0], triangles[t, (k + 1) % 3, 1]
                if (py <= row <= qy) or (qy <= row <= py):
                    if py == qy:
                        low, high = min(low, px, qx), max(high, px, qx)
                    else:
                        x = px + (row - py) * (qx - px) / (qy - py)
                        low, high = min(low, x), max(high, x)
            for col in range(max(0, int(np.ceil(low))), min(cols - 1, int(np.floor(high))) + 1):
                z = az + gx * (col - ax) + gy * (row - ay)
                height_cm[row, col] = int(max(0.0, min(255.0, np.round(100.0 * z))))
                ground_class[row, col] = classes[t]


def _clearance_dm(footprints: list[Polygon], origin_m: F64, shape: tuple[int, int]) -> U8:
    """Distance (rows, cols) in whole decimetres, rounded down, from a cell's middle to something solid."""
    free = np.ones(shape, dtype=np.uint8)
    for footprint in footprints:
        rings = [footprint.exterior, *footprint.interiors]
        cells = [(shapely.get_coordinates(ring) - origin_m) / CELL_M - 0.5 for ring in rings]
        cv2.fillPoly(free, [np.rint(ring * (1 << _SHIFT)).astype(np.int32) for ring in cells], 0, shift=_SHIFT)
    if free.all():
        return np.full(shape, FAR_DM, dtype=np.uint8)
    far_cells = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_5)  # float32
    np.multiply(far_cells, np.float32(CELL_M * 10.0), out=far_cells)
    return cast(U8, np.minimum(far_cells, FAR_DM, out=far_cells).astype(np.uint8))
