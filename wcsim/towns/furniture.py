"""Street furniture: where each thing stands, kept clear of road and walking lines, and what it looks like."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.seeding import generator
from wcsim.towns import shapes
from wcsim.towns.items import Item
from wcsim.towns.shapes import Piece
from wcsim.types import F64, ClassId

CLEAR_M = 0.75  # free space beside the walking line
SHIFTS_M = (0.0, 0.4, 0.8, 1.2, 1.6)  # how far a thing may be moved to give way
BASE_M = -0.02  # things reach into the ground, which falls at crossings


@dataclass(frozen=True, slots=True, kw_only=True)
class Thing:
    """A piece that stands in the street, and the ground below 2 m height that it takes."""

    piece: Piece
    footprint: Polygon


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where things may stand."""

    low: BaseGeometry  # carriageway and crossings, with a little margin
    solids: BaseGeometry  # buildings
    lines: BaseGeometry  # walking lines
    hull: BaseGeometry

    def free(self, footprint: Polygon) -> bool:
        """True when a footprint is off the road, out of buildings, inside the town and clear of the walking lines."""
        return (
            self.hull.contains(footprint)
            and not self.low.intersects(footprint)
            and not self.solids.intersects(footprint)
            and not shapely.dwithin(self.lines, footprint, CLEAR_M)
        )


def things_of(items: list[Item], place: Place) -> list[Thing]:
    """All furniture that finds a place."""
    for geometry in (place.low, place.solids, place.lines, place.hull):
        shapely.prepare(geometry)
    found: list[Thing] = []
    for item in items:
        make = _POINT_MAKERS.get(item.kind)
        if make is not None and (len(item.points_W_m) == 1 or item.filled):
            thing = _stood(item, make, place)
            found += [thing] if thing is not None else []
        elif item.kind in _LINE_SPECS and len(item.points_W_m) > 1:
            found += _barriers(item, place)
    return found


def _stood(item: Item, make: Callable[[F64, float], Thing], place: Place) -> Thing | None:
    """The thing where it is mapped, or as little aside as needed, or None."""
    middle = item.points_W_m.mean(axis=0) if len(item.points_W_m) > 1 else item.points_W_m[0]
    nearest = (
        shapely.get_coordinates(shapely.shortest_line(place.lines, shapely.Point(middle)))
        if not place.lines.is_empty
        else None
    )
    away = middle - nearest[0] if nearest is not None and len(nearest) else np.array([1.0, 0.0])
    length_m = float(np.hypot(*away))
    away = away / length_m if length_m > 1e-6 else np.array([0.0, 1.0])
    yaw_rad = float(np.arctan2(away[1], away[0])) + np.pi / 2  # benches stand along the way
    for shift_m in SHIFTS_M:
        thing = make(middle + shift_m * away, yaw_rad)
        if place.free(thing.footprint):
            return thing
    return None


def _barriers(item: Item, place: Place) -> list[Thing]:
    """A fence, wall or hedge, with gaps where people walk and vehicles drive."""
    height_m, thick_m, class_id = _LINE_SPECS[item.kind]
    line = shapely.LineString(item.points_W_m).simplify(0.1).intersection(place.hull)
    if line.is_empty:
        return []
    near = line.buffer(2.0).bounds
    lines, low, solids = (shapely.clip_by_rect(area, *near) for area in (place.lines, place.low, place.solids))
    blocked = shapely.union_all([lines.buffer(CLEAR_M + thick_m, quad_segs=2), low, solids])
    band = line.buffer(thick_m / 2, cap_style="flat", join_style="mitre").difference(blocked)
    parts = [shapely.set_precision(part, 0.01) for part in shapely.get_parts(band)]
    solid = [
        p
        for part in parts
        for p in shapely.get_parts(part)
        if p.geom_type == "Polygon" and p.area > 0.05 and p.is_valid
    ]
    return [Thing(piece=shapes.prism(p, BASE_M, 0.12 + height_m, class_id), footprint=p) for p in solid]


def _tree(xy_m: F64, yaw_rad: float) -> Thing:
    rng = generator(0, "tree", int(abs(xy_m[0]) * 10), int(abs(xy_m[1]) * 10))
    radius_m, top_m = rng.uniform(1.3, 2.4), rng.uniform(5.5, 9.0)
    trunk = shapes.post(xy_m, 0.15, BASE_M, 2.6, ClassId.POLE)
    middle_m = 2.5 + 0.4 * (top_m - 2.5)
    crown = shapes.spindle(
        xy_m, ((0.0, 2.4), (radius_m, middle_m), (0.6 * radius_m, 0.8 * top_m), (0.0, top_m)), ClassId.VEGETATION
    )
    trunk = Piece(
        vertices_W_m=trunk.vertices_W_m,
        faces=trunk.faces,
        face_class=np.full_like(trunk.face_class, ClassId.VEGETATION),
    )
    return Thing(piece=shapes.joined([trunk, crown]), footprint=_disc(xy_m, 0.15))


