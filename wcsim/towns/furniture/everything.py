"""Everything that stands in a street but its buildings, in the order in which it takes its place.

Stops of buses and trams have a pole with a sign, and a shelter where the pavement has room for one.
Street furniture from maps is kept clear of road and walking lines. What an author placed in an
additional file (types wcsim.*) stands exactly there, whatever is below or around.
"""

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.core.frames import yaw_from_sumo
from wcsim.core.reading import read_module_toml
from wcsim.errors import TownError
from wcsim.towns.furniture.models import FOOT_M, LOOKS
from wcsim.towns.furniture.placement import CLEAR_M, FreeGround, StandingObject, standing_object
from wcsim.towns.furniture.traffic_lights import sign_things, signal_things
from wcsim.towns.ground import solid_shapes
from wcsim.towns.ground.plane_geometry import (
    Patches,
    distinct,
    left_of,
    polygons_of,
    unit,
    valid,
    yaw_of,
)
from wcsim.towns.ground.solid_shapes import Solid
from wcsim.towns.osm.tags import metres, off_ground
from wcsim.towns.sumo.additional import AUTHOR_PREFIX, Item
from wcsim.towns.sumo.net import Net
from wcsim.types import F64, ClassId

log = logging.getLogger("wcsim.towns")

LARGEST_M = 100.0
_BOARD_M = 0.06  # thickness of the boards around roadworks
_BOARDS_M = ((0.1, 0.3), (0.75, 1.0))  # from and to: the lower one is what a white cane finds
_AUTHOR_POST_STEP_M = 2.0
_CONE_IN_M = 0.3  # cones stand inside the boards
_AUTHOR_LONGEST_M = 4.0  # an outline that follows a hill has a corner at least this often
SHIFTS_M = (0.0, 0.4, 0.8, 1.2, 1.6)  # how far a thing may be moved to give way
TREE_STEP_M = 8.0
POST_STEP_M = 1.5
LONGEST_M = 12.0  # a fence that follows a hill has a corner at least this often
_SAME_STOP_M = 12.0  # a mapped stop so near to one of SUMO's is the same one
FARTHEST_M = 14.0  # from the middle of the lane to the pole
STEP_M = 0.35
ALONG_M = (0.0, 1.5, -1.5, 3.0, -3.0, 5.0, -5.0, 7.0, -7.0)
_FLAT_GROUPS = ("landuse", "waterway", "boundary", "kerb", "building", "stop")
_DATA = read_module_toml(__file__)
_COMPASS: list[str] = _DATA["compass"].split()
_LOOK_BY_TAG: dict[str, tuple[str, dict[str, str]]] = _DATA["by_tag"]
_CLASS_OF_AREA = {
    kind: ClassId[name] for name, kinds in _DATA["areas"].items() for kind in kinds.split()
}
LOOK_OF = {kind: look for look, kinds in _DATA["looks"].items() for kind in kinds.split()}
"""Looks of mapped points by the second word of their type; "" for what stands nowhere."""
_ROW_STEPS_M = {
    "tree_row": ("tree", TREE_STEP_M),
    "bollard": ("bollard", POST_STEP_M),
    "chain": ("bollard", 2.0),
}
# Height and thickness in metres, and class.
_LINE_SPECS: dict[str, tuple[float, float, int]] = {
    kind: (high_m, thick_m, ClassId[name])
    for kind, (high_m, thick_m, name) in _DATA["lines"].items()
}


def author_things(items: list[Item], hull: BaseGeometry) -> list[StandingObject]:
    """Everything of a type wcsim.* that touches the town's ground.

    Raises:
        TownError: A size is none.
    """
    found: list[StandingObject] = []
    for item in items:
        if not item.author:
            continue
        things = [thing for thing in _things(item) if thing.footprint.intersects(hull)]
        found += things
        if not things:
            kind = f"{AUTHOR_PREFIX}{item.kind}"
            log.warning("%s: %r (%s) lies outside the town", item.source, item.id, kind)
    return found


