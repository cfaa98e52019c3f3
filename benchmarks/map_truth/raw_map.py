"""An OpenStreetMap extract as it lies in a town's folder, in the coordinates of the town's net."""

import gzip
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np
import shapely
from rasterio.warp import transform

from wcsim.errors import TownError
from wcsim.types import F64

WALKERS_WAYS: Final = frozenset(
    {"footway", "path", "pedestrian", "steps", "cycleway", "bridleway", "track", "corridor", "platform"}
)
"""Values of `highway` that are no streets: a lane for people there is the way itself, no pavement beside one."""

_DEGREES: Final = "+proj=longlat +datum=WGS84"
Tags = dict[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapNode:
    """A node with tags."""

    tags: Tags
    p_net_m: F64  # (2,)
    on_street: bool  # a street leads over it


@dataclass(frozen=True, slots=True, kw_only=True)
class MapWay:
    """A way, in the direction in which it was drawn."""

    tags: Tags
    line: shapely.LineString

    @property
    def street(self) -> bool:
        """Whether it is a street."""
        return "highway" in self.tags and self.tags["highway"] not in WALKERS_WAYS


@dataclass(frozen=True, slots=True, kw_only=True)
class MapArea:
    """A closed way or a multipolygon."""

    tags: Tags
    shape: shapely.Geometry


@dataclass(frozen=True, slots=True, kw_only=True)
class RawMap:
    """What the extract holds where the net is; areas may reach beyond."""

    nodes: tuple[MapNode, ...]
    ways: dict[str, MapWay]
    areas: tuple[MapArea, ...]


def read_raw_map(path: Path, net: Any) -> RawMap:
    """The extract of a net of sumolib.

    Raises:
        TownError: The file is no extract, or the net does not say how it was projected.
    """
    try:
        with gzip.open(path) as file:
            root = ElementTree.parse(file).getroot()  # noqa: S314 - the user's own map, for a measurement
    except (OSError, EOFError, ElementTree.ParseError) as error:
        raise TownError(f"{path}: cannot be read ({error}); expected the .osm.xml.gz of an import") from None
    if not net.hasGeoProj():
        raise TownError(f"{path}: its net has no projection, got {net._location}; import the town again")

    nodes = root.findall("node")
    degrees = np.array([(node.attrib["lon"], node.attrib["lat"]) for node in nodes], np.float64).reshape(-1, 2)
    # A string, not a number of the EPSG: PROJ may be without its data, as libsumo points a process to its own.
    projected = transform(_DEGREES, net._location["projParameter"], *degrees.T.tolist())
    places = np.stack(projected, axis=-1) + net.getLocationOffset()
    place_of = dict(zip((node.attrib["id"] for node in nodes), places, strict=True))

    ways, on_streets = dict[str, MapWay](), set[str]()
    for element in root.iterfind("way"):
        # An extract is cut: of some ways not every node is there.
        refs = [nd.attrib["ref"] for nd in element.iterfind("nd") if nd.attrib["ref"] in place_of]
        if len(refs) > 1:
            way = MapWay(tags=_tags(element), line=shapely.LineString([place_of[ref] for ref in refs]))
            ways[element.attrib["id"]] = way
            on_streets.update(refs if way.street else [])

    west_m, south_m, east_m, north_m = net.getBoundary()
    inside = shapely.contains_xy(shapely.box(west_m, south_m, east_m, north_m), places)
    found = [
        MapNode(tags=_tags(node), p_net_m=place, on_street=node.attrib["id"] in on_streets)
        for node, place, here in zip(nodes, places, inside, strict=True)
        if here and len(node)
    ]
    return RawMap(nodes=tuple(found), ways=ways, areas=tuple(_areas(root, ways)))


def _areas(root: ElementTree.Element, ways: dict[str, MapWay]) -> Iterator[MapArea]:
    # A closed way is an area where it says so, or where its kind has no other meaning.
    for way in ways.values():
        called = way.tags.get("area") == "yes" or way.tags.get("place") == "square"
        if called and way.line.is_closed and len(way.line.coords) > 3:
            yield MapArea(tags=way.tags, shape=shapely.make_valid(shapely.Polygon(way.line)))
    for relation in root.iterfind("relation"):
        members = relation.iterfind("member[@type='way']")
        lines = [ways[each.attrib["ref"]].line for each in members if each.attrib["ref"] in ways]
        tags = _tags(relation)
        if tags.get("type") == "multipolygon":
            # Rings within rings are holes.
            yield MapArea(tags=tags, shape=shapely.build_area(shapely.unary_union(lines)))


def below_ground(tags: Tags) -> bool:
    """Whether something lies in a tunnel, in a building, or under the street."""
    deep = any(tags.get(key, "").startswith("-") for key in ("layer", "level"))
    return deep or tags.get("tunnel", "no") != "no" or tags.get("indoor", "no") != "no"


def _tags(element: ElementTree.Element) -> Tags:
    return {tag.attrib["k"]: tag.attrib["v"] for tag in element.iterfind("tag")}
