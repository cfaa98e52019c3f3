"""What a chair sees in its way, and remembers of the street: walls, people, kerbs, drops, and ground it has seen.

In one depth image the ground ahead is a raster of the lowest and the highest point seen in each cell, in the body
frame. What counts is how the ground steps from a cell to the next, so a hill is no obstacle, and neither height nor
slope must be known well.

The memory is a raster of the odometric frame O that goes round: a cell is taken over by a new place once its old one is
too far away. What was seen goes when the ground is seen there instead, when the chair has left it, or when it has
driven so far since that its place is no longer sure. What was seen once, and whoever can walk off, is kept for seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from wcsim.core.jit import exact_kernel
from wcsim.types import F32, F64, I64, Bool

CELL_M = 0.1
REACH_M = 4.0  # beyond, rows of the image are farther apart than cells
ROWS, COLUMNS = (
    round(REACH_M / CELL_M),
    2 * round(REACH_M / CELL_M),
)  # ahead from the axle, and left of -REACH_M
STEP_M = 0.06  # more than casters climb, and less than a kerb; depth codes alone give 0.03
RISE_PER_M = 0.12  # a steep ramp
GAP_CELLS = 4  # how far apart neighbours may be: behind a kerb's edge, some ground is hidden
HEAD_M = 1.6  # what hangs higher passes above
DROP_M, DROP_PER_M = (
    0.15,
    0.06,
)  # rays that go so far below level ground have met no ground where it should be
_MOST_POINTS = 1024
FORGET_M = 4.5  # away from the chair
KEEP_WAY_M = 15.0  # driven since it was seen
KEEP_BRIEFLY_S = 3.0  # what was seen once, and whoever can walk off
AROUND_M = 0.25  # around the footprint of a chair that drives ahead, or has just begun, the ground is known
_SIDE = 96  # cells of the raster each way: more than twice FORGET_M
_SURE = 3  # times that something was seen, at most; it must be contradicted as often
_KEY_X, _KEY_Y, _EVIDENCE, _TICK, _GROUND = range(5)
_X, _Y, _WAY = range(3)
_AROUND, _SEEN = 1, 2  # ground near the chair's own footprint, and ground that was seen or stood on


@dataclass(frozen=True, slots=True)
class StepMap:
    """Buffers for one camera; `obstacles` writes into them."""

    low_m: F32 = field(default_factory=lambda: np.empty((ROWS, COLUMNS), np.float32))
    high_m: F32 = field(default_factory=lambda: np.empty((ROWS, COLUMNS), np.float32))
    points_B_m: F64 = field(default_factory=lambda: np.empty((_MOST_POINTS, 2)))

    def obstacles(
        self,
        depth_m: F32,
        rays: F32,
        eye_B_m: F64,
        span_m: tuple[float, float],
        up_B: F64,
        box_B_m: F64,
    ) -> F64:
        """Middles of what is in the way.

        Args:
            depth_m: (H * W,) along the optical axis.
            rays: (H * W, 3) directions in B per metre of depth, see `viewing_rays`.
            eye_B_m: (3,) where the camera is.
            span_m: Depths outside it (nearest, farthest) are no measurement.
            up_B: (3,) the direction up in B, from the tilt sensor.
            box_B_m: (3,) rear, front and half the width of the chair in B.

        Returns:
            (n, 2) x forward, y left in B; a view of a buffer, valid until the next call.
        """
        drops = _fill(
            depth_m,
            rays,
            eye_B_m,
            span_m[0],
            span_m[1],
            up_B,
            self.low_m,
            self.high_m,
            self.points_B_m,
        )
        return self.points_B_m[: _steps(self.low_m, self.high_m, box_B_m, self.points_B_m, drops)]


@exact_kernel
def _fill(
    depth_m: F32,
    rays: F32,
    eye: F64,
    nearest_m: float,
    farthest_m: float,
    up: F64,
    low: F32,
    high: F32,
    points: F64,
) -> int:
    """Make the raster; returns how many points were written where a ray has fallen below the ground."""
    low[:] = np.inf
    high[:] = -np.inf
    dropped = np.zeros(low.shape, np.bool_)
    count = 0
    for i in range(len(depth_m) - 1, -1, -1):  # from the nearest ground on
        depth = depth_m[i]
        if not depth > nearest_m:
            continue
        x, y, z = (
            eye[0] + depth * rays[i, 0],
            eye[1] + depth * rays[i, 1],
            eye[2] + depth * rays[i, 2],
        )
        level = up[0] * x + up[1] * y + up[2] * z
        away = math.hypot(x, y)
        if max(z, level) < -DROP_M - DROP_PER_M * away:
            fall = eye[2] / max(eye[2] - z, 1e-6)  # where it should have met the ground
            x, y = eye[0] + fall * (x - eye[0]), eye[1] + fall * (y - eye[1])
            row, column = math.floor(x / CELL_M), math.floor((y + REACH_M) / CELL_M)
            if (
                0 <= row < ROWS
                and 0 <= column < COLUMNS
                and not dropped[row, column]
                and count < len(points)
            ):
                dropped[row, column] = True
                points[count, 0], points[count, 1] = x, y
                count += 1
            continue
        row, column = math.floor(x / CELL_M), math.floor((y + REACH_M) / CELL_M)
        if (
            depth < farthest_m
            and 0 <= row < ROWS
            and 0 <= column < COLUMNS
            and min(z, level) < HEAD_M
        ):
            low[row, column] = min(low[row, column], z)
            high[row, column] = max(high[row, column], z)
    return count


@exact_kernel
def _steps(seen: F32, high: F32, box: F64, points: F64, count: int) -> int:
    """Add the cells that hold a step, and the edges between cells that are one; returns the number of points."""
    # The chair stands on ground that it does not see: between that and the first that it sees may lie a step.
    low, half = seen.copy(), round(box[2] / CELL_M)
    under = low[: round((box[1] + AROUND_M) / CELL_M), COLUMNS // 2 - half : COLUMNS // 2 + half]
    under[:] = np.where(under < np.inf, under, 0.0)
    for row in range(ROWS):
        for column in range(COLUMNS):
            if not low[row, column] < np.inf or count >= len(points):
                continue
            if high[row, column] - low[row, column] > STEP_M:
                points[count, 0] = (row + 0.5) * CELL_M
                points[count, 1] = (column + 0.5) * CELL_M - REACH_M
                count += 1
                continue
            for way in range(4):
                count = _edge(low, row, column, int(way != 1), (0, 1, 1, -1)[way], points, count)
    return count


@exact_kernel
def _edge(low: F32, row: int, column: int, down: int, right: int, points: F64, count: int) -> int:
    """Look for a step between a cell and the next one known in a direction; its place is the upper cell's border."""
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
            points[count, 0] = (row + 0.5 + from_here * down) * CELL_M
            points[count, 1] = (column + 0.5 + from_here * right) * CELL_M - REACH_M
            count += 1
        return count
    return count


