"""Take bridges over other streets out of an extract: a town has one level, on which they would be level crossings.

The lower way stays, whatever it is, except a railway under a street: no trains run in imported towns. Bridges over
water, or over nothing, stay as well.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from wcsim.core.frames import rad
from wcsim.types import F64

ALONG_M = 15.0  # a bridge that runs over another way for longer than this lies on top of it
BESIDE_M = 2.5  # and as near to its line
_M_PER_DEG = 111_320.0
_RAILS = {"rail", "narrow_gauge", "light_rail", "preserved", "tram"}
_TRAINS = _RAILS - {"tram"}
_NO_WAY = {"steps", "track", "proposed", "platform", "bus_stop", "raceway", "rest_area", "services", "razed"}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Way:
    """A street or railway of the extract."""

    element: Element
    nodes: tuple[str, ...]
    points_m: F64  # (n, 2)
    level: float
    train: bool

    def piece(self, first: int, last: int) -> shapely.LineString:
        """The line from one node to another."""
        return shapely.LineString(self.points_m[first : last + 1])


def cut_bridges(root: Element, keep_service: bool = False) -> tuple[str, ...]:
    """Leave out the parts of bridges that pass over other streets, and say what they are called; changes `root`.

    A part reaches from one junction to the next. Names are sorted, each once; what has none goes by its kind.
    """
    ways = _ways(root, keep_service)
    if not ways:
        return ()
    uses: dict[str, int] = {}
    for way in ways:
        for node in set(way.nodes):
            uses[node] = uses.get(node, 0) + 1
    cut: dict[int, set[int]] = {}  # number of a way: its segments that go
    lines = [way.piece(0, len(way.nodes) - 1) for way in ways]
    pairs = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=BESIDE_M).T.tolist()
    for high, low in sorted(pairs, key=lambda pair: (ways[pair[0]].level, pair)):
        if ways[high].level <= ways[low].level:
            continue
        upper, lower = (low, high) if ways[low].train and not ways[high].train else (high, low)
        kept = _kept(ways[lower], cut.get(lower, set()))
        for segment in _over(ways[upper], kept, set(ways[lower].nodes)):
            cut.setdefault(upper, set()).update(_between_junctions(ways[upper], segment, uses))
    _remove(root, [(ways[number], gone) for number, gone in sorted(cut.items())])
    return tuple(sorted({_called(ways[number].element) for number in cut if not ways[number].train}))


def _ways(root: Element, keep_service: bool) -> list[_Way]:
    places = {
        node.get("id", ""): (float(node.get("lon", "0")), float(node.get("lat", "0"))) for node in root.iterfind("node")
    }
    middle = np.mean(list(places.values()) or [(0.0, 0.0)], axis=0)
    scale_m = _M_PER_DEG * np.array([np.cos(rad(float(middle[1]))), 1.0])
    found: list[_Way] = []
    for element in root.iterfind("way"):
        tag = _tags(element)
        nodes = tuple(ref for nd in element.iterfind("nd") if (ref := nd.get("ref", "")) in places)
        if len(nodes) < 2 or len(nodes) != len(element.findall("nd")) or not _is_built(tag, keep_service):
            continue
        points_m = (np.array([places[node] for node in nodes]) - middle) * scale_m
        train = "highway" not in tag and tag.get("railway") in _TRAINS
        found.append(_Way(element=element, nodes=nodes, points_m=points_m, level=_level(tag), train=train))
    return found


def _is_built(tag: dict[str, str], keep_service: bool) -> bool:
    """True for what becomes part of the net."""
    if tag.get("area") == "yes":
        return False
    if "highway" in tag:
        return tag["highway"] not in _NO_WAY and (keep_service or tag["highway"] != "service")
    return tag.get("railway") in _RAILS


def _level(tag: dict[str, str]) -> float:
    try:
        layer = float(tag["layer"])
    except (KeyError, ValueError):
        layer = 0.0
    return layer or (1.0 if tag.get("bridge", "no") != "no" else 0.0)


def _kept(way: _Way, gone: set[int]) -> shapely.MultiLineString:
    segments = [way.piece(k, k + 1) for k in range(len(way.nodes) - 1) if k not in gone]
    return shapely.MultiLineString(segments)


def _over(way: _Way, other: shapely.MultiLineString, joined: set[str]) -> list[int]:
    """Segments of a way that cross another one, or lie along it, without a common node there."""
    near = shapely.union_all([shapely.Point(way.points_m[k]) for k, node in enumerate(way.nodes) if node in joined])
    found: list[int] = []
    beside = other.buffer(BESIDE_M) if near.is_empty else shapely.Polygon()
    for k in range(len(way.nodes) - 1):
        meets = way.piece(k, k + 1).intersection(other)
        crosses = not meets.is_empty and (near.is_empty or not meets.within(near.buffer(0.05)))
        if crosses or way.piece(k, k + 1).intersection(beside).length > ALONG_M:
            found.append(k)
    return found


def _between_junctions(way: _Way, segment: int, uses: dict[str, int]) -> range:
    """Segments of a way from the junction before one of them to the junction after it."""
    first, last = segment, segment + 1
    while first > 0 and uses[way.nodes[first]] < 2:
        first -= 1
    while last < len(way.nodes) - 1 and uses[way.nodes[last]] < 2:
        last += 1
    return range(first, last)


def _remove(root: Element, cuts: list[tuple[_Way, set[int]]]) -> None:
    """Take segments out of ways; what is left of one beyond the first piece becomes a way of its own."""
    ids = [int(way.get("id", "0")) for way in root.iterfind("way")]
    sign, free = (1 if max(ids, default=1) > 0 else -1), max(map(abs, ids), default=0) + 1
    for way, gone in cuts:
        runs: list[list[str]] = [[]]
        for k, node in enumerate(way.nodes):
            runs[-1].append(node)
            if k in gone:
                runs.append([])
        place, tags = list(root).index(way.element), [deepcopy(tag) for tag in way.element.iterfind("tag")]
        root.remove(way.element)
        for number, nodes in enumerate(run for run in runs if len(run) > 1):
            piece = Element("way", way.element.attrib if number == 0 else {"id": str(sign * free)})
            free += number > 0
            piece.extend([Element("nd", {"ref": node}) for node in nodes] + deepcopy(tags))
            root.insert(place + number, piece)


def _called(way: Element) -> str:
    tag = _tags(way)
    return tag.get("name") or tag.get("ref") or f"a {tag.get('highway') or tag.get('railway')} without a name"


def _tags(way: Element) -> dict[str, str]:
    return {item.get("k", ""): item.get("v", "") for item in way.iterfind("tag")}