def place_furniture(
    items: list[Item],
    net: Net,
    additional: tuple[Path, ...],
    place: FreeGround,
    placed: list[StandingObject],
) -> list[StandingObject]:
    """What the author placed, then signals, stops, signs and mapped furniture if there is room."""
    place.take(placed)
    return [
        *placed,
        *signal_things(net, additional, place),
        *_stop_things(items, place, net.lefthand),
        *sign_things(items, net, place),
        *_place_mapped(items, place),
    ]


def _things(item: Item) -> list[StandingObject]:
    """What an author placed: at a point, along a line, or on an area."""
    length_m, width_m, height_m = (_size(item, key) for key in ("length", "width", "height"))
    usual = LOOKS[item.kind].size_lwh_m
    points_m = distinct(item.points_W_m)
    if len(points_m) == 1:
        size_m = (length_m or usual[0], width_m or usual[1], height_m or usual[2])
        yaw_rad = yaw_from_sumo(_number(item, "angle") or 0.0)
        own_size_m = size_m if size_m != usual else None
        return [standing_object(item.kind, points_m[0], yaw_rad, own_size_m)]
    is_fenced = item.kind == "roadworks"
    ground = _outline(item, points_m, width_m or usual[1], is_fenced)
    make = _fenced if is_fenced else _filled
    return [make(item.kind, area, height_m or usual[2]) for area in polygons_of(ground, 1e-4)]


def _outline(item: Item, points_m: F64, width_m: float, is_fenced: bool) -> BaseGeometry:
    """The ground that several points mark: what they enclose, or a band along them."""
    closed = len(points_m) > 3 and bool((points_m[0] == points_m[-1]).all())
    if (item.filled or (closed and is_fenced)) and len(points_m) > 2:
        return shapely.make_valid(Polygon(points_m))
    line = shapely.LineString(points_m)
    return line.buffer(width_m / 2, cap_style="flat", join_style="mitre")


def _filled(kind: str, area: Polygon, height_m: float) -> StandingObject:
    class_id = _CLASS_OF_AREA.get(kind, ClassId.STATIC)
    outline = shapely.segmentize(area, _AUTHOR_LONGEST_M)
    return _thing(area, solid_shapes.prism(outline, FOOT_M, height_m, class_id))


def _fenced(kind: str, area: Polygon, height_m: float) -> StandingObject:
    """Boards along the inner side of an outline, posts between them, and a cone at each corner."""
    inner = area.buffer(-_BOARD_M, join_style="mitre")
    pieces: list[Solid] = []
    share = height_m / _BOARDS_M[-1][1]
    for band in polygons_of(shapely.segmentize(area, _AUTHOR_LONGEST_M).difference(inner)):
        pieces += [
            solid_shapes.prism(band, share * low_m, share * high_m, ClassId.FENCE, floor=True)
            for low_m, high_m in _BOARDS_M
        ]
    # Posts stand at the corners of the boards and between them.
    rails = polygons_of(area.buffer(-0.6 * _BOARD_M, join_style="mitre"))
    for ring in [ring for part in rails for ring in (part.exterior, *part.interiors)]:
        for xy_m in shapely.get_coordinates(shapely.segmentize(ring, _AUTHOR_POST_STEP_M))[:-1]:
            pieces.append(solid_shapes.post(xy_m, 0.04, FOOT_M, height_m, ClassId.FENCE, sides=5))
    for part in polygons_of(area.buffer(-_CONE_IN_M, join_style="mitre")):
        for xy_m in shapely.get_coordinates(part.exterior.simplify(0.2))[:-1]:
            pieces.append(standing_object("cone", xy_m, 0.0).piece)
    if not pieces:
        return _filled(kind, area, height_m)
    return _thing(area, solid_shapes.joined(pieces))


def _thing(area: Polygon, piece: Solid) -> StandingObject:
    base_m = shapely.get_coordinates(area.representative_point())[0]
    return StandingObject(piece=piece, footprint=area, base_m=base_m, follows=True)


def _size(item: Item, key: str) -> float | None:
    """A length that the author gave, or None."""
    value = _number(item, key)
    if value is not None and not 0.01 <= value <= LARGEST_M:
        raise _error(item, key, f"a number of metres from 0.01 to {LARGEST_M:g}")
    return value


