"""What a map says of the ground and of stops, as elements of a town's additional file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.sax.saxutils import quoteattr

import numpy as np
import shapely

from wcsim.towns.ground.crossing_paint import CrossingMark, unmarked_points, unpainted
from wcsim.towns.sumo.net import Edge, Lane, LaneKind, Net, points
from wcsim.towns.sumo.xml_io import read_root
from wcsim.types import F64

_STOP_M = 14.0  # a bus, and a little
_POLE_M = 12.0  # from a lane to the pole beside it
_ON_LANE_M = 1.0  # so near to its middle a pole stands on the lane
_SQUARES = ("place.square", "highway.pedestrian")


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
    marks = [CrossingMark(at_m=_place(poi), tags=_tags(poi)) for poi in _points(root, "highway.crossing")]
    plain = unpainted(net, marks)
    squares = [each for each in root.iterfind("poly") if each.get("type") in _SQUARES and _closed(each)]
    for square in squares:
        square.set("id", f"square.{square.get('id')}")  # it may be a polygon of another type already
    stops = _stops(net, _points(read_root(poly), "highway.bus_stop"))
    elements = (*stops, *map(_text, squares), *unmarked_points(plain))
    return MapMarks(elements=elements, stops=len(stops), unpainted=len(plain))


def _stops(net: Net, poles: list[Element]) -> list[str]:
    """A stop on the lane that each pole stands beside, on the side where people wait; each place once."""
    lanes = [lane for edge in net.edges if not edge.function if (lane := _bus_lane(edge)) is not None]
    lines = [shapely.LineString(lane.points_m) for lane in lanes]
    tree = shapely.STRtree(lines)
    found: list[str] = []
    taken: dict[str, list[float]] = {}
    for pole in poles:
        point = shapely.Point(_place(pole))
        near = [int(index) for index in tree.query(point, predicate="dwithin", distance=_POLE_M)]
        near = [index for index in near if _waits(lines[index], point, net.lefthand)]
        index = min(near, key=lambda index: (lines[index].distance(point), lanes[index].id), default=None)
        if index is None:
            continue
        lane = lanes[index]
        middle_m = float(lines[index].project(point, normalized=True)) * lane.length_m
        middle_m = min(max(middle_m, _STOP_M / 2), lane.length_m - _STOP_M / 2)
        if all(abs(middle_m - other_m) > _STOP_M for other_m in taken.get(lane.id, [])):
            taken.setdefault(lane.id, []).append(middle_m)
            span = f'startPos="{middle_m - _STOP_M / 2:.2f}" endPos="{middle_m + _STOP_M / 2:.2f}"'
            name = _tags(pole).get("name", "")  # SUMO takes no empty one
            named = f"id={quoteattr('stop.' + pole.get('id', ''))}" + (f" name={quoteattr(name)}" if name else "")
            found.append(f"<busStop {named} lane={quoteattr(lane.id)} {span}/>")
    return found


def _bus_lane(edge: Edge) -> Lane | None:
    """The lane at the kerb where a bus may stop, of an edge that is long enough."""
    lanes = (lane for lane in edge.lanes if lane.kind is LaneKind.MOTOR and lane.permits("bus"))
    return next((lane for lane in lanes if lane.length_m > _STOP_M + 1.0 and len(lane.points_m) > 1), None)


def _waits(line: shapely.LineString, pole: shapely.Point, lefthand: bool) -> bool:
    """Whether a pole stands on the side of a lane where people wait, or on the lane."""
    at_m = line.project(pole)
    start, end = (line.interpolate(min(max(at_m + step_m, 0.0), line.length)) for step_m in (-0.5, 0.5))
    left_m = (end.x - start.x) * (pole.y - start.y) - (end.y - start.y) * (pole.x - start.x)
    return bool((left_m > 0.0) == lefthand or line.distance(pole) < _ON_LANE_M)


def _points(root: Element, kind: str) -> list[Element]:
    return [poi for poi in root.iterfind("poi") if poi.get("type") == kind and "x" in poi.attrib]


def _place(poi: Element) -> F64:
    return np.asarray(points(f"{poi.get('x')},{poi.get('y')}", (0, 0))[0])


def _closed(poly: Element) -> bool:
    places = poly.get("shape", "").split()
    return len(places) > 3 and places[0] == places[-1]


def _tags(element: Element) -> dict[str, str]:
    return {param.get("key", ""): param.get("value", "") for param in element.iterfind("param")}


def _text(element: Element) -> str:
    """One line."""
    for part in element.iter():
        part.text = part.tail = None
    return ElementTree.tostring(element, encoding="unicode")
