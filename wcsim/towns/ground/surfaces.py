"""What the ground of a town is, as polygons: carriageway, crossings, pavement, and the rest.

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
# Half of the width below which a strip of road or between roads is not worth a kerb.
_STRIP_M = 0.35
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
_BUILT_UP = frozenset(
    ("residential", "commercial", "retail", "industrial", "construction", "railway", "civil")
)
_SQUARES = (("place", "square"), ("highway", "pedestrian"))
_GREEN = {
    "landuse": (
        "grass forest meadow village_green recreation_ground cemetery allotments farmland orchard "
        "vineyard flowerbed greenery basin plant_nursery"
    ),
    "leisure": "park garden pitch golf_course nature_reserve dog_park common",
    "natural": "water wood grassland scrub beach",
}
"""Ground that stays as it grows, by group of SUMO's type."""
NOT_ON_GROUND = frozenset(
    ("underground", "multi-storey", "rooftop", "carports", "garage_boxes", "sheds")
)
"""Car parks that are no ground, by the map's tag `parking`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Surfaces:
    """Disjoint areas that together fill `hull`, in W; the terrain is what is left of it."""

    low: BaseGeometry  # carriageway and crossings: height 0
    crossing: BaseGeometry  # part of `low`
    # Part of `crossing`: it looks like the road.
    unpainted: BaseGeometry = field(default_factory=MultiPolygon)
    rail: BaseGeometry  # part of `low` that rail vehicles have to themselves
    pavement: BaseGeometry
    hull: BaseGeometry
    # Part of the terrain: yards, ground of a town.
    paved: BaseGeometry = field(default_factory=MultiPolygon)
    parking: BaseGeometry = field(default_factory=MultiPolygon)  # part of the terrain: car parks


def make_surfaces(
    net: Net, chair_ways: tuple[str, ...], unmarked: Collection[str] = ()
) -> Surfaces:
    """Derive the areas from a net.

    A carriageway wins over a footway drawn on it, a crossing wins over both.

    Args:
        net: The net, on its land.
        chair_ways: What counts as pavement.
        unmarked: Edges of crossings without paint.
    """
    # 1. Take the ground of the lanes.
    low_lanes, walk_lanes = _split(net, chair_ways)
    streets = [lane for lane in low_lanes if not lane.internal]
    motor = ground_of(lane for lane in streets if lane.kind in (LaneKind.MOTOR, LaneKind.RAIL))
    other, crossing = ground_of(low_lanes), ground_of(net.lanes(LaneKind.CROSSING))
    walk = ground_of([*walk_lanes, *net.lanes(LaneKind.WALKINGAREA)])
    junctions = shapely.union_all(
        [_polygon(j.outline_m) for j in net.junctions if j.kind != "internal"]
    )

    # 2. Add corners that no vehicle comes near to what is walked on: SUMO's walking areas leave
    # them out.
    corners = _opened(junctions.difference(walk).difference(_driven_on(other)), 0.2)
    shapely.prepare(walk)
    parts = shapely.get_parts(corners)
    beside = [part for part in parts if shapely.dwithin(walk, part, _CLOSE_M)]
    walk = walk.union(shapely.union_all(beside))

    # 3. Take junctions as road, without strips too narrow for a kerb.
    inner = shapely.union_all([junctions, other]).difference(buffered(walk, GRID_M))
    low = shapely.union_all([motor, inner, crossing])
    both = _cleaned(shapely.union_all([low, walk]))
    narrow = [lane_area(lane) for lane in streets if lane.width_m < 2.1 * _STRIP_M]
    low = shapely.union_all([_opened(_closed(low, _STRIP_M), _STRIP_M), *narrow])

    # 4. Leave out small bits of junction that no vehicle drives on: they would be holes in the
    # pavement.
    shapely.prepare(motor)
    parts = shapely.get_parts(low)
    driven = [part for part in parts if part.area > _POCKET_M2 or shapely.intersects(motor, part)]
    low = _without_small_holes(_cleaned(MultiPolygon(driven)), walk)

    # 5. The rest of what is walked on is pavement. Crossings are drawn out to meet it.
    pavement = shapely.set_precision(_opened(both.difference(low), 0.05), GRID_M)
    painted = [lane for lane in net.lanes(LaneKind.CROSSING) if lane.edge_id not in unmarked]
    plain = [lane for lane in net.lanes(LaneKind.CROSSING) if lane.edge_id in unmarked]
    crossing = _with_ends([*painted, *plain], low, pavement)
    unpainted = crossing.difference(_with_ends(painted, low, pavement)) if plain else MultiPolygon()
    return Surfaces(
        low=low,
        crossing=_areas(crossing),
        unpainted=_areas(unpainted),
        rail=_rail(low_lanes, low, [crossing, junctions]),
        pavement=_areas(pavement),
        hull=shapely.set_precision(both.convex_hull.buffer(MARGIN_M, quad_segs=2), GRID_M),
    )


def covered(surfaces: Surfaces, items: Iterable[Item], net: Net) -> Surfaces:
    """The same areas with what a map knows of the rest of the ground.

    Squares are pavement, and so are cycle paths on them: only kerbs of streets and rails lie across
    a square. What is `paved` and `parking` is terrain.
    """
    # 1. Find car parks on the ground, and what is green.
    items = [item for item in items if not item.author and len(item.points_W_m) > 3]
    car_parks = [item for item in items if (item.group, item.kind) == ("amenity", "parking")]
    parking = _area(
        item
        for item in car_parks
        if item.tags.get("parking", "surface") not in NOT_ON_GROUND
        and item.tags.get("layer", "0") == "0"
    )
    greens = [item for item in items if item.kind in _GREEN.get(item.group, "").split()]
    green = _area(greens)

    # 2. Make the bare ground of squares pavement, but for the streets over it.
    bare = _bare_squares(items, [_area([item]) for item in greens], parking)
    if bare:
        square = shapely.union_all(bare)
        street = _driven_on(ground_of(net.lanes(LaneKind.MOTOR, LaneKind.RAIL)))
        off_square = surfaces.low.difference(square.difference(street))
        low = _areas(shapely.set_precision(off_square, GRID_M))
        walked = _cleaned(surfaces.pavement.union(square)).intersection(surfaces.hull)
        surfaces = replace(
            surfaces,
            low=low,
            crossing=_areas(surfaces.crossing.intersection(low)),
            unpainted=_areas(surfaces.unpainted.intersection(low)),
            pavement=_areas(shapely.set_precision(walked.difference(low), GRID_M)),
        )

    # 3. Pave the ground between the houses of a town.
    houses = _area(item for item in items if item.group == "building")
    quarters = _area(item for item in items if item.group == "landuse" and item.kind in _BUILT_UP)
    yards = buffered(buffered(houses, BESIDE_M + GAP_M, quad_segs=2), -GAP_M, quad_segs=2)
    paved = shapely.union_all([yards, quarters]).difference(green).difference(parking)
    return replace(surfaces, paved=_on_land(paved, surfaces), parking=_on_land(parking, surfaces))


def walkable_lanes(net: Net, chair_ways: tuple[str, ...]) -> list[Lane]:
    """Lanes that count as pavement in this town."""
    return _split(net, chair_ways)[1]


def ground_of(lanes: Iterable[Lane]) -> BaseGeometry:
    """The ground that lanes cover together."""
    return shapely.union_all([lane_area(lane) for lane in lanes])


def lane_area(lane: Lane) -> BaseGeometry:
    """The ground that a lane covers: a walking area's outline, or a line as wide as the lane is."""
    if lane.kind is LaneKind.WALKINGAREA:
        return _polygon(lane.points_m)
    if not lane.is_line:
        return Polygon()
    points_m = distinct(lane.points_m)
    if len(points_m) < 2:
        return Polygon()
    return shapely.LineString(points_m).buffer(
        lane.width_m / 2, cap_style="flat", join_style="mitre", mitre_limit=2.0
    )


