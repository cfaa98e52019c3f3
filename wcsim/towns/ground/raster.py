"""A piece of the street as rasters, drawn from the mesh's own triangles so that both always agree."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
import shapely
from shapely import Polygon

from wcsim.core.jit import exact_kernel
from wcsim.towns.ground.tiles import CELL_M, Box
from wcsim.towns.ground.triangulation import GroundMesh
from wcsim.types import F64, U8, ClassId, Relief, StreetGrid

_FAR_DM = 255
_LOOK_M = 26.0  # solid things so far outside a piece still count for its clearances, which end at 25.5 m
_SHIFT = 4  # bits of sub-cell precision for cv2



class GridMaker:
    """Draws pieces of one town's raster; finds the triangles and footprints of a piece quickly."""

    def __init__(self, ground: GroundMesh, footprints: list[Polygon], relief: Relief) -> None:
        self._triangles = ground.vertices_W_m[ground.faces]  # (F, 3, 3), heights above the relief
        self._classes = ground.face_class
        self._low, self._high = self._triangles[:, :, :2].min(axis=1), self._triangles[:, :, :2].max(axis=1)
        self._footprints = footprints
        self._tree = shapely.STRtree(footprints)
        self._relief = relief

    def bounds(self) -> Box:
        """West, south, east, north of all ground, metres in W."""
        (west, south), (east, north) = self._low.min(axis=0), self._high.max(axis=0)
        return float(west), float(south), float(east), float(north)

    def piece(self, box: Box) -> StreetGrid:
        """The raster of a box with corners on whole cells: height, class and clearance at the middle of each cell."""
        origin_m = np.array(box[:2])
        cols, rows = (round((high - low) / CELL_M) for low, high in zip(box[:2], box[2:], strict=True))
        height_cm = np.zeros((rows, cols), dtype=np.uint8)
        ground_class = np.full((rows, cols), ClassId.VOID, dtype=np.uint8)
        near = ((self._low < box[2:]) & (self._high > box[:2])).all(axis=1)
        triangles = self._triangles[near]
        triangles[:, :, :2] = (triangles[:, :, :2] - origin_m) / CELL_M - 0.5  # in cells; a cell's middle is an integer
        _fill(triangles, self._classes[near], height_cm, ground_class)
        return StreetGrid(
            origin_W_m=(float(origin_m[0]), float(origin_m[1])),
            cell_m=CELL_M,
            height_cm=height_cm,
            ground_class=ground_class,
            clearance_dm=self._clearance_dm(box, (rows, cols)),
            relief=self._relief,
        )

    def _clearance_dm(self, box: Box, shape: tuple[int, int]) -> U8:
        """Distance (rows, cols) in whole decimetres, rounded down, from a cell's middle to something solid."""
        wide = (box[0] - _LOOK_M, box[1] - _LOOK_M, box[2] + _LOOK_M, box[3] + _LOOK_M)
        near = [self._footprints[i] for i in np.sort(self._tree.query(shapely.box(*wide)))]
        if not near:
            return np.full(shape, _FAR_DM, dtype=np.uint8)
        edge = round(_LOOK_M / CELL_M)
        free = np.ones((shape[0] + 2 * edge, shape[1] + 2 * edge), dtype=np.uint8)
        for footprint in near:
            rings = [footprint.exterior, *footprint.interiors]
            cells = [(shapely.get_coordinates(ring) - wide[:2]) / CELL_M - 0.5 for ring in rings]
            cv2.fillPoly(free, [np.rint(ring * (1 << _SHIFT)).astype(np.int32) for ring in cells], 0, shift=_SHIFT)
        if free.all():
            return np.full(shape, _FAR_DM, dtype=np.uint8)
        far_cells = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_5)[edge:-edge, edge:-edge]  # float32
        far_dm = np.minimum(far_cells * np.float32(CELL_M * 10.0), _FAR_DM)
        return cast(U8, far_dm.astype(np.uint8))


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
