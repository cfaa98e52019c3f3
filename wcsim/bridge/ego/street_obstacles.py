"""Which standing things a user may notice: solid cells of the street grid close to the route.

A thing is what hangs together (a pole, a bench, the end of a wall). Its number stays the same while
the user passes, however much of it lies near the way at a time, so that the user notices it once or
not at all.
"""

from bisect import bisect_left

import numpy as np

from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F64, I32, Bool, Ground, Route

_LOOK_AHEAD_M = 8.0  # no user of wcsim's profiles notices a post from farther: 1.3 times 6 m
_LOOK_BACK_M = 1.0
_PIECE_M = 10.0  # of the way are searched at a time, once
_NEAR_WAY_M = 0.55  # what lies further from the line does not touch a chair that follows it
_AROUND_M = 1.5  # of the near part, looked at to see what hangs together
_THIN_M = 0.3  # one point for each square of this size is enough
_KEY_CELLS = 5  # things are known again by squares of so many cells
_NOTHING: F64 = np.zeros((0, 4))


class ObstacleWatch:
    """Standing things near the way, each under a number of its own."""

    def __init__(self, ground: Ground) -> None:
        self._ground = ground
        self._numbers: dict[tuple[int, int], int] = {}
        self._next = 0
        self._route: Route | None = None

    def on_way(self, route: Route, progress_m: float) -> F64:
        """Points (n, 4) x, y, radius, number of things near the next metres of the route.

        Nothing of it moves, so each piece of a route is searched once, when it is near.
        """
        if route is not self._route:
            self._route, self._found, self._arcs_m = route, _NOTHING, []
            self._searched_m = progress_m - _LOOK_BACK_M
        while self._searched_m < min(progress_m + _LOOK_AHEAD_M, float(route.arc_m[-1]) + 1e-6):
            arcs_m, found = self._search(route, self._searched_m, self._searched_m + _PIECE_M)
            self._searched_m += _PIECE_M
            self._arcs_m += arcs_m
            self._found = np.concatenate([self._found, found])
        first = bisect_left(self._arcs_m, progress_m - _LOOK_BACK_M)
        return self._found[first : bisect_left(self._arcs_m, progress_m + _LOOK_AHEAD_M)]

    def _search(self, route: Route, from_m: float, to_m: float) -> tuple[list[float], F64]:
        """How far along the route (n,), rising, the points (n, 4) near a piece of it are."""
        piece = (route.arc_m >= from_m) & (route.arc_m < to_m)
        way = route.points_W_m[piece]
        if not len(way):
            return [], _NOTHING
        grid = self._ground.around(0.5 * (way.min(axis=0) + way.max(axis=0)))
        # Most of a way is clear, which its clearance shows without any search.
        if float(grid.clearance_at(way).min()) > _NEAR_WAY_M + 0.6:
            return [], _NOTHING
        margin_m = _NEAR_WAY_M + _AROUND_M
        corners = np.array([way.min(0) - margin_m, way.max(0) + margin_m])
        (row0, row1), (col0, col1) = grid.cells(corners)
        solid = grid.clearance_dm[row0 : row1 + 1, col0 : col1 + 1] == 0
        rows, cols = np.nonzero(solid)
        if not len(rows):
            return [], _NOTHING
        # From W's own origin, so that numbers hold in all of W.
        first = np.rint(np.array(grid.origin_W_m) / grid.cell_m).astype(np.int64)
        numbers = self._numbered(solid, int(row0 + first[1]), int(col0 + first[0]))
        points = np.c_[cols + col0 + 0.5, rows + row0 + 0.5] * grid.cell_m + grid.origin_W_m
        gap_m = np.hypot(*np.moveaxis(points[:, None] - way[None], -1, 0))  # (n, way)
        near = gap_m.min(axis=1) < _NEAR_WAY_M
        points, things = points[near], numbers[rows[near], cols[near]]
        along_m = route.arc_m[piece][gap_m[near].argmin(axis=1)]
        # `unique` takes the first point of each square, so the choice depends on the raster alone.
        _, thin = np.unique(np.floor(points / _THIN_M).astype(np.int64), axis=0, return_index=True)
        # In the order of the way, as `on_way` bisects it; stable, so that ties stay in the order of
        # the squares.
        thin = thin[np.argsort(along_m[thin], kind="stable")]
        found = np.c_[points[thin], np.full(len(thin), 0.1), things[thin]]
        return along_m[thin].tolist(), np.asarray(found, np.float64)

    def _numbered(self, solid: Bool, row0: int, col0: int) -> F64:
        """The number of the thing in each solid cell, as an image; -1 where nothing stands."""
        labels = np.zeros(solid.shape, np.int32)
        count = _label_pieces(solid, labels)
        numbers = np.full(solid.shape, -1.0)
        for label in range(1, count):
            cells = np.argwhere(labels == label)
            # Coarse squares: a thing is known again by a part of it.
            squares = (cells + np.array([row0, col0])) // _KEY_CELLS
            keys = {(int(row), int(col)) for row, col in np.unique(squares, axis=0)}
            known = [self._numbers[key] for key in keys if key in self._numbers]
            # Parts that turn out to hang together take the smallest number: it is the older one.
            number = min(known, default=self._next)
            self._next += not known
            self._numbers.update(dict.fromkeys(keys, number))
            numbers[labels == label] = number
        return numbers


@compile_exact_kernel
def _label_pieces(solid: Bool, labels: I32) -> int:
    """Number what hangs together in an image, corners too, from 1 on; one more than the last.

    As OpenCV's connectedComponents, in its order (by squares of two cells), which a world would
    load for this alone.

    Args:
        solid: (rows, cols).
        labels: The same shape, all 0; the numbers are written into it.
    """
    rows, cols = solid.shape
    row_of, col_of = np.empty(rows * cols, np.int32), np.empty(rows * cols, np.int32)
    count = 1
    for square in range(((rows + 1) // 2) * ((cols + 1) // 2) * 4):
        row = 2 * (square // 4 // ((cols + 1) // 2)) + square % 4 // 2
        col = 2 * (square // 4 % ((cols + 1) // 2)) + square % 2
        if row < rows and col < cols and solid[row, col] and not labels[row, col]:
            labels[row, col] = count
            row_of[0], col_of[0], waiting = row, col, 1
            while waiting:
                waiting -= 1
                r, c = row_of[waiting], col_of[waiting]
                for near_r in range(max(0, r - 1), min(rows, r + 2)):
                    for near_c in range(max(0, c - 1), min(cols, c + 2)):
                        if solid[near_r, near_c] and not labels[near_r, near_c]:
                            labels[near_r, near_c] = count
                            row_of[waiting], col_of[waiting] = near_r, near_c
                            waiting += 1
            count += 1
    return count
