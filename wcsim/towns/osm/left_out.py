"""What of a map's streets and ways on foot is not in the net that was made of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from wcsim.towns.osm.area import Box, size_m
from wcsim.towns.osm.clean import is_hidden, tags_of

LEAST_M = 50.0  # what is less is lost at the edges of any box
TOLD = 5  # names
_STREETS = frozenset(
    (
        "motorway", "trunk", "primary", "secondary", "tertiary", "unclassified", "residential", "living_street",
        "motorway_link", "trunk_link", "primary_link", "secondary_link", "tertiary_link"
    )
)  # fmt: skip
_FOOTWAYS = frozenset(("footway", "pedestrian", "path"))


@dataclass(frozen=True, slots=True, kw_only=True)
class MapWay:
    """A street or a way on foot of a map."""

    id: str
    street: bool
    name: str
    inside_m: float  # how much of it lies in the box


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """What the map has inside the box, and how much of it the net has not."""

    streets_m: float = 0.0
    footways_m: float = 0.0
    streets_left_out_m: float = 0.0
    footways_left_out_m: float = 0.0
    names: tuple[str, ...] = ()  # of what is left out, longest first


def ways_inside(root: Element, box: Box) -> tuple[MapWay, ...]:
    """The streets and the ways on foot of an extract at street level; `root` is as it was read."""
    places = {
        node.get("id", ""): (float(node.get("lon", "0")), float(node.get("lat", "0"))) for node in root.iterfind("node")
    }
    found = []
    for way in root.iterfind("way"):
        tags = tags_of(way)
        kind = tags.get("highway", "")
        if kind in _STREETS | _FOOTWAYS and not is_hidden(tags) and tags.get("area") != "yes":
            points = [places[ref] for node in way.iterfind("nd") if (ref := node.get("ref", "")) in places]
            inside_m = _inside_m(points, box)
            name = tags.get("name", "")
            found.append(MapWay(id=way.get("id", ""), street=kind in _STREETS, name=name, inside_m=inside_m))
    return tuple(way for way in found if way.inside_m > 0.0)


def crossings_inside(root: Element, box: Box) -> int:
    """How many crossings of streets the map itself has in the box, those that it calls unmarked too."""
    return sum(tags_of(node).get("highway") == "crossing" and _is_inside(node, box) for node in root.iterfind("node"))


def _is_inside(node: Element, box: Box) -> bool:
    west, south, east, north = box
    return west <= float(node.get("lon", "0")) <= east and south <= float(node.get("lat", "0")) <= north


def stops_inside(root: Element, box: Box) -> int:
    """How many bus stops the map has in the box."""
    return sum(tags_of(node).get("highway") == "bus_stop" and _is_inside(node, box) for node in root.iterfind("node"))


def left_out_of(ways: Collection[MapWay], kept: Collection[str]) -> LeftOut:
    """What is left out of `ways` when the net was made of the ways `kept`, by id."""
    gone = [way for way in ways if way.id not in kept]
    by_name: dict[str, float] = {}
    for way in gone:
        if way.name:
            by_name[way.name] = by_name.get(way.name, 0.0) + way.inside_m
    return LeftOut(
        streets_m=sum(way.inside_m for way in ways if way.street),
        footways_m=sum(way.inside_m for way in ways if not way.street),
        streets_left_out_m=sum(way.inside_m for way in gone if way.street),
        footways_left_out_m=sum(way.inside_m for way in gone if not way.street),
        names=tuple(sorted(by_name, key=lambda name: (-by_name[name], name))),
    )


def left_out_note(found: LeftOut) -> str:
    """One line that says what is left out, "" where that is next to nothing."""
    if found.streets_left_out_m + found.footways_left_out_m < LEAST_M:
        return ""
    names = ", ".join(found.names[:TOLD]) + " and more" * (len(found.names) > TOLD)
    return (
        f"left out are {_km(found.streets_left_out_m)} of {_km(found.streets_m)} of streets and "
        f"{_km(found.footways_left_out_m)} of {_km(found.footways_m)} of ways on foot: bridges, and what hangs "
        f"together with the rest only outside of the box{' (' + names + ')' if names else ''}; a larger --bbox, or "
        "--keep-service, may join them"
    )


def _inside_m(points: list[tuple[float, float]], box: Box) -> float:
    """Length in m of the parts between points (longitude, latitude) that have their middles in the box."""
    west, south, east, north = box
    total_m = 0.0
    for (x1, y1), (x2, y2) in itertools.pairwise(points):
        if west <= (x1 + x2) / 2 <= east and south <= (y1 + y2) / 2 <= north:
            total_m += math.hypot(*size_m((x1, y1, x2, y2)))
    return total_m


def _km(length_m: float) -> str:
    return f"{length_m / 1e3:.2f} km"
