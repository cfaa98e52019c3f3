"""From one depth image to the places around the chair that it cannot drive over: walls, people, kerbs and drops.

The ground ahead is a raster of the lowest and the highest point seen in each cell, in the body frame. What counts is
how the ground steps from a cell to the next, so a hill is no obstacle, and neither height nor slope must be known well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from wcsim.core.jit import exact_kernel
from wcsim.types import F32, F64

CELL_M = 0.1
REACH_M = 4.0  # beyond, rows of the image are farther apart than cells
ROWS, COLUMNS = round(REACH_M / CELL_M), 2 * round(REACH_M / CELL_M)  # ahead from the axle, and left of -REACH_M
STEP_M = 0.06  # more than casters climb, and less than a kerb; depth codes alone give 0.03
RISE_PER_M = 0.12  # a steep ramp
GAP_CELLS = 4  # how far apart neighbours may be: behind a kerb's edge, some ground is hidden
HEAD_M = 1.6  # what hangs higher passes above
DROP_M, DROP_PER_M = 0.15, 0.06  # rays that go so far below level ground have met no ground where it should be
_MOST_POINTS = 1024


@dataclass(frozen=True, slots=True)
class StepMap:
    """Buffers for one camera; `obstacles` writes into them."""

    low_m: F32 = field(default_factory=lambda: np.empty((ROWS, COLUMNS), np.float32))
    high_m: F32 = field(default_factory=lambda: np.empty((ROWS, COLUMNS), np.float32))
    points_B_m: F64 = field(default_factory=lambda: np.empty((_MOST_POINTS, 2)))

    def obstacles(self, depth_m: F32, rays: F32, eye_B_m: F64, span_m: tuple[float, float], up_B: F64) -> F64:
        """Middles of what is in the way.

        Args:
            depth_m: (H * W,) along the optical axis.
            rays: (H * W, 3) directions in B per metre of depth, see `viewing_rays`.
            eye_B_m: (3,) where the camera is.
            span_m: Depths outside it (nearest, farthest) are no measurement.
            up_B: (3,) the direction up in B, from the tilt sensor.

        Returns:
            (n, 2) x forward, y left in B; a view of a buffer, valid until the next call.
        """
        drops = _fill(depth_m, rays, eye_B_m, span_m[0], span_m[1], up_B, self.low_m, self.high_m, self.points_B_m)
        return self.points_B_m[: _steps(self.low_m, self.high_m, self.points_B_m, drops)]


@exact_kernel
def _fill(
    depth_m: F32, rays: F32, eye: F64, nearest_m: float, farthest_m: float, up: F64, low: F32, high: F32, points: F64
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
        x, y, z = eye[0] + depth * rays[i, 0], eye[1] + depth * rays[i, 1], eye[2] + depth * rays[i, 2]
        level = up[0] * x + up[1] * y + up[2] * z
        away = math.hypot(x, y)
        if max(z, level) < -DROP_M - DROP_PER_M * away:
            fall = eye[2] / max(eye[2] - z, 1e-6)  # where it should have met the ground
            x, y = eye[0] + fall * (x - eye[0]), eye[1] + fall * (y - eye[1])
            row, column = math.floor(x / CELL_M), math.floor((y + REACH_M) / CELL_M)
            if 0 <= row < ROWS and 0 <= column < COLUMNS and not dropped[row, column] and count < len(points):
                dropped[row, column] = True
                points[count, 0], points[count, 1] = x, y
                count += 1
            continue
        row, column = math.floor(x / CELL_M), math.floor((y + REACH_M) / CELL_M)
        if depth < farthest_m and 0 <= row < ROWS and 0 <= column < COLUMNS and min(z, level) < HEAD_M:
            low[row, column] = min(low[row, column], z)
            high[row, column] = max(high[row, column], z)
    return count


@exact_kernel
def _steps(low: F32, high: F32, points: F64, count: int) -> int:
    """Add the cells that hold a step, and the edges between cells that are one; returns the number of points."""
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
        if abs(rise) > STEP_M + RISE_PER_M * CELL_M * gap * math.hypot(down, right) and count < len(points):
            from_here = gap - 0.5 if rise > 0.0 else 0.5
            points[count, 0] = (row + 0.5 + from_here * down) * CELL_M
            points[count, 1] = (column + 0.5 + from_here * right) * CELL_M - REACH_M
            count += 1
        return count
    return count
