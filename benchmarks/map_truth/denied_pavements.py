"""Pavements of a net that the map does not know or denies, and the ways on foot that lead over them.

The side of a street on which a lane lies is seen from where it lies, left or right of the way as it was drawn. So
neither the direction of its edge nor the side on which traffic keeps matters.
"""

import math
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import networkx as nx
import numpy as np
import shapely

from benchmarks.map_truth.raw_map import MapWay, RawMap, Tags, below_ground
from wcsim.types import F64, WalkGraph

RAILS: Final = "along rails alone"
NO_FOOT: Final = "where foot=no"
NO_SIDEWALK: Final = "where sidewalk=no"
SEPARATE: Final = "where sidewalk=separate"
WRONG: Final = (RAILS, NO_FOOT, NO_SIDEWALK, SEPARATE)
"""Why a lane for people should not be there."""
ALLOWED: Final = "allowed"
OWN_WAY: Final = "a way of its own"
UNKNOWN: Final = "of no way in the map"

_WALKERS: Final = frozenset({"pedestrian", "wheelchair", "bicycle", "scooter"})
_TRAINS: Final = frozenset({"rail", "tram", "rail_urban", "rail_electric", "rail_fast", "subway", "cable_car"})
_RAILWAYS: Final = frozenset({"rail", "tram", "light_rail", "subway", "narrow_gauge", "funicular", "monorail"})
_PIECE_M: Final = 2.0
_AMID_M: Final = 0.3  # of a way's line: neither left nor right of it
_MAPPED_M: Final = 2.5
_TOUCHES_M: Final = 1.0  # of a route: less is the corner of a junction


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A part of a lane for people, and what the map says of it: one of the verdicts above."""

    lane: str
    verdict: str
    lines: shapely.MultiLineString


def judge_lanes(net: Any, raw: RawMap) -> list[Stretch]:
    """Each lane of a net of sumolib that is for people, or for people and riders, cut where the verdict changes."""
    stretches: list[Stretch] = []
    for edge in net.getEdges(withInternal=False):
        for lane in edge.getLanes():
            classes = set(lane.getPermissions())
            if "pedestrian" not in classes or classes - _WALKERS or len(lane.getShape()) < 2:
                continue
            beside = set[str]().union(*(other.getPermissions() for other in edge.getLanes() if other is not lane))
            by_rails = bool(beside) and beside <= _TRAINS

            # An edge may be made of several ways: each piece of the lane belongs to the nearest.
            ways = [raw.ways[id] for id in (lane.getParam("origId") or "").split() if id in raw.ways]
            line = shapely.segmentize(shapely.LineString(lane.getShape()), _PIECE_M)
            pieces = defaultdict(list)
            for ends in pairwise(line.coords):
                middle = shapely.Point(np.mean(ends, axis=0))
                verdict = RAILS if by_rails else _verdict(ways, middle)
                pieces[verdict].append(ends)
            stretches += [
                Stretch(lane=lane.getID(), verdict=verdict, lines=shapely.MultiLineString(found))
                for verdict, found in pieces.items()
            ]
    return stretches


def _verdict(ways: list[MapWay], place: shapely.Point) -> str:
    """What the nearest of some ways says of people who walk at a place beside it, or on it."""
    if not ways:
        return UNKNOWN
    way = min(ways, key=lambda each: each.line.distance(place))
    if not way.street:
        if "highway" not in way.tags and way.tags.get("railway") in _RAILWAYS:
            return RAILS
        return NO_FOOT if way.tags.get("foot") == "no" else OWN_WAY
    side = side_of(way.line, place)
    denials = [denial(way.tags, each) for each in ([side] if side else ["left", "right"])]
    return denials[0] if all(denials) else ALLOWED


def side_of(line: shapely.LineString, place: shapely.Point) -> str:
    """On which side of a line a place lies, seen along the line; "" for upon it."""
    at_m = line.project(place)
    start = line.interpolate(max(at_m - 0.5, 0.0))
    end = line.interpolate(min(at_m + 0.5, line.length))
    along_x_m, along_y_m = end.x - start.x, end.y - start.y
    area_m2 = along_x_m * (place.y - start.y) - along_y_m * (place.x - start.x)
    left_m = area_m2 / max(math.hypot(along_x_m, along_y_m), 1e-9)
    if abs(left_m) < _AMID_M:
        return ""
    return "left" if left_m > 0.0 else "right"


def denial(tags: Tags, side: str) -> str:
    """Why a street has no pavement on a side, "" where it may have one.

    A tag of the side alone is stronger than one of both sides, and what is said of pavements than foot=no.
    """
    whole = tags.get("sidewalk")
    if whole in ("left", "right"):
        whole = "yes" if whole == side else "no"
    value = tags.get(f"sidewalk:{side}", tags.get("sidewalk:both", whole))
    if value in ("no", "none"):
        return NO_SIDEWALK
    if value == "separate":
        return SEPARATE
    return NO_FOOT if value is None and tags.get("foot") == "no" else ""


def count_lanes(stretches: list[Stretch], raw: RawMap) -> dict[str, float]:
    """Metres of pavement by what the map says of it, and how many of those lie on a mapped one."""
    mapped = mapped_pavements(raw)
    counts = {"pavement, m": sum(each.lines.length for each in stretches if each.verdict != OWN_WAY)}
    for verdict in (UNKNOWN, *WRONG):
        lines = [each.lines for each in stretches if each.verdict == verdict]
        counts[f"pavement {verdict}, m"] = sum(each.length for each in lines)
        if verdict != UNKNOWN:
            on_mapped_m = sum(each.intersection(mapped).length for each in lines)
            counts[f"pavement {verdict}, on a mapped one, m"] = on_mapped_m
    return counts


def mapped_pavements(raw: RawMap) -> shapely.Geometry:
    """All ground within 2.5 m of a way on foot that the map has by itself; steps and crossings are none."""
    found: list[shapely.Geometry] = [each.line for each in raw.ways.values() if _is_mapped(each.tags)]
    found += [each.shape for each in raw.areas if _is_mapped(each.tags)]
    return shapely.unary_union(shapely.buffer(found, _MAPPED_M))


def _is_mapped(tags: Tags) -> bool:
    on_foot = tags.get("highway") in ("footway", "path", "pedestrian") and tags.get("footway") != "crossing"
    return on_foot and not below_ground(tags)


def count_routes(
    walk: WalkGraph, origin_net_m: F64, stretches: list[Stretch], raw: RawMap, routes: int, seed: int
) -> dict[str, float]:
    """Shortest ways between random nodes of the greatest connected part: how much of them the map denies.

    Args:
        walk: The product's own graph: what its users drive on.
        origin_net_m: (2,) origin of its coordinates, in those of the net.
        stretches: The lanes, judged.
        raw: The map.
        routes: How many ways.
        seed: Of the choice of nodes.
    """
    # Of each edge the metres that are denied, and of those the metres that lie on no mapped pavement.
    wrong = defaultdict(list)
    for each in stretches:
        if each.verdict in WRONG:
            wrong[each.lane].append(each.lines)
    mapped = mapped_pavements(raw)
    graph = nx.Graph()
    for edge in walk.edges:
        line = shapely.LineString(edge.points_W_m + origin_net_m)
        denied = line.intersection(shapely.unary_union(wrong[edge.sumo_id]).buffer(0.2))
        known_m = graph.get_edge_data(edge.start, edge.end, {"length_m": math.inf})["length_m"]
        if line.length < known_m:
            unmapped_m = denied.difference(mapped).length
            graph.add_edge(edge.start, edge.end, length_m=line.length, denied_m=denied.length, unmapped_m=unmapped_m)

    greatest: set[int] = max(nx.connected_components(graph), key=len)
    nodes = sorted(greatest)
    generator = np.random.default_rng(seed)
    rows = []
    for start, end in (generator.choice(nodes, 2, replace=False).tolist() for _ in range(routes)):
        path = nx.shortest_path(graph, start, end, weight="length_m")
        edges = [graph.edges[pair] for pair in pairwise(path)]
        rows.append([sum(edge[key] for edge in edges) for key in ("length_m", "denied_m", "unmapped_m")])
    table = np.array(rows)
    counts = {"routes, km": table[:, 0].sum() / 1000.0}
    for column, what in ((1, "denied"), (2, "denied and unmapped")):
        counts[f"routes on {what} pavement, % of metres"] = 100.0 * table[:, column].sum() / table[:, 0].sum()
        counts[f"routes that touch {what} pavement, %"] = 100.0 * (table[:, column] > _TOUCHES_M).mean()
    return counts
