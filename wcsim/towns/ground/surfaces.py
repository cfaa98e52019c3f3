"""What the ground of a town is, as polygons: carriageway, crossings, pavement, and the rest inside the town's edge.

Squares are pavement. Car parks are paved too, and so is the ground between the houses of a town.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.towns.ground.plane_geometry import Patches, buffered, distinct, polygons_of, unit, valid
from wcsim.towns.sumo.additional import Item
from wcsim.towns.sumo.net import WALK_KINDS, Lane, LaneKind, Net

GRID_M = 0.01  # all ground points lie on this grid
_SIMPLIFY_M = 0.05
_CLOSE_M = 0.15  # gaps narrower than twice this are closed
_STRIP_M = 0.35  # half of the width below which a strip of road or between roads is not worth a kerb
_POCKET_M2 = 12.0
_HOLE_M2 = 150.0  # grass inside a turning loop
_CRUMB_M2 = 1.0
_LEAST_PART_M2 = 0.05
REACH_M = 2.5  # how far a crossing is drawn out to meet the pavement
_DRIVEN_M = 3.0  # gaps between ways of vehicles narrower than twice this are road
MARGIN_M = 15.0  # terrain beyond the outermost street
BESIDE_M = 8.0  # of a building the ground is paved
GAP_M = 6.0  # between such ground is paved too: yards
_SIMPLE_M = 0.3
LEAST_M2 = 4.0
_BUILT_UP = frozenset(("residential", "commercial", "retail", "industrial", "construction", "railway", "civil"))
_GREEN = {
    "landuse": (
        "grass forest meadow village_green recreation_ground cemetery allotments farmland orchard vineyard flowerbed "
        "greenery basin plant_nursery"
    ),
    "leisure": "park garden pitch golf_course nature_reserve dog_park common",
    "natural": "water wood grassland scrub beach",
}
"""Ground that stays as it grows, by group of SUMO's type."""
NOT_ON_GROUND = frozenset(("underground", "multi-storey", "rooftop", "carports", "garage_boxes", "sheds"))
"""Car parks that are no ground, by the map's tag `parking`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Surfaces:
    """Disjoint areas that together fill `hull`, in W; the terrain is what is left of it."""

    low: BaseGeometry  # carriageway and crossings: height 0
    crossing: BaseGeometry  # part of `low`
    unpainted: BaseGeometry = field(default_factory=MultiPolygon)  # part of `crossing`: it looks like the road
    rail: BaseGeometry  # part of `low` that rail vehicles have to themselves
    pavement: BaseGeometry
    hull: BaseGeometry
    paved: BaseGeometry = field(default_factory=MultiPolygon)  # part of the terrain: yards, ground of a town
    parking: BaseGeometry = field(default_factory=MultiPolygon)  # part of the terrain: car parks


def make_surfaces(net: Net, chair_ways: tuple[str, ...], unmarked: Collection[str] = ()) -> Surfaces:
    """Derive the areas from a net: a carriageway wins over a footway drawn on it, a crossing wins over both.

    Args:
        net: The net, on its land.
        chair_ways: What counts as pavement.
        unmarked: Edges of crossings without paint.
    """
    low_lanes, walk_lanes = _split(net, chair_ways)
    streets = [lane for lane in low_lanes if not lane.internal]
    motor = ground_of(lane for lane in streets if lane.kind in (LaneKind.MOTOR, LaneKind.RAIL))
    other, crossing = ground_of(low_lanes), ground_of(net.lanes(LaneKind.CROSSING))
    walk = ground_of([*walk_lanes, *net.lanes(LaneKind.WALKINGAREA)])
    junctions = shapely.union_all([_polygon(j.outline_m) for j in net.junctions if j.kind != "internal"])
    walk = walk.union(_corners(junctions, other, walk))
    inner = shapely.union_all([junctions, other]).difference(buffered(walk, GRID_M))
    low = shapely.union_all([motor, inner, crossing])
    both = _cleaned(shapely.union_all([low, walk]))
    narrow = [lane_area(lane) for lane in streets if lane.width_m < 2.1 * _STRIP_M]
    low = shapely.union_all([_opened(_closed(low, _STRIP_M), _STRIP_M), *narrow])
    low = _without_small_holes(_cleaned(_without_pockets(low, motor)), walk)
    pavement = shapely.set_precision(_opened(both.difference(low), 0.05), GRID_M)
    painted = [lane for lane in net.lanes(LaneKind.CROSSING) if lane.edge_id not in unmarked]
    plain = [lane for lane in net.lanes(LaneKind.CROSSING) if lane.edge_id in unmarked]
    crossing = _with_ends([*painted, *plain], low, pavement)
    unpainted = crossing.difference(_with_ends(painted, low, pavement)) if plain else MultiPolygon()
    hull = shapely.set_precision(both.convex_hull.buffer(MARGIN_M, quad_segs=2), GRID_M)
    rail = _rail(low_lanes, low, [crossing, junctions])
    return Surfaces(
        low=low,
        crossing=_areas(crossing),
        unpainted=_areas(unpainted),
        rail=rail,
        pavement=_areas(pavement),
        hull=hull,
    )


def _with_ends(crossings: list[Lane], low: BaseGeometry, pavement: BaseGeometry) -> BaseGeometry:
    """The areas of crossings, drawn out to meet the pavement."""
    areas = ground_of(crossings)
    reaches = _reaches(crossings, low, pavement)
    whole: BaseGeometry = shapely.set_precision(shapely.union_all([areas.intersection(low), *reaches]), GRID_M)
    return whole


def _rail(lanes: list[Lane], low: BaseGeometry, taken: list[BaseGeometry]) -> BaseGeometry:
    """Where only rail vehicles drive, between junctions."""
    rail = ground_of(lane for lane in lanes if lane.kind is LaneKind.RAIL and not lane.internal)
    if rail.is_empty:
        return MultiPolygon()
    others = [lane_area(lane) for lane in lanes if lane.kind is not LaneKind.RAIL]
    own = valid(_opened(rail.difference(shapely.union_all([*others, *taken])), _STRIP_M).simplify(_SIMPLIFY_M))
    parts = shapely.get_parts(_areas(shapely.set_precision(own.intersection(low), GRID_M)))
    return MultiPolygon([part for part in parts if part.area > _POCKET_M2])


def _corners(junctions: BaseGeometry, driven: BaseGeometry, walk: BaseGeometry) -> BaseGeometry:
    """Parts of junctions beside the pavement that no vehicle comes near: SUMO's walking areas leave them out."""
    corners = _opened(junctions.difference(walk).difference(_driven_on(driven)), 0.2)
    shapely.prepare(walk)
    return shapely.union_all([part for part in shapely.get_parts(corners) if shapely.dwithin(walk, part, _CLOSE_M)])