class StreetMemory:
    """The raster of one chair.

    Args:
        tick_s: Time between two looks.
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

    def see(
        self, points_B_m: F64, brief: Bool, low_m: F32, pose_O: F64, way_m: float, *, ahead: bool
    ) -> None:
        """Take in what is seen in a tick.

        Args:
            points_B_m: (n, 2) middles of what is in the way.
            brief: (n,) which of them can walk off.
            low_m: (ROWS, COLUMNS) where something was measured: the raster of `StepMap`.
            pose_O: (3,) of the chair.
            way_m: That it has driven so far.
            ahead: Whether it drives ahead now.
        """
        self._tick += 1
        _note(self.cells, self._places, points_B_m, brief, pose_O, self._tick, way_m)
        _contradict(self.cells, self._places, low_m, pose_O, self._tick)
        _stand(self.cells, self._box_B_m, AROUND_M if ahead or self._tick == 1 else 0.0, pose_O)

    def points_B_m(self, pose_O: F64, way_m: float) -> F64:
        """What is in the way (n, 2), in B; a view of a buffer, valid until the next call."""
        count = _collect(
            self.cells, self._places, pose_O, self._tick, way_m, self._brief_ticks, self._found_B_m
        )
        return self._found_B_m[:count]


@exact_kernel
def is_ground(cells: I64, x_O_m: float, y_O_m: float) -> bool:
    """Whether a place in O is surely ground: seen or stood on, with nothing in the way."""
    ix, iy = math.floor(x_O_m / CELL_M), math.floor(y_O_m / CELL_M)
    cell = cells[ix % _SIDE, iy % _SIDE]
    return bool(
        cell[_KEY_X] == ix
        and cell[_KEY_Y] == iy
        and cell[_GROUND] == _SEEN
        and cell[_EVIDENCE] == 0
    )


@exact_kernel
def is_known(cells: I64, x_O_m: float, y_O_m: float) -> bool:
    """Whether a place in O was seen, stood on or stood beside, whatever is there."""
    ix, iy = math.floor(x_O_m / CELL_M), math.floor(y_O_m / CELL_M)
    cell = cells[ix % _SIDE, iy % _SIDE]
    return bool(
        cell[_KEY_X] == ix and cell[_KEY_Y] == iy and (cell[_GROUND] > 0 or cell[_EVIDENCE] > 0)
    )


@exact_kernel
def _claim(cells: I64, x_O_m: float, y_O_m: float) -> tuple[int, int]:
    """The cell of a place, emptied when it was another place's."""
    ix, iy = math.floor(x_O_m / CELL_M), math.floor(y_O_m / CELL_M)
    i, j = ix % _SIDE, iy % _SIDE
    if cells[i, j, _KEY_X] != ix or cells[i, j, _KEY_Y] != iy:
        cells[i, j, _KEY_X], cells[i, j, _KEY_Y] = ix, iy
        cells[i, j, _EVIDENCE] = cells[i, j, _TICK] = cells[i, j, _GROUND] = 0
    return i, j


