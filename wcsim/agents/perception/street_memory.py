"""What a chair sees in its way and remembers: walls, people, kerbs, drops, and ground.

In the depth images of a tick the ground is a raster of the lowest and the highest point seen in
each cell, in the body frame. What counts is how the ground steps from a cell to the next, so a hill
is no obstacle, and neither height nor slope must be known well.

The memory is a raster of the odometric frame O that wraps around: a new place takes a cell over
once its old one is too far away. An obstacle is removed when ground is seen there instead, when the
chair has left it, or when it has driven so far since that its place is no longer sure. What was
seen once, and people who can walk off, stay for seconds.
"""

import math
from collections.abc import Iterable
from typing import Final

import numpy as np

from wcsim.agents.perception.depth_image import CameraView
from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F32, F64, I64, Bool

CELL_M: Final = 0.1
# Farther away rows of the image are farther apart than cells.
REACH_M: Final = 4.0
AXLE_ROW: Final = round(REACH_M / CELL_M)  # the first one ahead of the axle
ROWS: Final = 2 * AXLE_ROW  # ahead from -REACH_M
COLUMNS: Final = 2 * round(REACH_M / CELL_M)  # to the left from -REACH_M
# More than casters climb, and less than a kerb; the rounding of depth codes alone is 0.03.
STEP_M: Final = 0.06
RISE_PER_M: Final = 0.12  # a steep ramp
# How far apart neighbours may be: a kerb's edge hides some ground behind it.
GAP_CELLS: Final = 4
HEAD_M: Final = 1.6  # what hangs higher passes above
# A ray that goes so far below level ground has met no ground where it should be.
DROP_M: Final = 0.15
DROP_PER_M: Final = 0.06
# An obstacle is forgotten so far from the chair, or after so long a way or time.
FORGET_M: Final = 4.5
KEEP_WAY_M: Final = 15.0
KEEP_BRIEFLY_S: Final = 3.0  # what was seen once, and people who can walk off
# So far around a chair that drives ahead, or has just started, the ground is known.
AROUND_M: Final = 0.25
_MOST_POINTS: Final = 1024
_SIDE: Final = 96  # cells of the raster each way: more than twice FORGET_M
# Times that an obstacle was seen, at most; it must be contradicted as often.
_SURE: Final = 3
# Columns of a cell, of its place, and values of its ground: near the chair's own footprint, or
# seen or stood on.
_KEY_X, _KEY_Y, _EVIDENCE, _TICK, _GROUND = range(5)
_X, _Y, _WAY = range(3)
_AROUND, _SEEN = 1, 2


class StepObstacleDetector:
    """Buffers for the cameras of one chair; `obstacles` writes into them."""

    def __init__(self) -> None:
        self.low_m: F32 = np.empty((ROWS, COLUMNS), np.float32)
        self.high_m = np.empty_like(self.low_m)
        self.points_B_m = np.empty((_MOST_POINTS, 2))

    def obstacles(self, views: Iterable[CameraView], up_B: F64, box_B_m: F64) -> F64:
        """Find what is in the way.

        Args:
            views: What the cameras show now.
            up_B: (3,) the direction up in B, from the tilt sensor.
            box_B_m: (3,) rear, front and half the width of the chair in B.

        Returns:
            (n, 2) its middles in B; a view of a buffer, valid until the next call.
        """
        self.low_m[:] = np.inf
        self.high_m[:] = -np.inf
        dropped, drops = np.zeros(self.low_m.shape, np.bool_), 0
        for view in views:
            drops = _fill_raster(
                view.depth_m,
                view.rays,
                view.eye_B_m,
                view.near_m,
                view.far_m,
                up_B,
                self.low_m,
                self.high_m,
                dropped,
                self.points_B_m,
                drops,
            )
        count = _add_steps(self.low_m, self.high_m, box_B_m, self.points_B_m, drops)
        return self.points_B_m[:count]