def _driven_on(ways: BaseGeometry) -> BaseGeometry:
    """Ways of vehicles, a little more, and what lies between them."""
    return buffered(buffered(ways, _DRIVEN_M, quad_segs=2), 0.5 - _DRIVEN_M, quad_segs=2)


def _reaches(crossings: list[Lane], low: BaseGeometry, pavement: BaseGeometry) -> list[BaseGeometry]:
    """Road between the end of a crossing and the pavement: SUMO ends a crossing at the junction's own outline."""
    shapely.prepare(pavement)
    roads, pavements = Patches(low), Patches(pavement)
    found: list[BaseGeometry] = []
    for lane in crossings:
        area = lane_area(lane)
        for end, inner in ((0, 1), (-1, -2)):
            along = unit(lane.points_m[end] - lane.points_m[inner])
            ahead = shapely.LineString([lane.points_m[end] - 0.1 * along, lane.points_m[end] + REACH_M * along])
            strip = ahead.buffer(lane.width_m / 2, cap_style="flat")
            strip = strip.difference(pavements.near(strip.bounds)).intersection(roads.near(strip.bounds))
            parts = [part for part in polygons_of(strip) if part.intersects(area)]
            found += [part for part in parts if shapely.dwithin(pavement, part, 2 * GRID_M)]
    return found


def walkable_lanes(net: Net, chair_ways: tuple[str, ...]) -> list[Lane]:
    """Lanes that count as pavement in this town."""
    return _split(net, chair_ways)[1]


def ground_of(lanes: Iterable[Lane]) -> BaseGeometry:
    """The ground that lanes cover together."""
    return shapely.union_all([lane_area(lane) for lane in lanes])


def lane_area(lane: Lane) -> BaseGeometry:
    """The ground that a lane covers: its centre line made as wide as it is; a walking area's own outline."""
    if lane.kind is LaneKind.WALKINGAREA:
        return _polygon(lane.points_m)
    if not lane.is_line:
        return Polygon()
    points_m = distinct(lane.points_m)
    if len(points_m) < 2:
        return Polygon()
    return shapely.LineString(points_m).buffer(lane.width_m / 2, cap_style="flat", join_style="mitre", mitre_limit=2.0)


def _split(net: Net, chair_ways: tuple[str, ...]) -> tuple[list[Lane], list[Lane]]:
    """Lanes at the height of the road, and those that are pavement, as a cycle track is where chairs may use it."""
    low: list[Lane] = []
    walk: list[Lane] = []
    for edge in net.edges:
        tracks_only = all(lane.kind in WALK_KINDS | {LaneKind.BIKE} for lane in edge.lanes)
        for lane in edge.lanes:
            if lane.kind in WALK_KINDS or (lane.kind is LaneKind.BIKE and tracks_only and "cycleway" in chair_ways):
                walk.append(lane)
            elif lane.kind in (LaneKind.MOTOR, LaneKind.RAIL, LaneKind.BIKE):
                low.append(lane)
    return low, walk


