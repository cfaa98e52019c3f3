"""A town's ground from straight above, pale enough to draw ways on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from wcsim.errors import WcsimError
from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street
from wcsim.types import U8, ClassId, Ground
from wcsim.view.report.charts import TownPicture

_MARGIN_M: Final = 25.0
_MOST_CELLS: Final = 700
_ROWS_AT_ONCE: Final = 64
_COLOURS: Final = {
    ClassId.ROAD: (214, 216, 220),
    ClassId.PARKING: (222, 222, 224),
    ClassId.CROSSWALK: (190, 194, 206),
    ClassId.SIDEWALK: (243, 239, 228),
    ClassId.KERB: (180, 180, 180),
    ClassId.LOWERED_KERB: (205, 190, 150),
    ClassId.RAIL_TRACK: (224, 214, 208),
    ClassId.TERRAIN: (232, 240, 226),
    ClassId.VEGETATION: (220, 234, 212),
    ClassId.GROUND: (238, 236, 232),
}
_SOLID_RGB: Final = (196, 190, 188)  # houses, walls, trunks
_OTHER_RGB: Final = (248, 248, 248)


def ground_around(town: str, points_m: Sequence[tuple[float, float]]) -> TownPicture | None:
    """The ground of a town around some points; None where there is no such town, or no point."""
    if not points_m:
        return None
    try:
        street = load_street(find_town(town))
    except WcsimError:
        return None
    x, y = np.asarray(points_m, np.float64).T
    west, east = float(x.min()) - _MARGIN_M, float(x.max()) + _MARGIN_M
    south, north = float(y.min()) - _MARGIN_M, float(y.max()) + _MARGIN_M
    cell = max(east - west, north - south) / _MOST_CELLS
    columns, rows = max(1, round((east - west) / cell)), max(1, round((north - south) / cell))
    at_x = west + (np.arange(columns) + 0.5) * (east - west) / columns
    at_y = north - (np.arange(rows) + 0.5) * (north - south) / rows
    strips = [_strip(street.grid, at_x, at_y[row : row + _ROWS_AT_ONCE]) for row in range(0, rows, _ROWS_AT_ONCE)]
    return TownPicture(image=np.vstack(strips), west_m=west, east_m=east, south_m=south, north_m=north)


def _strip(grid: Ground, at_x: np.ndarray, at_y: np.ndarray) -> U8:
    points = np.stack(np.broadcast_arrays(at_x[None, :], at_y[:, None]), axis=-1)
    table = np.full((256, 3), _OTHER_RGB, np.uint8)
    for class_id, colour in _COLOURS.items():
        table[class_id] = colour
    image = table[grid.class_at(points)]
    image[grid.clearance_at(points) <= 0.0] = _SOLID_RGB
    return np.asarray(image, np.uint8)