@exact_kernel
def _note(
    cells: I64, places: F64, points: F64, brief: Bool, pose: F64, tick: int, way_m: float
) -> None:
    """Put what is in the way into its cells; what can walk off is never sure."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for n in range(len(points)):
        x = pose[0] + cos * points[n, 0] - sin * points[n, 1]
        y = pose[1] + sin * points[n, 0] + cos * points[n, 1]
        i, j = _claim(cells, x, y)
        if cells[i, j, _TICK] != tick:
            cells[i, j, _TICK] = tick
            cells[i, j, _EVIDENCE] = 1 if brief[n] else min(cells[i, j, _EVIDENCE] + 1, _SURE)
        places[i, j, _X], places[i, j, _Y], places[i, j, _WAY] = x, y, way_m


@exact_kernel
def _contradict(cells: I64, places: F64, low: F32, pose: F64, tick: int) -> None:
    """Where something was measured that is not in the way there is ground, and what was there counts for less."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for i in range(_SIDE):
        for j in range(_SIDE):
            if cells[i, j, _EVIDENCE] > 0 and cells[i, j, _TICK] != tick:
                dx, dy = places[i, j, _X] - pose[0], places[i, j, _Y] - pose[1]
                row = math.floor((cos * dx + sin * dy) / CELL_M)
                column = math.floor((cos * dy - sin * dx + REACH_M) / CELL_M)
                if 0 <= row < ROWS and 0 <= column < COLUMNS and low[row, column] < np.inf:
                    cells[i, j, _EVIDENCE] -= _would_show(low, row, column)
    for row in range(ROWS):
        for column in range(COLUMNS):
            if low[row, column] < np.inf:
                bx, by = (row + 0.5) * CELL_M, (column + 0.5) * CELL_M - REACH_M
                i, j = _claim(cells, pose[0] + cos * bx - sin * by, pose[1] + sin * bx + cos * by)
                cells[i, j, _GROUND] = _SEEN


@exact_kernel
def _would_show(low: F32, row: int, column: int) -> bool:
    """Whether a step at a cell would show: the ground before it, towards the chair, was measured, too."""
    aside = column - COLUMNS // 2
    away = max(row, abs(aside), 1)
    for nearer in range(2, GAP_CELLS + 2):
        share = max(0.0, 1.0 - nearer / away)
        if low[round(share * row), COLUMNS // 2 + round(share * aside)] < np.inf:
            return True
    return False


@exact_kernel
def _stand(cells: I64, box: F64, around_m: float, pose: F64) -> None:
    """The ground under the chair, and so far around it, is known."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    rear, front, half = box[0] - around_m, box[1] + around_m, box[2] + around_m
    along, across = (
        math.ceil((front - rear) / (0.7 * CELL_M)),
        math.ceil(2.0 * half / (0.7 * CELL_M)),
    )
    for a in range(along + 1):
        bx = rear + (front - rear) * a / along
        for b in range(across + 1):
            by = half * (2.0 * b / across - 1.0)
            i, j = _claim(cells, pose[0] + cos * bx - sin * by, pose[1] + sin * bx + cos * by)
            under = box[0] <= bx <= box[1] and abs(by) <= box[2]
            cells[i, j, _GROUND] = max(cells[i, j, _GROUND], _SEEN if under else _AROUND)


@exact_kernel
def _collect(
    cells: I64, places: F64, pose: F64, tick: int, way_m: float, brief_ticks: int, found: F64
) -> int:
    """Write what is in the way into `found`, in B; forget what is too far, too long ago or a long way back."""
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