@compile_exact_kernel
def _fill_raster(
    depth_m: F32,
    rays: F32,
    eye: F64,
    nearest_m: float,
    farthest_m: float,
    up: F64,
    low: F32,
    high: F32,
    dropped: Bool,
    points: F64,
    count: int,
) -> int:
    """Write a picture into the raster, and a point for each cell where rays fall below the ground.

    Returns:
        How many points there are; `count` were there before.
    """
    # From the nearest ground on, which is at the bottom of the image.
    for i in range(len(depth_m) - 1, -1, -1):
        depth = depth_m[i]
        if not depth > nearest_m:
            continue
        x = eye[0] + depth * rays[i, 0]
        y = eye[1] + depth * rays[i, 1]
        z = eye[2] + depth * rays[i, 2]
        level = up[0] * x + up[1] * y + up[2] * z
        falls = max(z, level) < -DROP_M - DROP_PER_M * math.hypot(x, y)
        if falls:
            # A drop starts where the ray should have met the ground.
            fall = eye[2] / max(eye[2] - z, 1e-6)
            x, y = eye[0] + fall * (x - eye[0]), eye[1] + fall * (y - eye[1])
        row = math.floor(x / CELL_M) + AXLE_ROW
        column = math.floor((y + REACH_M) / CELL_M)
        if not (0 <= row < ROWS and 0 <= column < COLUMNS):
            continue
        if falls:
            if not dropped[row, column] and count < len(points):
                dropped[row, column] = True
                points[count, 0], points[count, 1] = x, y
                count += 1
        elif depth < farthest_m and min(z, level) < HEAD_M:
            low[row, column] = min(low[row, column], z)
            high[row, column] = max(high[row, column], z)
    return count


