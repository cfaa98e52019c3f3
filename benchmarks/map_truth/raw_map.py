"""An OpenStreetMap extract as it lies in a town's folder, in the coordinates of the town's net."""

import gzip
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
    projected = transform("EPSG:4326", net._location["projParameter"], *degrees.T.tolist())
    places = np.stack(projected, axis=-1) + net.getLocationOffset()
    place_of = dict(zip((node.attrib["id"] for node in nodes), places, strict=True))

    # An extract is cut: of some ways not every node is there.
    refs = {
        way.attrib["id"]: [nd.attrib["ref"] for nd in way.iterfind("nd") if nd.attrib["ref"] in place_of]
        for way in root.iterfind("way")
    }
    tags = {way.attrib["id"]: _tags(way) for way in root.iterfind("way")}
    ways = {
        id: MapWay(tags=tags[id], line=shapely.LineString([place_of[ref] for ref in here]))
        for id, here in refs.items()
        if len(here) > 1
    }
    on_streets = {ref for id, way in ways.items() if way.street for ref in refs[id]}

    # A closed way is an area where it says so, or where its kind has no other meaning.
    areas = [
        MapArea(tags=way.tags, shape=shapely.make_valid(shapely.Polygon(way.line)))
        for id, way in ways.items()
        if way.line.is_closed
        and len(refs[id]) > 3
        and (way.tags.get("area") == "yes" or way.tags.get("place") == "square")
    ]
    for relation in root.iterfind("relation"):
        members = [member.attrib["ref"] for member in relation.iterfind("member[@type='way']")]
        lines = [ways[id].line for id in members if id in ways]
        if _tags(relation).get("type") == "multipolygon" and lines:
            shape = shapely.build_area(shapely.unary_union(lines))  # rings within rings are holes
            areas.append(MapArea(tags=_tags(relation), shape=shape))

    west_m, south_m, east_m, north_m = net.getBoundary()
    inside = shapely.contains_xy(shapely.box(west_m, south_m, east_m, north_m), places)
    found = [
        MapNode(tags=_tags(node), p_net_m=place, on_street=node.attrib["id"] in on_streets)
        for node, place, here in zip(nodes, places, inside, strict=True)
        if here and len(node)
    ]
    return RawMap(nodes=tuple(found), ways=ways, areas=tuple(areas))


def below_ground(tags: Tags) -> bool:
    """Whether something lies in a tunnel, in a building, or under the street."""
    deep = any(tags.get(key, "").startswith("-") for key in ("layer", "level"))
    return deep or tags.get("tunnel", "no") != "no" or tags.get("indoor", "no") != "no"


def _tags(element: ElementTree.Element) -> Tags:
    return {tag.attrib["k"]: tag.attrib["v"] for tag in element.iterfind("tag")}
