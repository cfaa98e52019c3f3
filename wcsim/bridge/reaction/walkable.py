"""Where a person can stand and walk: small looks at the street's raster, many of them in every tick."""

from __future__ import annotations

import math

from wcsim.core.jit import exact_kernel
from wcsim.types import U8, ClassId, StreetGrid

SOLID_GAP_M = 0.3
SHOULDER = 0.8  # of a body's radius stays over walkable ground
EVERY_M = 0.5  # the way ahead is looked at in steps of so much
ACROSS = 5  # places looked at on the way across
_SIDEWALK, _CROSSWALK, _TERRAIN = int(ClassId.SIDEWALK), int(ClassId.CROSSWALK), int(ClassId.TERRAIN)
_GROUND, _PARKING = int(ClassId.GROUND), int(ClassId.PARKING)


@exact_kernel
def _cell(at_m: float, first_m: float, cell_m: float, count: int) -> int:
    return min(max(math.floor((at_m - first_m) / cell_m), 0), count - 1)


@exact_kernel
def _stands(
    classes: U8,
    clearance_dm: U8,
    first_x: float,
    first_y: float,
    cell_m: float,
    x: float,
    y: float,
    sx: float,
    sy: float,
) -> bool:
    """Whether the middle is clear of solid things, and it and both shoulders, sx, sy beside it, on walkable ground."""
    rows, cols = classes.shape
    row, col = _cell(y, first_y, cell_m, rows), _cell(x, first_x, cell_m, cols)
    if clearance_dm[row, col] * 0.1 < SOLID_GAP_M:
        return False
    for side in range(-1, 2):
        row, col = _cell(y + side * sy, first_y, cell_m, rows), _cell(x + side * sx, first_x, cell_m, cols)
        here = classes[row, col]
        if here != _SIDEWALK and here != _CROSSWALK and here != _TERRAIN and here != _GROUND and here != _PARKING:
            return False
    return True


@exact_kernel
def _opens(
    classes: U8, clearance_dm: U8, first_x: float, first_y: float, cell_m: float, at_x: float, at_y: float,
    x: float, y: float, cos: float, sin: float, ahead_m: float, side_m: float,
) -> bool:  # fmt: skip
    sx, sy = -side_m * sin, side_m * cos
    steps = math.ceil(ahead_m / EVERY_M)
    for i in range(steps + 1):
        far_m = ahead_m * i / max(steps, 1)
        if not _stands(classes, clearance_dm, first_x, first_y, cell_m, x + far_m * cos, y + far_m * sin, sx, sy):
            return False
    for i in range(1, ACROSS + 1):  # but for the place one has already
        t = i / ACROSS
        px, py = (1.0 - t) * at_x + t * x, (1.0 - t) * at_y + t * y
        if not _stands(classes, clearance_dm, first_x, first_y, cell_m, px, py, sx, sy):
            return False
    return True


def can_stand(grid: StreetGrid, x: float, y: float, cos: float, sin: float, radius_m: float) -> bool:
    """Whether a person of this radius that looks along (cos, sin) can stand at a place with both shoulders."""
    side_m = SHOULDER * radius_m
    here = grid.ground_class, grid.clearance_dm, *grid.origin_W_m, grid.cell_m
    return _stands(*here, x, y, -side_m * sin, side_m * cos)


def way_is_open(
    grid: StreetGrid,
    at_W_m: tuple[float, float],
    there_W_m: tuple[float, float],
    heading: tuple[float, float],
    ahead_m: float,
    radius_m: float,
) -> bool:
    """Whether a person can step from where it is over to a place beside, and walk so far ahead from there."""
    here = grid.ground_class, grid.clearance_dm, *grid.origin_W_m, grid.cell_m
    return _opens(*here, *at_W_m, *there_W_m, *heading, ahead_m, SHOULDER * radius_m)
