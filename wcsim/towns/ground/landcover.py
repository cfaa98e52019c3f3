"""What covers the ground beside the streets: car parks and squares are paved, and so is a town between its houses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import shapely
from shapely import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.towns.ground.surfaces import GRID_M, Surfaces
from wcsim.towns.ground.tiled_geometry import buffered, valid
from wcsim.towns.sumo.additional import Item

BESIDE_M = 8.0  # of a building the ground is paved
GAP_M = 6.0  # between such ground is paved too: yards
_SIMPLE_M = 0.3
LEAST_M2 = 4.0
_BUILT_UP = frozenset(("residential", "commercial", "retail", "industrial", "construction", "railway", "civil"))
_GREEN = {
    "landuse": frozenset(
        (
            "grass", "forest", "meadow", "village_green", "recreation_ground", "cemetery", "allotments", "farmland",
            "orchard", "vineyard", "flowerbed", "greenery", "basin", "plant_nursery"
        )
    ),
    "leisure": frozenset(("park", "garden", "pitch", "golf_course", "nature_reserve", "dog_park", "common")),
    "natural": frozenset(("water", "wood", "grassland", "scrub", "beach")),
}  # fmt: skip
"""Ground that stays as it grows, by group of SUMO's type."""
NOT_ON_GROUND = frozenset(("underground", "multi-storey", "rooftop", "carports", "garage_boxes", "sheds"))
"""Car parks that are no ground, by the map's tag `parking`."""


def covered(surfaces: Surfaces, items: Iterable[Item]) -> Surfaces:
    """The same areas with what is known of the rest of the ground: `paved` and `parking` lie on the terrain."""
    items = [item for item in items if not item.author and len(item.points_W_m) > 3]
    parking = _area(item for item in items if _is_car_park(item))
    squares = _area(item for item in items if _is_square(item))
    green = _area(item for item in items if item.kind in _GREEN.get(item.group, ()))
    houses = _area(item for item in items if item.group == "building")
    quarters = _area(item for item in items if item.group == "landuse" and item.kind in _BUILT_UP)
    yards = buffered(buffered(houses, BESIDE_M + GAP_M, quad_segs=2), -GAP_M, quad_segs=2)
    paved = shapely.union_all([shapely.union_all([yards, quarters]).difference(green), squares]).difference(parking)
    return replace(surfaces, paved=_on_land(paved, surfaces), parking=_on_land(parking, surfaces))


def _is_car_park(item: Item) -> bool:
    on_ground = item.tags.get("parking", "surface") not in NOT_ON_GROUND and item.tags.get("layer", "0") == "0"
    return item.group == "amenity" and item.kind == "parking" and on_ground


def _is_square(item: Item) -> bool:
    closed = bool((item.points_W_m[0] == item.points_W_m[-1]).all())
    return closed and (item.group, item.kind) in (("place", "square"), ("highway", "pedestrian"))


def _area(items: Iterable[Item]) -> BaseGeometry:
    """The union of outlines, as valid polygons."""
    outlines = [shapely.make_valid(Polygon(item.points_W_m)) for item in items]
    return _polygons(shapely.union_all(outlines))


def _on_land(area: BaseGeometry, surfaces: Surfaces) -> BaseGeometry:
    """What of an area is terrain, on the grid of all ground points, without crumbs."""
    rest = valid(area.simplify(_SIMPLE_M)).intersection(surfaces.hull)
    rest = rest.difference(shapely.union_all([surfaces.low, surfaces.pavement]))
    return _polygons(shapely.set_precision(rest, GRID_M))


def _polygons(area: BaseGeometry) -> BaseGeometry:
    flat = [part for whole in shapely.get_parts(area) for part in shapely.get_parts(whole)]
    return MultiPolygon([part for part in flat if part.geom_type == "Polygon" and part.area > LEAST_M2])
