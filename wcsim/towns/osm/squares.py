"""Squares of an extract: ground that people cross anywhere, and ways on foot between entries.

netconvert reads no areas, and polyconvert fills their holes. So each square becomes outlines of its
own, with slits to its holes, and netconvert gets ways over it: straight lines between the places
where ways meet the square, around holes, buildings, streets and rails.
"""

import itertools
from collections.abc import Iterable
from math import cos, dist, inf
from xml.etree.ElementTree import Element, SubElement

import networkx
import numpy as np
import shapely
from shapely import GeometryCollection, LineString, MultiLineString, MultiPoint, Point
from shapely.geometry.base import BaseGeometry

from wcsim.core.frames import deg2rad
from wcsim.core.reading import read_module_toml
from wcsim.towns.ground.plane_geometry import polygons_of
from wcsim.towns.osm.tags import off_ground
from wcsim.towns.walking.graph import shortest_inside

_TAGS = {name: frozenset(words.split()) for name, words in read_module_toml(__file__).items()}
_DETOUR = 1.5  # two entries get a way of their own where the others are longer by this factor
_MOST_ENTRIES = 100
_NEAR_M = 0.5  # what is as near to a square touches it
_CLEAR_M = 1.2  # from walls to the middle of a way: half of its width, and a little
_MOUTH_M = 4.0  # around an entry they may be nearer
_STREET_M = 4.0  # half of the width of a street
_THIN_M = 0.3
_SLIT_M = 0.01
_M_PER_DEG = 111_320.0

_Line = list[tuple[float, float]]  # its points in metres


def cross_squares(root: Element, keep_service: bool) -> set[str]:
    """Draw squares as outlines with slits, and ways on foot over them; changes `root`.

    Args:
        root: The extract, without what is not at street level.
        keep_service: Whether the net has driveways and yards.

    Returns:
        The squares that the new ways lead over: "relation 7", or the id of a way without a sign.
    """
    plan = _Plan(root, keep_service)
    squares: dict[str, BaseGeometry] = {}
    for item in [*root.iter("way"), *root.iter("relation")]:
        tags = {tag.get("k", ""): tag.get("v", "") for tag in item.iter("tag")}
        if _is_square(item, tags):
            name = f"{'relation ' * (item.tag == 'relation')}{item.get('id', '').lstrip('-')}"
            squares[name] = plan.area(item)
            item[:] = [tag for tag in item if tag.get("k") not in _TAGS["moved"]]
        else:
            plan.sort(item, tags)
    for polygon in polygons_of(GeometryCollection([*squares.values()])):
        slits = MultiLineString([*shapely.shortest_line(polygon.exterior, list(polygon.interiors))])
        for part in polygons_of(polygon.difference(slits.buffer(_SLIT_M, quad_segs=1))):
            plan.add_way(part.exterior.coords, "place", "square")

    # Squares that lie side by side, or on one another, are one.
    solid, roads, ways = shapely.union_all(plan.solids), MultiLineString(plan.driven), plan.ways
    places = [*ways]
    tree = shapely.STRtree([Point(place) for place in places])
    crossed: set[str] = set()
    for area in polygons_of(
        shapely.union_all([square.buffer(_NEAR_M) for square in squares.values()])
    ):
        inside = ways.subgraph(places[k] for k in tree.query(area, predicate="intersects"))
        for line in _ways_over(
            area.difference(solid), ways, inside, roads.intersection(area.buffer(_STREET_M))
        ):
            plan.add_way(line, "highway", "footway")
            crossed.update(name for name in squares if squares[name].intersects(area))
    if crossed:  # netconvert reads nodes, then ways, then relations
        root[:] = sorted(root, key=lambda item: "nwr".find(item.tag[0]))
    return crossed


def _is_square(item: Element, tags: dict[str, str]) -> bool:
    """Whether a way or a relation is a square on the ground that is open to people."""
    # Without an area people walk along a line.
    is_area = item.tag == "relation" or tags.get("area") == "yes"
    highway = tags.get("highway") if is_area else None
    kind = tags.get("area:highway", tags.get("place", highway))
    is_closed = tags.get("foot", tags.get("access")) in _TAGS["closed"]
    return kind in _TAGS["squares"] and not is_closed and not off_ground(tags)


