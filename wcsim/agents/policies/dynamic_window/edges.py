"""Walls and kerbs go on: a straight edge that is seen ahead is carried on beside the chair, where it does not look."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from wcsim.agents.policies.dynamic_window.street_memory import is_ground
from wcsim.agents.policies.elevation_map import CELL_M
from wcsim.core.jit import exact_kernel
from wcsim.types import F64

I64 = npt.NDArray[np.int64]

BACK_M = -1.2  # an edge is carried on as far as this, behind the axle
_NEAREST_M, _FARTHEST_M, _ASIDE_M = 0.5, 3.2, 1.4  # where edges are looked for: ahead, and to each side
_OFF_M = 0.08  # a point so far from a line is on it
_APART_M, _LONG_M = 0.7, 1.0  # points that make a line, and how long it must be
_STEEPEST = 0.5  # aside per metre ahead
_FEWEST, _MOST = 8, 48


@exact_kernel
def carry_on(points: F64, cells: I64, pose_O: F64, added: F64) -> int:
    """Carry on the longest straight edge on either side, over what was never seen.

    Args:
        points: (n, 2) what is in the way, in B.
        cells: Of `StreetMemory`.
        pose_O: (3,) of the chair.
        added: (m, 2) written: the places that may be in the way, in B.

    Returns:
        How many were written.
    """
    count = 0
    near = np.empty((_MOST, 2))
    cos, sin = math.cos(pose_O[2]), math.sin(pose_O[2])
    for side in (-1.0, 1.0):
        found = _beside(points, side, near)
        aside, slope, begins = _line(near[:found])
        if math.isinf(begins):
            continue
        x = begins - CELL_M
        while x > BACK_M and count < len(added):
            y = aside + slope * x
            x_O_m, y_O_m = pose_O[0] + cos * x - sin * y, pose_O[1] + sin * x + cos * y
            if y * side > 0.0 and not is_ground(cells, x_O_m, y_O_m):
                added[count, 0], added[count, 1] = x, y
                count += 1
            x -= CELL_M
    return count


@exact_kernel
def _beside(points: F64, side: float, near: F64) -> int:
    """Gather the points ahead on one side; every second one, and so on, when there are too many."""
    total = 0
    for n in range(len(points)):
        total += _is_beside(points[n, 0], side * points[n, 1])
    step, index, count = 1 + total // (len(near) + 1), 0, 0
    for n in range(len(points)):
        if _is_beside(points[n, 0], side * points[n, 1]):
            if index % step == 0 and count < len(near):
                near[count] = points[n]
                count += 1
            index += 1
    return count


@exact_kernel
def _is_beside(x: float, aside: float) -> bool:
    return bool(_NEAREST_M < x < _FARTHEST_M and 0.2 < aside < _ASIDE_M)


@exact_kernel
def _line(points: F64) -> tuple[float, float, float]:
    """The line y = aside + slope x on which most points lie, and where it begins; that is infinite without a line."""
    best, best_aside, best_slope, best_begins = _FEWEST - 1, 0.0, 0.0, np.inf
    for a in range(len(points)):
        for b in range(len(points)):
            along = points[b, 0] - points[a, 0]
            if along < _APART_M:
                continue
            slope = (points[b, 1] - points[a, 1]) / along
            if abs(slope) > _STEEPEST:
                continue
            aside = points[a, 1] - slope * points[a, 0]
            count, begins, ends = 0, np.inf, -np.inf
            for n in range(len(points)):
                if abs(points[n, 1] - aside - slope * points[n, 0]) < _OFF_M:
                    count += 1
                    begins, ends = min(begins, points[n, 0]), max(ends, points[n, 0])
            if count > best and ends - begins > _LONG_M:
                best, best_aside, best_slope, best_begins = count, aside, slope, begins
    return best_aside, best_slope, best_begins