def _polygon(points_m: np.ndarray) -> BaseGeometry:
    """A polygon from an outline that may cross itself: SUMO draws some walking areas as bow-ties."""
    if len(points_m) < 3:
        return Polygon()
    polygon = Polygon(points_m)
    return polygon if polygon.is_valid else _areas(shapely.make_valid(polygon))


def _cleaned(area: BaseGeometry) -> BaseGeometry:
    """Gaps closed, points thinned and put on the grid."""
    return _areas(shapely.set_precision(valid(_closed(area, _CLOSE_M).simplify(_SIMPLIFY_M)), GRID_M))


def _closed(area: BaseGeometry, half_m: float) -> BaseGeometry:
    """With gaps narrower than twice `half_m` filled."""
    return _mitred(_mitred(area, half_m), -half_m)


def _mitred(area: BaseGeometry, distance_m: float) -> BaseGeometry:
    return buffered(area, distance_m, join_style="mitre", mitre_limit=2.0)


def _opened(area: BaseGeometry, half_m: float) -> BaseGeometry:
    """Without strips narrower than twice `half_m`."""
    wide = _mitred(_mitred(area, -half_m), half_m)
    return MultiPolygon() if wide.is_empty else _areas(wide.intersection(area))  # GEOS fails at nothing


def _without_pockets(low: BaseGeometry, motor: BaseGeometry) -> BaseGeometry:
    """Without small bits of junction that no vehicle drives on: they would be holes in the pavement."""
    parts = shapely.get_parts(low)
    shapely.prepare(motor)
    return MultiPolygon([part for part in parts if part.area > _POCKET_M2 or shapely.intersects(motor, part)])


def _without_small_holes(low: BaseGeometry, walk: BaseGeometry) -> BaseGeometry:
    """With small islands of grass in the road filled, as a lane that turns round at a dead end leaves one."""
    shapely.prepare(walk)
    holes = [Polygon(ring) for part in shapely.get_parts(low) for ring in part.interiors]
    small = [hole for hole in holes if hole.area < _HOLE_M2 and walk.intersection(hole).area < _CRUMB_M2]
    return _areas(shapely.set_precision(shapely.union_all([low, *small]), GRID_M)) if small else low


def _areas(geometry: BaseGeometry) -> BaseGeometry:
    """Only the polygons of a geometry, crumbs left out."""
    return MultiPolygon(polygons_of(geometry, _LEAST_PART_M2))


def covered(surfaces: Surfaces, items: Iterable[Item], net: Net) -> Surfaces:
    """The same areas with what is known of the rest of the ground: squares are pavement, `paved` and `parking` terrain.

    On a square cycle paths are pavement too: no kerb lies across it but those of streets and rails.
    """
    items = [item for item in items if not item.author and len(item.points_W_m) > 3]
    parking = _area(item for item in items if _is_car_park(item))
    greens = [item for item in items if item.kind in _GREEN.get(item.group, "").split()]
    green = _area(greens)
    lawns = [_area([item]) for item in greens]
    tree = shapely.STRtree(lawns)
    bare: list[BaseGeometry] = []
    for area in [_area([item]) for item in items if _is_square(item)]:
        # A lawn or a car park lies on a square that is larger, and a park around one that is smaller.
        smaller = [lawns[k] for k in tree.query(area) if lawns[k].area < area.area]
        bare.append(area.difference(shapely.union_all([parking, *smaller])))
    if bare:
        square = shapely.union_all(bare)
        street = _driven_on(ground_of(net.lanes(LaneKind.MOTOR, LaneKind.RAIL)))
        low = _areas(shapely.set_precision(surfaces.low.difference(square.difference(street)), GRID_M))
        walked = _cleaned(surfaces.pavement.union(square)).intersection(surfaces.hull)
        surfaces = replace(
            surfaces,
            low=low,
            crossing=_areas(surfaces.crossing.intersection(low)),
            unpainted=_areas(surfaces.unpainted.intersection(low)),
            pavement=_areas(shapely.set_precision(walked.difference(low), GRID_M)),
        )
    houses = _area(item for item in items if item.group == "building")
    quarters = _area(item for item in items if item.group == "landuse" and item.kind in _BUILT_UP)
    yards = buffered(buffered(houses, BESIDE_M + GAP_M, quad_segs=2), -GAP_M, quad_segs=2)
    paved = shapely.union_all([yards, quarters]).difference(green).difference(parking)
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
    return MultiPolygon(polygons_of(area, LEAST_M2))
