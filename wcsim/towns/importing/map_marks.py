"""Car parks, squares and stops of a map, as elements of a town's additional and route files.

Parked cars are in SUMO parking areas on the car parks that OpenStreetMap maps, partly taken from
the start. A space is only made where nobody drives or walks: off the carriageway, the pavements,
the crossings and the buildings.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.sax.saxutils import quoteattr

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.core.frames import rad2deg
from wcsim.core.seeding import make_rng
from wcsim.towns.furniture.road_marks import GROUP, KIND, crossing_lines
from wcsim.towns.ground.plane_geometry import yaw_of
from wcsim.towns.ground.solid_shapes import rectangle
from wcsim.towns.ground.surfaces import NOT_ON_GROUND, ground_of
from wcsim.towns.osm.tags import meanings
from wcsim.towns.sumo.net import Lane, LaneKind, Net, points
from wcsim.towns.sumo.xml_io import read_root
from wcsim.types import F64

_STOP_M = 14.0  # a bus, and a little
_POLE_M = 12.0  # from a lane to the pole beside it
_ON_LANE_M = 1.0  # so near to its middle a pole stands on the lane
_REACH_M = 12.0  # from a crossing of a map to the one that it is in the net
_SQUARES = ("place.square", "highway.pedestrian")
_SPACE_M = (5.0, 2.5)  # across the way that leads to it: length and width
_PARALLEL_M = (5.6, 2.2)  # along it
_AISLE_M = 6.0
_MOST_SPACES = 150  # of a town: each parked car costs SUMO a little in every step
NEAR_M = 60.0  # from a car park to the street that leads to it
_LEAST_LANE_M = 12.0
FREE_M = 0.3  # between a space and what is driven or walked on
INSIDE_M = 10.0  # beyond the outermost streets; the ground ends soon after
CAR = "parked"
_CAR_NOSE_M = 2.4  # from the middle of a space
_STAY_S = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class MapMarks:
    """What goes into an additional file, and how much of it there is."""

    elements: tuple[str, ...] = ()
    stops: int = 0
    unpainted: int = 0  # crossings


def map_marks(net: Net, poly: Path, ground: Path) -> MapMarks:
    """The stops of buses, the squares, and which crossings have no paint.

    Args:
        net: The finished net.
        poly: What polyconvert made of polytypes.xml.
        ground: What it made of groundtypes.xml.
    """
    root = read_root(ground)
    plain = _unpainted(net, _points(root, "highway.crossing"))
    squares = []
    for square in root.iterfind("poly"):
        places = square.get("shape", "").split()
        is_closed = len(places) > 3 and places[0] == places[-1]
        if is_closed and square.get("type") in _SQUARES:
            # It may be a polygon of another type already.
            square.set("id", f"square.{square.get('id')}")
            squares.append(square)
    stops = _stops(net, _points(read_root(poly), "highway.bus_stop"))
    elements = (*stops, *map(_text, squares), *map(_unmarked_point, plain))
    return MapMarks(elements=elements, stops=len(stops), unpainted=len(plain))


def find_parking(net: Net, poly: Path, taken: float, seed: int) -> tuple[list[str], list[str]]:
    """Parking areas for a town's car parks, and cars in a share `taken` of their spaces.

    Both are XML elements, of an additional file and of a route file, in which the cars come before
    everything else.
    """
    areas: list[str] = []
    vehicles: list[str] = []
    root = read_root(poly)
    lots = sorted(_lots(root))
    lanes = _lanes_for_cars(net)
    if not lots or taken <= 0.0 or not lanes:
        return areas, vehicles
    lines = [shapely.LineString(lane.points_m) for lane in lanes]
    town, used = _town_and_used(net, root)
    tree, left = shapely.STRtree(lines), _MOST_SPACES
    rng = make_rng(seed, "parking")
    for lot_id, lot in lots:
        # 1. Spaces where nothing else is, on a car park that a street leads to.
        marks = ((space, space.footprint()) for space in _spaces(lot))
        free = [space for space, mark in marks if town.contains(mark) and not used.intersects(mark)]
        spaces, nearest = free[:left], int(tree.nearest(lot))
        if not spaces or lines[nearest].distance(lot) > NEAR_M:
            continue
        left -= len(spaces)
        # 2. SUMO fills them one after the other, so their order is drawn.
        spaces = [spaces[i] for i in rng.permutation(len(spaces))]
        name, lane = f"lot.{lot_id}", lanes[nearest]
        areas += _area(name, lane, lines[nearest], lot, spaces)
        # 3. Cars that stand there from the start, and never leave.
        stop = f'<stop parkingArea={quoteattr(name)} duration="{_STAY_S}"/>'
        route = f"<route edges={quoteattr(lane.edge_id)}/>"
        for number in range(round(taken * len(spaces))):
            head = f'<vehicle id={quoteattr(f"{CAR}.{name}.{number}")} type="cars"'
            vehicles.append(f'{head} depart="0" departPos="stop">{route}{stop}</vehicle>')
    return areas, vehicles


def _unpainted(net: Net, marks: list[Element]) -> list[Lane]:
    """The crossings of a net without paint: by their nearest mark, or without mark and signal.

    A mark is that of the crossing nearest to it.
    """
    lanes, tree = crossing_lines(net)
    painted = {edge_id: (math.inf, True) for edge_id in net.signalled()}
    for mark in marks if lanes else ():
        paint = meanings("crossings", _tags(mark)).get("paint") != "no"
        near, far_m = tree.query_nearest(
            shapely.Point(_place(mark)),
            max_distance=_REACH_M,
            return_distance=True,
            all_matches=False,
        )
        for index, gap_m in zip(near.tolist(), far_m.tolist(), strict=True):
            edge_id = lanes[index].edge_id
            painted[edge_id] = min(painted.get(edge_id, (math.inf, False)), (gap_m, paint))
    return [lane for lane in lanes if not painted.get(lane.edge_id, (0.0, False))[1]]


def _stops(net: Net, poles: list[Element]) -> list[str]:
    """A stop on the lane that each pole stands beside, where people wait; each place once."""
    # 1. The lane at the kerb where a bus may stop, of each edge that is long enough.
    lanes: list[Lane] = []
    for edge in net.streets:
        open_to_buses = (
            lane for lane in edge.lanes if lane.kind is LaneKind.MOTOR and lane.permits("bus")
        )
        long_enough = (
            lane for lane in open_to_buses if lane.length_m > _STOP_M + 1.0 and lane.is_line
        )
        lanes += itertools.islice(long_enough, 1)
    lines = [shapely.LineString(lane.points_m) for lane in lanes]
    tree = shapely.STRtree(lines)
    found: list[str] = []
    middles_m: dict[str, list[float]] = {}  # of the stops on each lane
    for pole in poles:
        # 2. The nearest of them on whose side the pole stands.
        point = shapely.Point(_place(pole))
        near = [int(index) for index in tree.query(point, predicate="dwithin", distance=_POLE_M)]
        near = [index for index in near if _waits(lines[index], point, net.lefthand)]
        index = min(
            near, key=lambda index: (lines[index].distance(point), lanes[index].id), default=None
        )
        if index is None:
            continue
        # 3. A stop there, unless another is too near.
        lane = lanes[index]
        middle_m = float(lines[index].project(point, normalized=True)) * lane.length_m
        middle_m = min(max(middle_m, _STOP_M / 2), lane.length_m - _STOP_M / 2)
        others_m = middles_m.setdefault(lane.id, [])
        if all(abs(middle_m - other_m) > _STOP_M for other_m in others_m):
            others_m.append(middle_m)
            span = f'startPos="{middle_m - _STOP_M / 2:.2f}" endPos="{middle_m + _STOP_M / 2:.2f}"'
            name = _tags(pole).get("name", "")  # SUMO takes no empty one
            named = f"id={quoteattr('stop.' + pole.get('id', ''))}"
            named += f" name={quoteattr(name)}" if name else ""
            found.append(f"<busStop {named} lane={quoteattr(lane.id)} {span}/>")
    return found


def _waits(line: shapely.LineString, pole: shapely.Point, lefthand: bool) -> bool:
    """Whether a pole stands on the side of a lane where people wait, or on the lane."""
    at_m = line.project(pole)
    start, end = (
        line.interpolate(min(max(at_m + step_m, 0.0), line.length)) for step_m in (-0.5, 0.5)
    )
    left_m = (end.x - start.x) * (pole.y - start.y) - (end.y - start.y) * (pole.x - start.x)
    return bool((left_m > 0.0) == lefthand or line.distance(pole) < _ON_LANE_M)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Space:
    middle_m: F64  # (2,)
    yaw_rad: float  # of a car in it
    length_m: float
    width_m: float

    def footprint(self) -> Polygon:
        return rectangle(self.middle_m, self.length_m, self.width_m, self.yaw_rad)


def _lots(root: Element) -> Iterator[tuple[str, Polygon]]:
    """Ids and outlines of the car parks at ground level."""
    for element in root.iterfind("poly"):
        tags = _tags(element)
        if (
            element.get("type") == "amenity.parking"
            and tags.get("parking", "surface") not in NOT_ON_GROUND
        ):
            outline_m = points(element.get("shape", ""), (0, 0))
            lot = Polygon(outline_m) if len(outline_m) > 3 else Polygon()
            if (
                lot.is_valid
                and lot.area > _PARALLEL_M[0] * _PARALLEL_M[1]
                and tags.get("layer", "0") == "0"
            ):
                yield element.get("id", ""), lot


def _lanes_for_cars(net: Net) -> list[Lane]:
    """The lanes of streets that are long enough to lead to a car park."""
    return [
        lane
        for edge in net.streets
        for lane in edge.lanes
        if lane.permits("passenger") and lane.length_m >= _LEAST_LANE_M and lane.is_line
    ]


def _town_and_used(net: Net, root: Element) -> tuple[BaseGeometry, BaseGeometry]:
    """Where there is ground, which ends near the last streets, and where something is on it."""
    lanes = ground_of(net.every_lane).buffer(FREE_M)
    houses = [
        shapely.make_valid(Polygon(points_m))
        for element in root.iterfind("poly")
        if element.get("type", "").startswith("building")
        and len(points_m := points(element.get("shape", ""), (0, 0))) > 3
    ]
    buildings = shapely.union_all(houses).buffer(FREE_M, quad_segs=2)
    outlines = [junction.outline_m for junction in net.junctions if len(junction.outline_m) > 2]
    junctions = shapely.union_all(
        [shapely.make_valid(Polygon(outline_m)) for outline_m in outlines]
    )
    town, used = lanes.convex_hull.buffer(INSIDE_M), lanes.union(buildings).union(junctions)
    shapely.prepare([town, used])
    return town, used


def _spaces(lot: Polygon) -> list[_Space]:
    """Spaces in rows along the longer side of a car park.

    Where it is narrow there is one row of cars behind each other.
    """
    corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(lot))[:4]
    sides = np.diff(np.vstack([corners, corners[:1]]), axis=0)[:2]
    if np.hypot(*sides[1]) > np.hypot(*sides[0]):
        corners, sides = np.roll(corners, -1, axis=0), np.array([sides[1], -sides[0]])
    long_m, wide_m = float(np.hypot(*sides[0])), float(np.hypot(*sides[1]))
    if wide_m < _PARALLEL_M[1] or long_m < _PARALLEL_M[0]:
        return []
    along, aside = sides[0] / long_m, sides[1] / wide_m
    yaw_rad = yaw_of(along)
    found: list[_Space] = []
    if wide_m < _SPACE_M[0]:
        rows_m, car_m, every_m, turn_rad = [wide_m / 2], _PARALLEL_M, _PARALLEL_M[0], 0.0
    else:
        # Across the car park: row, aisle, row, and again.
        rows_m, car_m, every_m, turn_rad = [], _SPACE_M, _SPACE_M[1], np.pi / 2
        start_m = 0.0
        while start_m + _SPACE_M[0] <= wide_m:
            rows_m.append(start_m + _SPACE_M[0] / 2)
            start_m += _SPACE_M[0] + (_AISLE_M if len(rows_m) % 2 else 0.0)
    for number, across_m in enumerate(rows_m):
        facing_rad = yaw_rad + (turn_rad if number % 2 else -turn_rad)
        for k in range(int(long_m // every_m)):
            middle_m = corners[0] + (k + 0.5) * every_m * along + across_m * aside
            space = _Space(
                middle_m=middle_m, yaw_rad=facing_rad, length_m=car_m[0], width_m=car_m[1]
            )
            if lot.buffer(FREE_M).contains(space.footprint()):
                found.append(space)
    return found


def _area(
    name: str, lane: Lane, line: shapely.LineString, lot: Polygon, spaces: list[_Space]
) -> list[str]:
    share = line.project(shapely.Point(lot.centroid)) / line.length
    end_m = min(max(share * lane.length_m, _LEAST_LANE_M - 1.0), lane.length_m - 0.5)
    nearest = int(np.hypot(*(lane.points_m - np.array(lot.centroid.coords[0])).T).argmin())
    z_m = float(lane.z_m[nearest])
    head = f"<parkingArea id={quoteattr(name)} lane={quoteattr(lane.id)}"
    lines = [
        f'{head} startPos="{max(0.0, end_m - 10.0):.2f}" endPos="{end_m:.2f}" roadsideCapacity="0">'
    ]
    for space in spaces:
        nose = np.array([np.cos(space.yaw_rad), np.sin(space.yaw_rad)])
        x_m, y_m = space.middle_m + _CAR_NOSE_M * nose
        # SUMO's spaces turn counter-clockwise from south.
        angle_deg = (90.0 + rad2deg(space.yaw_rad)) % 360.0
        size = f'width="{space.width_m}" length="{space.length_m}" angle="{angle_deg:.1f}"'
        lines.append(f'    <space x="{x_m:.2f}" y="{y_m:.2f}" z="{z_m:.2f}" {size}/>')
    return [*lines, "</parkingArea>"]


def _unmarked_point(lane: Lane) -> str:
    """The point that says that a crossing has no paint, as an element of an additional file."""
    x_m, y_m = shapely.LineString(lane.points_m).interpolate(0.5, normalized=True).coords[0]
    head = f'<poi id={quoteattr(f"{KIND}.{lane.edge_id}")} type="{GROUP}.{KIND}"'
    return f'{head} x="{x_m:.2f}" y="{y_m:.2f}" color="0.6,0.6,0.6" layer="1"/>'


def _points(root: Element, kind: str) -> list[Element]:
    return [poi for poi in root.iterfind("poi") if poi.get("type") == kind and "x" in poi.attrib]


def _place(poi: Element) -> F64:
    return np.asarray(points(f"{poi.get('x')},{poi.get('y')}", (0, 0))[0])


def _tags(element: Element) -> dict[str, str]:
    return {param.get("key", ""): param.get("value", "") for param in element.iterfind("param")}


def _text(element: Element) -> str:
    """One line."""
    for part in element.iter():
        part.text = part.tail = None
    return ElementTree.tostring(element, encoding="unicode")