def _number(item: Item, key: str) -> float | None:
    """A number that the author gave, or None."""
    text = item.tags.get(key, "").strip()
    try:
        value = float(text) if text else None
    except ValueError:
        value = np.nan
    if value is not None and not np.isfinite(value):
        raise _error(item, key, "a number")
    return value


def _error(item: Item, key: str, expected: str) -> TownError:
    what = f"{item.source}: {key} of {item.id!r} ({AUTHOR_PREFIX}{item.kind})"
    return TownError(
        f"{what} is {item.tags[key].strip()!r}; expected {expected}: correct the <param>"
    )


def _stop_things(items: list[Item], place: FreeGround, lefthand: bool) -> list[StandingObject]:
    """What stands at SUMO's stops, and at mapped ones of which SUMO knows nothing."""
    found: list[StandingObject] = []
    known = [item for item in items if item.group == "stop"]
    middles = shapely.MultiPoint([item.points_W_m[1] for item in known])
    # A pole near the front of the stop looks at the traffic, and a shelter near its middle at the
    # road. Both are on the side where people wait.
    for item in known:
        start, middle, end = item.points_W_m
        along = unit(end - start)
        aside = left_of(along) * (1.0 if lefthand else -1.0)
        pole_m = end - min(1.0, 0.25 * float(np.hypot(*(end - start)))) * along
        found += place.put("stop_pole", _outward(pole_m, along, aside), yaw_of(-along))
        found += place.put("shelter", _outward(middle, along, aside, 1.2), yaw_of(-aside))
    for item in items:
        if item.group == "highway" and item.kind == "bus_stop" and not item.author:
            here = shapely.Point(item.points_W_m.mean(axis=0))
            if middles.is_empty or not shapely.dwithin(middles, here, _SAME_STOP_M):
                found += _mapped_stop(item, place)
    return found


def _mapped_stop(item: Item, place: FreeGround) -> list[StandingObject]:
    """A pole where the map has it, or near by; a shelter only where the map has one."""
    middle = item.points_W_m.mean(axis=0)
    nearest = shapely.get_coordinates(shapely.shortest_line(place.low, shapely.Point(middle)))
    towards = nearest[0] - middle if len(nearest) else np.array([0.0, 1.0])
    distance_m = float(np.hypot(*towards))
    aside = -towards / distance_m if distance_m > 1e-6 else np.array([0.0, -1.0])
    along = left_of(aside)
    for kind in ("shelter", "stop_pole") if item.tags.get("shelter") == "yes" else ("stop_pole",):
        found = place.put(kind, _outward(middle, along, aside, 0.0, 3.0), yaw_of(-aside))
        if found:
            return found
    return []


def _outward(
    start_m: F64, along: F64, aside: F64, least_m: float = 0.5, most_m: float = FARTHEST_M
) -> Iterator[F64]:
    """Places beside a point, the nearest to the road first."""
    for aside_m in np.arange(least_m, most_m, STEP_M):
        for along_m in ALONG_M:
            yield start_m + aside_m * aside + along_m * along


def _place_mapped(items: list[Item], place: FreeGround) -> list[StandingObject]:
    """All mapped furniture that finds a place beside what is standing already, not the author's."""
    site = _Site(place)
    found: list[StandingObject] = []
    for item in items:
        if item.author or item.group in _FLAT_GROUPS or off_ground(item.tags):
            continue
        things = _make_mapped(item, site)
        place.take(things)
        found += things
    return found


class _Site:
    """A place, and quick answers about what lies near a point of it."""

    def __init__(self, place: FreeGround) -> None:
        self.place = place
        self.near = tuple(Patches(area) for area in (place.lines, place.low, place.solids))
        parts = shapely.get_parts(place.lines)
        self._ways = parts[shapely.length(parts) > 0.0]
        self._tree = shapely.STRtree(self._ways)

    def away(self, xy_m: F64) -> F64:
        """Unit vector (2,) from the nearest walking line to a point."""
        if len(self._ways):
            point = shapely.Point(xy_m)
            nearest = self._ways[int(self._tree.nearest(point))]
            away = xy_m - shapely.get_coordinates(shapely.shortest_line(nearest, point))[0]
            length_m = float(np.hypot(*away))
            if length_m > 1e-6:
                return np.asarray(away / length_m)
        return np.array([0.0, 1.0])