def _split(net: Net, chair_ways: tuple[str, ...]) -> tuple[list[Lane], list[Lane]]:
    """Lanes at the height of the road, and those that are pavement."""
    low: list[Lane] = []
    walk: list[Lane] = []
    for edge in net.edges:
        # Where chairs may use it, a cycle track beside no road is pavement.
        tracks_only = all(lane.kind in WALK_KINDS | {LaneKind.BIKE} for lane in edge.lanes)
        is_track = tracks_only and "cycleway" in chair_ways
        for lane in edge.lanes:
            if lane.kind in WALK_KINDS or (lane.kind is LaneKind.BIKE and is_track):
                walk.append(lane)
            elif lane.kind in (LaneKind.MOTOR, LaneKind.RAIL, LaneKind.BIKE):
                low.append(lane)
    return low, walk


def _without_small_holes(low: BaseGeometry, walk: BaseGeometry) -> BaseGeometry:
    """Road without small islands of grass, as inside a lane that turns round at a dead end."""
    shapely.prepare(walk)
    holes = [Polygon(ring) for part in shapely.get_parts(low) for ring in part.interiors]
    holes = [hole for hole in holes if hole.area < _HOLE_M2]
    small = [hole for hole in holes if walk.intersection(hole).area < _CRUMB_M2]
    if not small:
        return low
    return _areas(shapely.set_precision(shapely.union_all([low, *small]), GRID_M))


