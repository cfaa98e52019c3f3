"""Buildings: footprints cleared of the street, heights from tags or, without any, drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.seeding import generator
from wcsim.towns.items import Item, metres

STOREY_M = 3.2
GAP_M = 0.1  # between a wall and walkable ground or road
SMALLEST_M2 = 3.0
_OPEN_KINDS = {"roof", "carport", "entrance", "underpass_entrance"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Building:
    """One block with vertical walls and a flat roof."""

    outline: Polygon
    height_m: float


def buildings_of(items: list[Item], street: BaseGeometry, hull: BaseGeometry) -> list[Building]:
    """Buildings without the parts that stand on the street (arcades, passages) or outside the town."""
    keep_out = street.buffer(GAP_M, join_style="mitre", mitre_limit=2.0)
    taken: BaseGeometry = Polygon()
    found: list[Building] = []
    for item in items:
        if item.kind != "building" or not item.filled or len(item.points_W_m) < 4 or item.detail in _OPEN_KINDS:
            continue
        area = shapely.make_valid(Polygon(item.points_W_m)).intersection(hull).difference(keep_out)
        clear = shapely.set_precision(
            area.difference(taken).buffer(-0.15).buffer(0.15, join_style="mitre").simplify(0.1), 0.01
        )
        parts = [part for part in shapely.get_parts(clear) if part.geom_type == "Polygon" and part.area >= SMALLEST_M2]
        parts = [part for part in parts if part.is_valid and not part.intersects(street)]
        found += [Building(outline=part, height_m=_height_m(item)) for part in parts]
        taken = taken.union(shapely.union_all(parts).buffer(0.02)) if parts else taken
    return found


def _height_m(item: Item) -> float:
    height_m = metres(item.tags.get("height", ""))
    if height_m is not None and 2.0 <= height_m <= 400.0:
        return height_m
    storeys = metres(item.tags.get("building:levels", ""))
    if storeys is not None and 1.0 <= storeys <= 120.0:
        return STOREY_M * storeys + 1.0
    return round(float(generator(0, "building", item.id).uniform(9.0, 18.0)), 1)
