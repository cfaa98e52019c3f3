"""Which standing things a user notices on the way: the solid cells of the street grid close to the route ahead."""

from __future__ import annotations

import numpy as np

from wcsim.types import F64, Route, StreetGrid

LOOK_AHEAD_M = 7.0
NEAR_WAY_M = 0.55  # what lies further from the line does not touch a chair that follows it
THIN_M = 0.3  # one point for each square of this size is enough


def obstacles_on_way(grid: StreetGrid, route: Route, progress_m: float) -> F64:
    """Points (n, 3) x, y, radius of solid things near the next metres of the route; n is 0 on a clear pavement."""
    ahead = (route.arc_m > progress_m - 1.0) & (route.arc_m < progress_m + LOOK_AHEAD_M)
    way = route.points_W_m[ahead]
    if not len(way) or float(grid.clearance_at(way).min()) > NEAR_WAY_M + 0.6:
        return np.zeros((0, 3))
    low, high = way.min(0) - NEAR_WAY_M, way.max(0) + NEAR_WAY_M
    (row0, row1), (col0, col1) = grid.cells(np.array([low, high]))
    rows, cols = np.nonzero(grid.clearance_dm[row0 : row1 + 1, col0 : col1 + 1] == 0)
    solid = np.c_[cols + col0 + 0.5, rows + row0 + 0.5] * grid.cell_m + grid.origin_W_m
    near = ((solid[:, None] - way[None]) ** 2).sum(-1).min(1) < NEAR_WAY_M**2 if len(solid) else np.zeros(0, bool)
    _, keep = np.unique(np.floor(solid[near] / THIN_M).astype(np.int64), axis=0, return_index=True)
    thin = solid[near][np.sort(keep)]
    return np.asarray(np.c_[thin, np.full(len(thin), 0.1)], np.float64)