def _ways_over(
    area: BaseGeometry, ways: networkx.Graph, inside: networkx.Graph, roads: BaseGeometry
) -> list[_Line]:
    """The ways on foot over an area that are lacking; `inside` is what of all `ways` lies there."""
    # An entry is where a way ends on the area, or leaves it.
    entries = sorted(
        place for place in inside if len(ways[place]) < 2 or len(inside[place]) < len(ways[place])
    )
    entries = entries[:: 1 + len(entries) // _MOST_ENTRIES]
    clear = area.buffer(-_CLEAR_M, join_style="mitre").simplify(_THIN_M)
    clear = clear.difference(roads.buffer(_STREET_M, quad_segs=1))
    if entries and not clear.is_empty:  # a way leads to its middle
        entries.append(shapely.maximum_inscribed_circle(clear, tolerance=_NEAR_M).coords[0])
    there = inside.copy()
    there.add_nodes_from(entries)

    # Short ways come first, and a longer one only where those would be a long way round.
    clear = clear.union(area.intersection(MultiPoint(entries).buffer(_MOUTH_M, quad_segs=1)))
    found: list[LineString] = []
    for start, end in sorted(
        itertools.combinations(entries, 2), key=lambda pair: (dist(*pair), pair)
    ):
        lengths_m = networkx.single_source_dijkstra_path_length(
            there, start, weight=lambda p, q, _: dist(p, q)
        )
        round_m = lengths_m.get(end, inf)
        if round_m > _DETOUR * dist(start, end):
            way = shortest_inside(clear, np.array(start), np.array(end))
            line = LineString(way if way is not None else ())
            if 0.0 < line.length < round_m / _DETOUR and not line.crosses(roads):
                found.append(line)
                networkx.add_path(there, line.coords)
    return [list(line.coords) for line in shapely.get_parts(shapely.node(MultiLineString(found)))]


class _Plan:
    """An extract in metres."""

    def __init__(self, root: Element, keep_service: bool) -> None:
        self.solids: list[BaseGeometry] = []
        self.driven: list[_Line] = []
        self.ways = networkx.Graph()  # on foot, from place to place
        self._streets = _TAGS["streets"].union(["service"] * keep_service)
        self._root = root
        self._east_m = _M_PER_DEG * cos(deg2rad(float(next(root.iter("node")).attrib["lat"])))
        places = {
            node.attrib["id"]: (
                float(node.attrib["lon"]) * self._east_m,
                float(node.attrib["lat"]) * _M_PER_DEG,
            )
            for node in root.iter("node")
        }
        self._nodes = {places[nd.attrib["ref"]]: nd.attrib["ref"] for nd in root.iter("nd")}
        self._lines = {
            way.get("id"): [places[nd.attrib["ref"]] for nd in way.iter("nd")]
            for way in root.iter("way")
        }
        self._new_ids = map(
            str, itertools.count(1 + max(int(item.attrib["id"].lstrip("-")) for item in root))
        )

    def lines(self, item: Element) -> list[_Line]:
        """The line of a way, or those of a relation's members."""
        ways = [member.get("ref") for member in item.iterfind("member[@type='way']")] or [
            item.get("id")
        ]
        return [self._lines[way] for way in ways if way in self._lines]

    def area(self, item: Element) -> BaseGeometry:
        """What a closed way or a multipolygon encloses."""
        return shapely.build_area(shapely.node(MultiLineString(self.lines(item))))

    def sort(self, item: Element, tags: dict[str, str]) -> None:
        """Find out what a way or a relation is."""
        house = tags.get("building", "no") not in _TAGS["open"] and not off_ground(tags)
        if house or not _TAGS["solid"].isdisjoint(tags.values()):
            self.solids.append(self.area(item))
        highway = tags.get("highway")
        if highway in self._streets or tags.get("railway") in _TAGS["rails"]:
            self.driven += self.lines(item)
        shared = highway == "cycleway" and tags.get("foot") == "designated"
        if shared or highway in self._streets | _TAGS["footways"]:
            for line in self.lines(item):
                networkx.add_path(self.ways, line)

    def add_way(self, line: Iterable[tuple[float, float]], key: str, value: str) -> None:
        """Add a way with one tag."""
        way = SubElement(self._root, "way", {"id": next(self._new_ids)})
        for place in line:
            if place not in self._nodes:
                self._nodes[place] = next(self._new_ids)
                east, north = str(place[0] / self._east_m), str(place[1] / _M_PER_DEG)
                SubElement(
                    self._root, "node", {"id": self._nodes[place], "lon": east, "lat": north}
                )
            SubElement(way, "nd", {"ref": self._nodes[place]})
        SubElement(way, "tag", {"k": key, "v": value})
