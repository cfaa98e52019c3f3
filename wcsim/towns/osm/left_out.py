"""What of a map's streets and ways on foot is not in the net that was made of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from wcsim.towns.osm.area import Box, is_within, size_m
from wcsim.towns.osm.clean import is_hidden, read_tags

LEAST_M = 50.0  # what is less is lost at the edges of any box
TOLD = 5  # names
TOLD_LOST = 10  # ways on foot
_STREETS = frozenset(
    (
        "motorway", "trunk", "primary", "secondary", "tertiary", "unclassified", "residential", "living_street",
        "motorway_link", "trunk_link", "primary_link", "secondary_link", "tertiary_link"
    )
)  # fmt: skip
_FOOTWAYS = frozenset(("footway", "pedestrian", "path", "steps"))
_CLOSED = ("no", "private")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapWay:
    """A street or a way on foot of a map."""

    id: str  # without a sign; of a relation with the word before it
    street: bool
    name: str
    inside_m: float  # how much of it lies in the box; of an area, its outline
    nodes: frozenset[str] = frozenset()
    leaves: bool = False  # the box
    why: str = ""  # it may be missing, by its tags


@dataclass(frozen=True, slots=True, kw_only=True)
class NetWays:
    """What became of the ways of a map, by their ids without a sign."""

    given: frozenset[str] = frozenset()  # to netconvert
    bridges: frozenset[str] = frozenset()  # over other streets, which were not given
    drawn: frozenset[str] = frozenset()  # in the net
    walked: frozenset[str] = frozenset()  # of these, those with lanes for walkers


@dataclass(frozen=True, slots=True, kw_only=True)
class _LostWay:
    """A way on foot that the net has not."""

    id: str
    name: str
    inside_m: float
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """What the map has inside the box, and how much of it the net has not."""

    streets_m: float = 0.0
    footways_m: float = 0.0
    streets_left_out_m: float = 0.0
    footways_left_out_m: float = 0.0
    names: tuple[str, ...] = ()  # of streets that are left out, longest first
    footways: tuple[_LostWay, ...] = ()  # all that are left out, longest first


def ways_inside(root: Element, box: Box) -> tuple[MapWay, ...]:
    """The streets of an extract at street level, and its ways on foot; `root` is as it was read."""
    places = {
        node.get("id", ""): (float(node.get("lon", "0")), float(node.get("lat", "0"))) for node in root.iterfind("node")
    }
    lines = {
        way.get("id", ""): [ref for node in way.iterfind("nd") if (ref := node.get("ref", "")) in places]
        for way in root.iterfind("way")
    }
    found = []
    for item in (*root.iterfind("way"), *root.iterfind("relation")):
        tags = read_tags(item)
        street = tags.get("highway") in _STREETS and not is_hidden(tags) and tags.get("area") != "yes"
        if not street and not _is_footway(tags):
            continue
        parts = [lines[item.get("id", "")]] if item.tag == "way" else _outline(item, lines)
        nodes = frozenset(itertools.chain(*parts))
        way = MapWay(
            id=f"{'relation ' * (item.tag == 'relation')}{item.get('id', '').lstrip('-')}",
            street=street,
            name=tags.get("name", ""),
            inside_m=sum(_inside_m([places[node] for node in part], box) for part in parts),
            nodes=nodes,
            leaves=any(not is_within(places[node], box) for node in nodes),
            why=_why_by_tags(tags),
        )
        found.append(way)
    return tuple(way for way in found if way.inside_m > 0.0)


def _is_footway(tags: dict[str, str]) -> bool:
    shared = tags.get("highway") == "cycleway" and tags.get("foot") in ("yes", "designated")
    return shared or (tags.get("highway") in _FOOTWAYS and tags.get("foot") != "no")


def _outline(relation: Element, lines: dict[str, list[str]]) -> list[list[str]]:
    outer = [
        m.get("ref", "") for m in relation.iterfind("member") if m.get("type") == "way" and m.get("role") != "inner"
    ]
    return [lines[ref] for ref in outer if ref in lines] if read_tags(relation).get("type") == "multipolygon" else []


def _why_by_tags(tags: dict[str, str]) -> str:
    if is_hidden(tags):
        return "a tunnel, indoors, or on another level"
    if tags["highway"] == "steps":
        return "steps"
    if tags.get("area") == "yes" or tags.get("type") == "multipolygon":
        return "an open area" if tags["highway"] == "pedestrian" else "an area"
    return "closed to the public" if tags.get("foot", tags.get("access")) in _CLOSED else ""


def count_inside(root: Element, box: Box, highway: str) -> int:
    """How many nodes with this value of `highway` the map has in the box; crossings without paint count too."""
    nodes = (node for node in root.iterfind("node") if read_tags(node).get("highway") == highway)
    return sum(is_within((float(node.get("lon", "0")), float(node.get("lat", "0"))), box) for node in nodes)


def find_left_out(ways: Collection[MapWay], made: NetWays) -> LeftOut:
    """What of `ways` is not in the net."""
    gone = [way for way in ways if way.id not in (made.drawn if way.street else made.walked)]
    by_name: dict[str, float] = {}
    for way in gone:
        if way.name and way.street:
            by_name[way.name] = by_name.get(way.name, 0.0) + way.inside_m
    rest = frozenset(itertools.chain.from_iterable(way.nodes for way in ways if way.id in made.drawn))
    lost = [
        _LostWay(id=way.id, name=way.name, inside_m=way.inside_m, why=_why(way, made, rest))
        for way in gone
        if not way.street
    ]
    return LeftOut(
        streets_m=sum(way.inside_m for way in ways if way.street),
        footways_m=sum(way.inside_m for way in ways if not way.street),
        streets_left_out_m=sum(way.inside_m for way in gone if way.street),
        footways_left_out_m=sum(way.inside_m for way in lost),
        names=tuple(sorted(by_name, key=lambda name: (-by_name[name], name))),
        footways=tuple(sorted(lost, key=lambda way: (-way.inside_m, way.id))),
    )


def _why(way: MapWay, made: NetWays, rest: frozenset[str]) -> str:
    """Why a way of the map cannot be walked in the net; `rest` are the nodes of all ways of the net."""
    if way.why or way.id in made.bridges:
        return way.why or "a bridge over another street"
    if way.id in made.drawn:
        return "closed to pedestrians in the net"
    if way.leaves:
        return "cut by the edge of the box"
    joined = way.id in made.given and way.nodes & rest
    return "part of a junction, or left out by netconvert" if joined else "not connected to the rest in the box"


def left_out_notes(found: LeftOut) -> tuple[str, ...]:
    """What is left out: streets where they are more than next to nothing, and each way on foot or the longest."""
    notes = []
    if found.streets_left_out_m >= LEAST_M:
        names = ", ".join(found.names[:TOLD]) + " and more" * (len(found.names) > TOLD)
        notes.append(
            f"left out: {_km(found.streets_left_out_m)} of {_km(found.streets_m)} of streets: bridges, and streets "
            f"connected to the rest only outside of the box{' (' + names + ')' if names else ''}; a larger --bbox or "
            "--keep-service may connect them"
        )
    if lost := found.footways:
        listed = ", ".join(
            f"{' '.join(filter(None, (w.id, w.name)))} ({w.inside_m:.0f} m, {w.why})" for w in lost[:TOLD_LOST]
        )
        more_m = sum(way.inside_m for way in lost[TOLD_LOST:])
        more = f", and {len(lost) - TOLD_LOST} more ({more_m:.0f} m)" if len(lost) > TOLD_LOST else ""
        notes.append(
            f"left out: {found.footways_left_out_m:.0f} of {found.footways_m:.0f} m of footways in the box, by map id: "
            f"{listed}{more}"
        )
    return tuple(notes)


def _inside_m(points: list[tuple[float, float]], box: Box) -> float:
    """Length in m of the parts between points (longitude, latitude) that have their middles in the box."""
    total_m = 0.0
    for (x1, y1), (x2, y2) in itertools.pairwise(points):
        if is_within(((x1 + x2) / 2, (y1 + y2) / 2), box):
            total_m += math.hypot(*size_m((x1, y1, x2, y2)))
    return total_m


def _km(length_m: float) -> str:
    return f"{length_m / 1e3:.2f} km"