def _bare_squares(
    items: Iterable[Item], lawns: list[BaseGeometry], parking: BaseGeometry
) -> list[BaseGeometry]:
    """The bare ground of each square.

    A lawn or a car park lies on a square that is larger, and a park around one that is smaller.
    """
    tree = shapely.STRtree(lawns)
    bare: list[BaseGeometry] = []
    for item in items:
        closed = bool((item.points_W_m[0] == item.points_W_m[-1]).all())
        if not closed or (item.group, item.kind) not in _SQUARES:
            continue
        area = _area([item])
        smaller = [lawns[k] for k in tree.query(area) if lawns[k].area < area.area]
        bare.append(area.difference(shapely.union_all([parking, *smaller])))
    return bare


def _polygon(points_m: np.ndarray) -> BaseGeometry:
    """A polygon from an outline that may cross itself, as some walking areas of SUMO do."""
    if len(points_m) < 3:
        return Polygon()
    polygon = Polygon(points_m)
    return polygon if polygon.is_valid else _areas(shapely.make_valid(polygon))


def _driven_on(ways: BaseGeometry) -> BaseGeometry:
    """Ways of vehicles, a little more, and what lies between them."""
    return buffered(buffered(ways, _DRIVEN_M, quad_segs=2), 0.5 - _DRIVEN_M, quad_segs=2)


def _with_ends(crossings: list[Lane], low: BaseGeometry, pavement: BaseGeometry) -> BaseGeometry:
    """The areas of crossings, drawn out to meet the pavement."""
    # SUMO ends a crossing at the junction's own outline, so road lies between it and the pavement.
    shapely.prepare(pavement)
    roads, pavements = Patches(low), Patches(pavement)
    reaches: list[BaseGeometry] = []
    for lane in crossings:
        area = lane_area(lane)
        for end, inner in ((0, 1), (-1, -2)):
            end_m = lane.points_m[end]
            along = unit(end_m - lane.points_m[inner])
            ahead = shapely.LineString([end_m - 0.1 * along, end_m + REACH_M * along])
            strip = ahead.buffer(lane.width_m / 2, cap_style="flat")
            bounds = strip.bounds
            road = strip.difference(pavements.near(bounds)).intersection(roads.near(bounds))
            parts = [part for part in polygons_of(road) if part.intersects(area)]
            reaches += [part for part in parts if shapely.dwithin(pavement, part, 2 * GRID_M)]
    whole = shapely.union_all([ground_of(crossings).intersection(low), *reaches])
    return shapely.set_precision(whole, GRID_M)


def _rail(lanes: list[Lane], low: BaseGeometry, taken: list[BaseGeometry]) -> BaseGeometry:
    """Where only rail vehicles drive, between junctions."""
    rail = ground_of(lane for lane in lanes if lane.kind is LaneKind.RAIL and not lane.internal)
    if rail.is_empty:
        return MultiPolygon()
    others = [lane_area(lane) for lane in lanes if lane.kind is not LaneKind.RAIL]
    own = _opened(rail.difference(shapely.union_all([*others, *taken])), _STRIP_M)
    own = valid(own.simplify(_SIMPLIFY_M)).intersection(low)
    parts = shapely.get_parts(_areas(shapely.set_precision(own, GRID_M)))
    return MultiPolygon([part for part in parts if part.area > _POCKET_M2])


def _cleaned(area: BaseGeometry) -> BaseGeometry:
    """Gaps closed, points thinned and put on the grid."""
    thinned = valid(_closed(area, _CLOSE_M).simplify(_SIMPLIFY_M))
    return _areas(shapely.set_precision(thinned, GRID_M))


def _closed(area: BaseGeometry, half_m: float) -> BaseGeometry:
    """With gaps narrower than twice `half_m` filled."""
    return _mitred(_mitred(area, half_m), -half_m)


def _opened(area: BaseGeometry, half_m: float) -> BaseGeometry:
    """Without strips narrower than twice `half_m`."""
    wide = _mitred(_mitred(area, -half_m), half_m)
    # GEOS fails at nothing.
    return MultiPolygon() if wide.is_empty else _areas(wide.intersection(area))


def _mitred(area: BaseGeometry, distance_m: float) -> BaseGeometry:
    return buffered(area, distance_m, join_style="mitre", mitre_limit=2.0)


def _areas(geometry: BaseGeometry) -> BaseGeometry:
    """Only the polygons of a geometry, crumbs left out."""
    return MultiPolygon(polygons_of(geometry, _LEAST_PART_M2))


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
