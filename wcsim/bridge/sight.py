"""Which standing things a user may notice on the way: the solid cells of the street grid close to the route ahead.

A thing is what hangs together (a pole, a bench, the end of a wall). It keeps its number while the user passes, however
much of it lies near the way at a time, so that the user notices it once or not at all.
"""

from __future__ import annotations

import cv2
import numpy as np

from wcsim.types import F64, Bool, Ground, Route

LOOK_AHEAD_M = 7.0
NEAR_WAY_M = 0.55  # what lies further from the line does not touch a chair that follows it
AROUND_M = 1.5  # of the near part, looked at to see what hangs together
THIN_M = 0.3  # one point for each square of this size is enough
KEY_CELLS = 5  # things are known again by squares of so many cells


class ObstacleWatch:
    """Standing things near the way, each under a number of its own."""

    def __init__(self, ground: Ground) -> None:
        self._ground = ground
        self._numbers: dict[tuple[int, int], int] = {}
        self._next = 0

    def on_way(self, route: Route, progress_m: float) -> F64:
        """Points (n, 4) x, y, radius, number of things near the next metres of the route; none on a clear way."""
        ahead = (route.arc_m > progress_m - 1.0) & (route.arc_m < progress_m + LOOK_AHEAD_M)
        way = route.points_W_m[ahead]
        if not len(way):
            return np.zeros((0, 4))
        grid = self._ground.around(0.5 * (way.min(axis=0) + way.max(axis=0)))
        if float(grid.clearance_at(way).min()) > NEAR_WAY_M + 0.6:
            return np.zeros((0, 4))
        margin_m = NEAR_WAY_M + AROUND_M
        (row0, row1), (col0, col1) = grid.cells(np.array([way.min(0) - margin_m, way.max(0) + margin_m]))
        solid = grid.clearance_dm[row0 : row1 + 1, col0 : col1 + 1] == 0
        first = np.rint(np.array(grid.origin_W_m) / grid.cell_m).astype(np.int64)  # so that numbers hold in all of W
        numbers = self._numbered(solid, int(row0 + first[1]), int(col0 + first[0]))
        rows, cols = np.nonzero(solid)
        points = np.c_[cols + col0 + 0.5, rows + row0 + 0.5] * grid.cell_m + grid.origin_W_m
        near = ((points[:, None] - way[None]) ** 2).sum(-1).min(1) < NEAR_WAY_M**2 if len(points) else np.zeros(0, bool)
        points, things = points[near], numbers[rows[near], cols[near]]
        _, keep = np.unique(np.floor(points / THIN_M).astype(np.int64), axis=0, return_index=True)
        keep = np.sort(keep)
        return np.asarray(np.c_[points[keep], np.full(len(keep), 0.1), things[keep]], np.float64)

    def _numbered(self, solid: Bool, row0: int, col0: int) -> F64:
        """The number of the thing that each solid cell belongs to, as an image; -1 where nothing stands."""
        count, labels = cv2.connectedComponents(solid.astype(np.uint8))
        numbers = np.full(solid.shape, -1.0)
        for label in range(1, count):
            cells = np.argwhere(labels == label)
            squares = (cells + np.array([row0, col0])) // KEY_CELLS
            keys = {(int(row), int(col)) for row, col in np.unique(squares, axis=0)}
            known = [self._numbers[key] for key in keys if key in self._numbers]
            number = min(known, default=self._next)
            self._next += not known
            self._numbers.update(dict.fromkeys(keys, number))
            numbers[labels == label] = number
        return numbers
