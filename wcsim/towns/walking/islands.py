"""Walkable islands: pieces of pavement without a way on foot to the rest of the town."""

import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import networkx
import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from wcsim.towns.ground.plane_geometry import buffered, polygons_of
from wcsim.towns.ground.relief import fit_relief, on_land
from wcsim.towns.ground.surfaces import ground_of, make_surfaces
from wcsim.towns.sumo.net import WALK_KINDS, Lane, LaneKind, Net
from wcsim.towns.sumo.xml_io import read_root

_WALKABLE = WALK_KINDS | {LaneKind.CROSSING, LaneKind.WALKINGAREA}
_WAY = re.compile(r"^-*(\d+)(?:#.*)?$")


def stray_footways(net: Net, net_path: Path) -> frozenset[str]:
    """The OpenStreetMap ways of walkers and riders alone that lie on islands only.

    Ids have no sign. Islands are those of the connections that SUMO's walkers use.
    """
    return frozenset(way for way, quiet in _stray(net, net_path, *_linked(net)).items() if quiet)


def stray_ways(net: Net, net_path: Path, parts: list[BaseGeometry]) -> frozenset[str]:
    """The OpenStreetMap ways that lie on islands only, those with vehicles on them too.

    Ids have no sign. Islands are the `walkable_parts` of the net but the largest: a link that a
    carriageway covers is none for a chair.
    """
    sizes_m2 = {number: part.area for number, part in enumerate(parts)}
    return frozenset(_stray(net, net_path, _touching(net, parts), sizes_m2))


def _stray(
    net: Net, net_path: Path, part_of: dict[str, int], sizes_m2: dict[int, float]
) -> dict[str, bool]:
    """The ways without an edge in the largest part, and whether they have no vehicles."""
    main = max(sorted(sizes_m2), key=lambda part: sizes_m2[part], default=0)
    made_of = osm_ways_by_edge(net_path)
    quiet_kinds = WALK_KINDS | {LaneKind.BIKE, LaneKind.CLOSED}
    linked: set[str] = set()
    stray: dict[str, bool] = {}
    for edge in net.streets:
        for way in made_of.get(edge.id, ()):
            if part_of.get(edge.id, main) == main:
                linked.add(way)
            else:
                quiet = all(lane.kind in quiet_kinds for lane in edge.lanes)
                stray[way] = stray.get(way, True) and quiet
    return {way: quiet for way, quiet in stray.items() if way not in linked}


def walkable_parts(net: Net, chair_ways: tuple[str, ...]) -> list[BaseGeometry]:
    """The connected parts of all pavements and crossings together."""
    surfaces = make_surfaces(on_land(net, fit_relief(net)), chair_ways)
    walkable = shapely.union_all([surfaces.pavement, surfaces.crossing])
    return polygons_of(buffered(buffered(walkable, 0.05), -0.05))


@dataclass(frozen=True, slots=True, kw_only=True)
class CutOff:
    """A part of the walkable ground without a way on foot to the largest one."""

    edge: str  # one that lies on it
    area_m2: float


def cut_off(net: Net, parts: list[BaseGeometry]) -> tuple[CutOff, ...]:
    """The `walkable_parts` but the largest, in order of size, that hold an edge of a street."""
    if len(parts) < 2:
        return ()
    order = sorted(range(len(parts)), key=lambda part: -parts[part].area)
    edges: dict[int, str] = {}
    for edge, part in sorted(_touching(net, parts).items()):
        if not edge.startswith(":"):
            edges.setdefault(part, edge)
    return tuple(
        CutOff(edge=edges[part], area_m2=parts[part].area) for part in order[1:] if part in edges
    )


def largest_share(parts: list[BaseGeometry]) -> float:
    """Share of the walkable ground that its largest part holds, 0 to 1."""
    areas_m2 = [part.area for part in parts]
    return max(areas_m2) / sum(areas_m2) if areas_m2 else 0.0


def _touching(net: Net, parts: list[BaseGeometry]) -> dict[str, int]:
    """The part of the walkable ground on which most of each edge lies."""
    edges = [
        (edge.id, ground_of(lane for lane in edge.lanes if lane.kind in _WALKABLE))
        for edge in net.edges
        if edge.has(*_WALKABLE)
    ]
    part_of: dict[str, int] = {}
    best_m2: dict[str, float] = {}
    areas = np.array([area for _, area in edges], object)  # a net without pavements has none
    for number, part in shapely.STRtree(parts).query(areas, predicate="intersects").T:
        edge_id, area = edges[number]
        shared_m2 = area.intersection(parts[part]).area
        if shared_m2 > best_m2.get(edge_id, 0.0):
            best_m2[edge_id], part_of[edge_id] = shared_m2, int(part)
    return part_of


def _linked(net: Net) -> tuple[dict[str, int], dict[int, float]]:
    """The part to which each walkable edge belongs, and the size of the parts."""
    walkable: dict[tuple[str, int], float] = {}
    for edge in net.edges:
        walkable |= {
            (edge.id, lane.index): _area_m2(lane) for lane in edge.lanes if lane.kind in _WALKABLE
        }
    graph = networkx.Graph()
    graph.add_nodes_from(edge_id for edge_id, _ in walkable)
    for link in net.connections:
        if (link.start, link.start_lane) in walkable and (link.end, link.end_lane) in walkable:
            graph.add_edge(link.start, link.end)
    part_of = {
        edge_id: part
        for part, edges in enumerate(networkx.connected_components(graph))
        for edge_id in edges
    }
    sizes_m2: dict[int, float] = defaultdict(float)
    for (edge_id, _), area_m2 in walkable.items():
        sizes_m2[part_of[edge_id]] += area_m2
    return part_of, dict(sizes_m2)


def _area_m2(lane: Lane) -> float:
    if lane.kind is not LaneKind.WALKINGAREA:
        return lane.length_m * lane.width_m
    x_m, y_m = lane.points_m.T
    return 0.5 * abs(float(np.dot(x_m, np.roll(y_m, 1)) - np.dot(y_m, np.roll(x_m, 1))))


def osm_ways_by_edge(net_path: Path) -> dict[str, tuple[str, ...]]:
    """The OpenStreetMap ways of each edge: netconvert notes them, unless its name is one."""
    found: dict[str, tuple[str, ...]] = {}
    for edge in read_root(net_path).iterfind("edge"):
        noted = {
            way
            for param in edge.iter("param")
            if param.get("key") == "origId"
            for way in param.get("value", "").replace("-", "").split()
        }
        if match := _WAY.match(edge.get("id", "")):
            noted.add(match[1])
        found[edge.get("id", "")] = tuple(sorted(noted))
    return found