def _make_mapped(item: Item, site: _Site) -> list[StandingObject]:
    points_m = item.points_W_m
    is_line = len(points_m) > 1
    if item.kind in _LINE_SPECS and is_line:
        return _barriers(item, site)
    if item.kind in _ROW_STEPS_M and is_line:
        kind, step_m = _ROW_STEPS_M[item.kind]
        found: list[StandingObject] = []
        for line in shapely.get_parts(shapely.LineString(points_m).intersection(site.place.hull)):
            if line.geom_type == "LineString" and line.length > 0.0:
                count = max(1, round(line.length / step_m))
                shares = np.linspace(0.0, 1.0, count + 1)
                stations = shapely.line_interpolate_point(line, shares, normalized=True)
                for xy_m in shapely.get_coordinates(stations):
                    found += _beside(item, kind, xy_m, site)
        return found
    kind = _pick_look(item)
    if not kind or (is_line and not item.filled):
        return []
    # An outline ends where it starts, so its last point does not count.
    middle = (points_m[:-1] if len(points_m) > 3 else points_m).mean(axis=0)
    return _beside(item, kind, middle, site)


def _pick_look(item: Item) -> str:
    """The look of a mapped point, "" for what would not be visible there."""
    key, looks = _LOOK_BY_TAG.get(f"{item.group}.{item.detail}", ("", {}))
    look = looks.get(item.tags.get(key, ""), LOOK_OF.get(item.kind))
    if look is not None:
        return look
    return "bollard" if item.group == "barrier" and len(item.points_W_m) == 1 else ""


def _beside(item: Item, kind: str, middle: F64, site: _Site) -> list[StandingObject]:
    """The thing where it is mapped, or as little aside as needed, or none."""
    away = site.away(middle)
    # The tag has a point of the compass or degrees from north. Without it things look at those who
    # walk by.
    text = item.tags.get("direction", "").strip().upper()
    if text in _COMPASS:
        degrees: float | None = _COMPASS.index(text) * 360.0 / len(_COMPASS)
    else:
        degrees = metres(text)
    facing_rad = yaw_of(-away) if degrees is None else yaw_from_sumo(degrees)
    places_m = (middle + shift_m * away for shift_m in SHIFTS_M)
    return site.place.room_for(kind, places_m, facing_rad)


def _barriers(item: Item, site: _Site) -> list[StandingObject]:
    """A fence, wall or hedge, with gaps where people walk and vehicles drive."""
    height_m, thick_m, class_id = _LINE_SPECS[item.kind]
    mapped_m = metres(item.tags.get("height", ""))
    if mapped_m is not None:
        height_m = float(np.clip(mapped_m, 0.3, 6.0))
    if item.filled and item.tags.get("area") == "yes" and len(item.points_W_m) > 3:
        shape = shapely.make_valid(Polygon(item.points_W_m)).intersection(site.place.hull)
        band: BaseGeometry = valid(shape.simplify(0.1))
    else:
        line = shapely.LineString(item.points_W_m).simplify(0.1).intersection(site.place.hull)
        band = line.buffer(thick_m / 2, cap_style="flat", join_style="mitre")
    if band.is_empty:
        return []
    near = band.buffer(2.0).bounds
    lines, low, solid = (patches.near(near) for patches in site.near)
    blocked = shapely.union_all([lines.buffer(CLEAR_M + thick_m, quad_segs=2), low, solid])
    # What is left goes on a grid of a centimetre, without crumbs.
    found: list[StandingObject] = []
    for part in shapely.get_parts(band.difference(blocked)):
        for area in polygons_of(shapely.set_precision(part, 0.01), 0.05):
            if area.is_valid:
                outline = shapely.segmentize(area, LONGEST_M)
                piece = solid_shapes.prism(outline, FOOT_M, height_m, class_id)
                found.append(_thing(area, piece))
    return found
