"""What an author placed in an additional file (types wcsim.*): it stands exactly there, whatever is below or around."""

from __future__ import annotations

import logging

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.core.frames import yaw_from_sumo
from wcsim.errors import TownError
from wcsim.towns.furniture.models import CLASS_OF_AREA, FOOT_M, LOOKS
from wcsim.towns.furniture.placement import StandingObject, stood
from wcsim.towns.ground import solid_shapes
from wcsim.towns.ground.solid_shapes import Solid
from wcsim.towns.sumo.additional import AUTHOR_PREFIX, Item
from wcsim.types import F64, ClassId

log = logging.getLogger("wcsim.towns")

LARGEST_M = 100.0
_BOARD_M = 0.06  # thickness of the boards around roadworks
_BOARDS_M = ((0.1, 0.3), (0.75, 1.0))  # from and to: the lower one is what a white cane finds
POST_STEP_M = 2.0
_CONE_IN_M = 0.3  # cones stand inside the boards
LONGEST_M = 4.0  # an outline that follows a hill has a corner at least this often


def author_things(items: list[Item], hull: BaseGeometry) -> list[StandingObject]:
    """Everything of a type wcsim.* that touches the town's ground. Raises TownError for a size that is none."""
    found: list[StandingObject] = []
    for item in items:
        things = [thing for thing in _things(item) if thing.footprint.intersects(hull)] if item.author else []
        found += things
        if item.author and not things:
            log.warning("%s: %r (%s%s) lies outside the town", item.source, item.id, AUTHOR_PREFIX, item.kind)
    return found


def _things(item: Item) -> list[StandingObject]:
    length_m, width_m, height_m = (_size(item, key) for key in ("length", "width", "height"))
    usual = LOOKS[item.kind].size_lwh_m
    points_m = _without_doubles(item.points_W_m)
    if len(points_m) == 1:
        size = (length_m or usual[0], width_m or usual[1], height_m or usual[2])
        return [stood(item.kind, points_m[0], yaw_from_sumo(_angle_deg(item)), size if size != usual else None)]
    outline = _outline(item, points_m, width_m or usual[1])
    areas = [part for part in _polygons(outline) if part.area > 1e-4]
    make = _fenced if item.kind == "roadworks" else _filled
    return [make(item.kind, area, height_m or usual[2]) for area in areas]


def _outline(item: Item, points_m: F64, width_m: float) -> BaseGeometry:
    """The ground that several points (N, 2) mark: what they enclose, or a band along them."""
    closed = len(points_m) > 3 and bool((points_m[0] == points_m[-1]).all())
    if (item.filled or (closed and item.kind == "roadworks")) and len(points_m) > 2:
        return shapely.make_valid(Polygon(points_m))
    return shapely.LineString(points_m).buffer(width_m / 2, cap_style="flat", join_style="mitre")


def _filled(kind: str, area: Polygon, height_m: float) -> StandingObject:
    class_id = CLASS_OF_AREA.get(kind, ClassId.STATIC)
    return _thing(area, [solid_shapes.prism(shapely.segmentize(area, LONGEST_M), FOOT_M, height_m, class_id)])


def _fenced(kind: str, area: Polygon, height_m: float) -> StandingObject:
    """Boards along the inner side of an outline, with posts between them and a cone at each corner."""
    inner = area.buffer(-_BOARD_M, join_style="mitre")
    pieces: list[Solid] = []
    share = height_m / _BOARDS_M[-1][1]
    for band in _polygons(shapely.segmentize(area, LONGEST_M).difference(inner)):
        pieces += [
            solid_shapes.prism(band, share * low_m, share * high_m, ClassId.FENCE, floor=True)
            for low_m, high_m in _BOARDS_M
        ]
    rail = area.buffer(-0.6 * _BOARD_M, join_style="mitre")
    for xy in _stations(rail):
        pieces.append(solid_shapes.post(xy, 0.04, FOOT_M, height_m, ClassId.FENCE, sides=5))
    for xy in _corners(area.buffer(-_CONE_IN_M, join_style="mitre")):
        pieces.append(stood("cone", xy, 0.0).piece)
    return _thing(area, pieces or _filled(kind, area, height_m).piece)


def _thing(area: Polygon, pieces: list[Solid] | Solid) -> StandingObject:
    piece = solid_shapes.joined(pieces) if isinstance(pieces, list) else pieces
    base_m = shapely.get_coordinates(area.representative_point())[0]
    return StandingObject(piece=piece, footprint=area, base_m=base_m, follows=True)


def _stations(area: BaseGeometry) -> list[F64]:
    """Points along the outlines of an area, at corners and between them."""
    rings = [ring for part in _polygons(area) for ring in (part.exterior, *part.interiors)]
    return [xy for ring in rings for xy in shapely.get_coordinates(shapely.segmentize(ring, POST_STEP_M))[:-1]]


def _corners(area: BaseGeometry) -> list[F64]:
    rings = [part.exterior.simplify(0.2) for part in _polygons(area)]
    return [xy for ring in rings for xy in shapely.get_coordinates(ring)[:-1]]


def _polygons(area: BaseGeometry) -> list[Polygon]:
    flat = [p for part in shapely.get_parts(area) for p in shapely.get_parts(part)]
    return [p for p in flat if p.geom_type == "Polygon" and not p.is_empty]


def _without_doubles(points_m: F64) -> F64:
    kept = np.r_[True, np.any(np.diff(points_m, axis=0) != 0.0, axis=1)]
    return points_m[kept]


def _size(item: Item, key: str) -> float | None:
    """A length that the author gave, or None."""
    text = item.tags.get(key, "").strip()
    if not text:
        return None
    value = _number(item, key, text)
    if not 0.01 <= value <= LARGEST_M:
        raise _error(item, key, text, f"a number of metres from 0.01 to {LARGEST_M:g}")
    return value


def _angle_deg(item: Item) -> float:
    text = item.tags.get("angle", "").strip()
    return _number(item, "angle", text) if text else 0.0


def _number(item: Item, key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise _error(item, key, text, "a number")
    return value


def _error(item: Item, key: str, text: str, expected: str) -> TownError:
    what = f"{item.source}: {key} of {item.id!r} ({AUTHOR_PREFIX}{item.kind})"
    return TownError(f"{what} is {text!r}; expected {expected}: correct the <param>")