def _lamp(xy_m: F64, yaw_rad: float) -> Thing:
    pole = shapes.post(xy_m, 0.08, BASE_M, 5.0, ClassId.POLE, sides=5)
    head = shapes.box(xy_m, (0.6, 0.3, 0.15), 5.0, yaw_rad + np.pi / 2, ClassId.POLE)
    return Thing(piece=shapes.joined([pole, head]), footprint=_disc(xy_m, 0.08))


def _signal(xy_m: F64, yaw_rad: float) -> Thing:
    pole = shapes.post(xy_m, 0.07, BASE_M, 2.3, ClassId.POLE, sides=5)
    head = shapes.box(xy_m, (0.3, 0.3, 0.8), 2.3, yaw_rad, ClassId.TRAFFIC_LIGHT)
    return Thing(piece=shapes.joined([pole, head]), footprint=_disc(xy_m, 0.07))


def _bench(xy_m: F64, yaw_rad: float) -> Thing:
    back = np.array([-np.sin(yaw_rad), np.cos(yaw_rad)]) * 0.22
    seat = shapes.box(xy_m, (1.6, 0.5, 0.55), BASE_M, yaw_rad, ClassId.STATIC)
    rest = shapes.box(xy_m - back, (1.6, 0.06, 0.95), BASE_M, yaw_rad, ClassId.STATIC)
    return Thing(piece=shapes.joined([seat, rest]), footprint=shapes.rectangle(xy_m, 1.6, 0.5, yaw_rad))


def _post_maker(radius_m: float, height_m: float, class_id: int) -> Callable[[F64, float], Thing]:
    def make(xy_m: F64, yaw_rad: float) -> Thing:
        return Thing(
            piece=shapes.post(xy_m, radius_m, BASE_M, 0.12 + height_m, class_id), footprint=_disc(xy_m, radius_m)
        )

    return make


def _box_maker(size_lwh_m: tuple[float, float, float], class_id: int) -> Callable[[F64, float], Thing]:
    def make(xy_m: F64, yaw_rad: float) -> Thing:
        piece = shapes.box(xy_m, size_lwh_m, BASE_M, yaw_rad, class_id)
        return Thing(piece=piece, footprint=shapes.rectangle(xy_m, size_lwh_m[0], size_lwh_m[1], yaw_rad))

    return make


def _disc(xy_m: F64, radius_m: float) -> Polygon:
    return shapely.Point(xy_m).buffer(radius_m, quad_segs=2)


_POINT_MAKERS: dict[str, Callable[[F64, float], Thing]] = {
    "tree": _tree,
    "street_lamp": _lamp,
    "traffic_signals": _signal,
    "bench": _bench,
    "bollard": _post_maker(0.09, 0.9, ClassId.POLE),
    "pole": _post_maker(0.12, 6.0, ClassId.POLE),
    "waste_basket": _post_maker(0.22, 0.9, ClassId.STATIC),
    "fire_hydrant": _post_maker(0.15, 0.8, ClassId.STATIC),
    "column": _post_maker(0.6, 3.0, ClassId.STATIC),
    "post_box": _box_maker((0.5, 0.45, 1.3), ClassId.STATIC),
    "recycling": _box_maker((1.6, 1.0, 1.5), ClassId.STATIC),
    "block": _box_maker((0.9, 0.6, 0.6), ClassId.STATIC),
    "bicycle_parking": _box_maker((2.0, 0.5, 0.85), ClassId.STATIC),
    "barrier": _box_maker((1.5, 0.4, 1.0), ClassId.FENCE),
    "roadworks": _box_maker((2.0, 1.2, 1.1), ClassId.FENCE),
}
_LINE_SPECS: dict[str, tuple[float, float, int]] = {  # height and thickness in metres, class
    "fence": (1.2, 0.12, ClassId.FENCE),
    "guard_rail": (0.8, 0.15, ClassId.FENCE),
    "handrail": (1.0, 0.12, ClassId.FENCE),
    "wall": (1.5, 0.2, ClassId.WALL),
    "retaining_wall": (1.0, 0.2, ClassId.WALL),
    "city_wall": (3.0, 0.6, ClassId.WALL),
    "hedge": (1.3, 0.6, ClassId.VEGETATION),
}