@compile_exact_kernel
def _add_steps(seen: F32, high: F32, box: F64, points: F64, count: int) -> int:
    """Write cells that hold a step, and steps between cells; returns the number of points."""
    # Between the unseen ground below the chair and the first ground that it sees may lie a step.
    low, half = seen.copy(), round(box[2] / CELL_M)
    rear = AXLE_ROW + round((box[0] - AROUND_M) / CELL_M)
    front = AXLE_ROW + round((box[1] + AROUND_M) / CELL_M)
    under = low[rear:front, COLUMNS // 2 - half : COLUMNS // 2 + half]
    under[:] = np.where(under < np.inf, under, 0.0)
    for row in range(ROWS):
        for column in range(COLUMNS):
            if not low[row, column] < np.inf or count >= len(points):
                continue
            if high[row, column] - low[row, column] > STEP_M:
                points[count, 0] = (row - AXLE_ROW + 0.5) * CELL_M
                points[count, 1] = (column + 0.5) * CELL_M - REACH_M
                count += 1
                continue
            for way in range(4):
                # Half of the directions, so that each pair of cells is compared once.
                count = _add_step(
                    low, row, column, int(way != 1), (0, 1, 1, -1)[way], points, count
                )
    return count


@compile_exact_kernel
def _add_step(
    low: F32, row: int, column: int, down: int, right: int, points: F64, count: int
) -> int:
    """Write a step between a cell and the next known one; it is at the upper cell's border."""
    for gap in range(1, GAP_CELLS + 1):
        r, c = row + gap * down, column + gap * right
        if not (0 <= r < ROWS and 0 <= c < COLUMNS):
            return count
        if not low[r, c] < np.inf:
            continue
        rise = low[r, c] - low[row, column]
        if abs(rise) > STEP_M + RISE_PER_M * CELL_M * gap * math.hypot(down, right) and count < len(
            points
        ):
            from_here = gap - 0.5 if rise > 0.0 else 0.5
            points[count, 0] = (row - AXLE_ROW + 0.5 + from_here * down) * CELL_M
            points[count, 1] = (column + 0.5 + from_here * right) * CELL_M - REACH_M
            count += 1
        return count
    return count


class StreetMemoryGrid:
    """The raster of one chair.

    Args:
        tick_s: Time between two updates.
        box_B_m: (3,) rear, front and half the width of the chair in B.
    """

    def __init__(self, tick_s: float, box_B_m: F64) -> None:
        self._brief_ticks = round(KEEP_BRIEFLY_S / tick_s)
        self._box_B_m = box_B_m
        self.cells = np.zeros((_SIDE, _SIDE, 5), np.int64)
        self._places = np.zeros((_SIDE, _SIDE, 3))
        self._found_B_m = np.empty((_SIDE * _SIDE, 2))
        self.forget()

    def forget(self) -> None:
        """Know nothing."""
        self.cells[:] = 0
        self._tick = 0

    def update(
        self, points_B_m: F64, brief: Bool, low_m: F32, pose_O: F64, way_m: float, *, ahead: bool
    ) -> None:
        """Take what is seen in a tick.

        Args:
            points_B_m: (n, 2) middles of what is in the way.
            brief: (n,) which of them can walk off.
            low_m: (ROWS, COLUMNS) the raster of `StepObstacleDetector`, finite where something was
                measured.
            pose_O: (3,) of the chair.
            way_m: Driven so far.
            ahead: Whether it drives ahead now.
        """
        self._tick += 1
        _write_obstacles(self.cells, self._places, points_B_m, brief, pose_O, self._tick, way_m)
        _write_ground(self.cells, self._places, low_m, pose_O, self._tick)
        around_m = AROUND_M if ahead or self._tick == 1 else 0.0
        _write_footprint(self.cells, self._box_B_m, around_m, pose_O)

    def points_B_m(self, pose_O: F64, way_m: float) -> F64:
        """What is in the way (n, 2), in B; a view of a buffer, valid until the next call."""
        count = _collect_obstacles(
            self.cells, self._places, pose_O, self._tick, way_m, self._brief_ticks, self._found_B_m
        )
        return self._found_B_m[:count]


@compile_exact_kernel
def is_free_ground(cells: I64, x_O_m: float, y_O_m: float) -> bool:
    """Whether a place in O is surely ground: seen or stood on, and without an obstacle."""
    ix, iy = math.floor(x_O_m / CELL_M), math.floor(y_O_m / CELL_M)
    cell = cells[ix % _SIDE, iy % _SIDE]
    return bool(
        cell[_KEY_X] == ix
        and cell[_KEY_Y] == iy
        and cell[_GROUND] == _SEEN
        and cell[_EVIDENCE] == 0
    )


@compile_exact_kernel
def is_known_place(cells: I64, x_O_m: float, y_O_m: float) -> bool:
    """Whether a place in O was seen, stood on or stood beside, whatever is there."""
    ix, iy = math.floor(x_O_m / CELL_M), math.floor(y_O_m / CELL_M)
    cell = cells[ix % _SIDE, iy % _SIDE]
    return bool(
        cell[_KEY_X] == ix and cell[_KEY_Y] == iy and (cell[_GROUND] > 0 or cell[_EVIDENCE] > 0)
    )


@compile_exact_kernel
def _claim_cell(cells: I64, x_O_m: float, y_O_m: float) -> tuple[int, int]:
    """The cell of a place; it is emptied first if it was another place's."""
    ix, iy = math.floor(x_O_m / CELL_M), math.floor(y_O_m / CELL_M)
    i, j = ix % _SIDE, iy % _SIDE
    if cells[i, j, _KEY_X] != ix or cells[i, j, _KEY_Y] != iy:
        cells[i, j, _KEY_X], cells[i, j, _KEY_Y] = ix, iy
        cells[i, j, _EVIDENCE] = cells[i, j, _TICK] = cells[i, j, _GROUND] = 0
    return i, j


@compile_exact_kernel
def _write_obstacles(
    cells: I64, places: F64, points: F64, brief: Bool, pose: F64, tick: int, way_m: float
) -> None:
    """Put obstacles into their cells; what can walk off is never sure."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for n in range(len(points)):
        x = pose[0] + cos * points[n, 0] - sin * points[n, 1]
        y = pose[1] + sin * points[n, 0] + cos * points[n, 1]
        i, j = _claim_cell(cells, x, y)
        if cells[i, j, _TICK] != tick:
            cells[i, j, _TICK] = tick
            cells[i, j, _EVIDENCE] = 1 if brief[n] else min(cells[i, j, _EVIDENCE] + 1, _SURE)
        places[i, j, _X], places[i, j, _Y], places[i, j, _WAY] = x, y, way_m


@compile_exact_kernel
def _write_ground(cells: I64, places: F64, low: F32, pose: F64, tick: int) -> None:
    """Where ground is measured, mark it, and take evidence from an older obstacle there."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for i in range(_SIDE):
        for j in range(_SIDE):
            if cells[i, j, _EVIDENCE] > 0 and cells[i, j, _TICK] != tick:
                dx, dy = places[i, j, _X] - pose[0], places[i, j, _Y] - pose[1]
                row = math.floor((cos * dx + sin * dy) / CELL_M) + AXLE_ROW
                column = math.floor((cos * dy - sin * dx + REACH_M) / CELL_M)
                if 0 <= row < ROWS and 0 <= column < COLUMNS and low[row, column] < np.inf:
                    cells[i, j, _EVIDENCE] -= _would_show(low, row, column)
    for row in range(ROWS):
        for column in range(COLUMNS):
            if low[row, column] < np.inf:
                bx, by = (row - AXLE_ROW + 0.5) * CELL_M, (column + 0.5) * CELL_M - REACH_M
                x, y = pose[0] + cos * bx - sin * by, pose[1] + sin * bx + cos * by
                i, j = _claim_cell(cells, x, y)
                cells[i, j, _GROUND] = _SEEN


@compile_exact_kernel
def _would_show(low: F32, row: int, column: int) -> bool:
    """Whether a step at a cell would show: ground before it, towards the chair, was measured."""
    along, aside = row - AXLE_ROW, column - COLUMNS // 2
    away = max(abs(along), abs(aside), 1)
    for nearer in range(2, GAP_CELLS + 2):
        share = max(0.0, 1.0 - nearer / away)
        if low[AXLE_ROW + round(share * along), COLUMNS // 2 + round(share * aside)] < np.inf:
            return True
    return False


@compile_exact_kernel
def _write_footprint(cells: I64, box: F64, around_m: float, pose: F64) -> None:
    """Mark the ground under the chair, and so far around it."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    rear, front, half = box[0] - around_m, box[1] + around_m, box[2] + around_m
    # Points this close leave out no cell, however the chair is turned.
    along = math.ceil((front - rear) / (0.7 * CELL_M))
    across = math.ceil(2.0 * half / (0.7 * CELL_M))
    for a in range(along + 1):
        bx = rear + (front - rear) * a / along
        for b in range(across + 1):
            by = half * (2.0 * b / across - 1.0)
            x, y = pose[0] + cos * bx - sin * by, pose[1] + sin * bx + cos * by
            i, j = _claim_cell(cells, x, y)
            under = box[0] <= bx <= box[1] and abs(by) <= box[2]
            cells[i, j, _GROUND] = max(cells[i, j, _GROUND], _SEEN if under else _AROUND)


@compile_exact_kernel
def _collect_obstacles(
    cells: I64, places: F64, pose: F64, tick: int, way_m: float, brief_ticks: int, found: F64
) -> int:
    """Write the obstacles into `found`, in B; forget those too far away, too old or far back."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    count = 0
    for i in range(_SIDE):
        for j in range(_SIDE):
            if cells[i, j, _EVIDENCE] == 0:
                continue
            dx, dy = places[i, j, _X] - pose[0], places[i, j, _Y] - pose[1]
            old = cells[i, j, _EVIDENCE] == 1 and tick - cells[i, j, _TICK] > brief_ticks
            if (
                old
                or way_m - places[i, j, _WAY] > KEEP_WAY_M
                or dx * dx + dy * dy > FORGET_M * FORGET_M
            ):
                cells[i, j, _EVIDENCE] = 0
                continue
            found[count, 0], found[count, 1] = cos * dx + sin * dy, cos * dy - sin * dx
            count += 1
    return count
