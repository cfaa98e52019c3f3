"""The walking network of a town: where a wheelchair fits, and the shortest ways inside an area."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

import networkx
import numpy as np
import shapely
from shapely import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.towns.ground.plane_geometry import (
    Patches,
    buffered,
    cross_z,
    length_of,
    polygons_of,
    valid,
)
from wcsim.towns.ground.surfaces import walkable_lanes
from wcsim.towns.sumo.net import Lane, LaneKind, Net
from wcsim.types import F64, SignalState, WalkEdge, WalkGraph, WayKind

_MAX_CORNERS = 160  # above this the area is thinned first: the search looks at all pairs
_SLACK_M = 1e-4
# The middle of the way is so far from a wall, from the edge of a kerb, and from terrain or road at
# the same height.
_SOLID_M = 0.45
KERB_M = 0.35
_SOFT_M = 0.10
_SEAM_M = 0.05  # pavements and crossings may be this far apart and still count as one
_SNAP_M = 1.5  # how far an end of a lane may move to stand where there is room
SHORTEST_M = 3.0  # of the part of a lane that is a way when the whole cannot be passed
_BESIDE_M = 1.25  # from the middle of a way of two directions to that of one of them, and a little
REACH_M = 1.5  # how far a way may leave the lane or walking area that it belongs to
_WAY_NAMES = {LaneKind.SIDEWALK: "sidewalk", LaneKind.SHARED: "shared", LaneKind.BIKE: "cycleway"}


def free_space(walkable: BaseGeometry, kerbs: BaseGeometry, solids: BaseGeometry) -> BaseGeometry:
    """Walkable ground without the strips along kerbs and walls, for the middle of a chair."""
    joined = buffered(walkable, _SEAM_M, join_style="mitre")
    space = buffered(joined, -_SEAM_M - _SOFT_M, join_style="mitre")
    for obstacle, gap_m in ((kerbs, KERB_M), (solids, _SOLID_M)):
        if not obstacle.is_empty:
            space = space.difference(buffered(obstacle, gap_m, quad_segs=2))
    areas = MultiPolygon(polygons_of(valid(space.simplify(0.02))))
    # On a grid of 1 cm the slack of later tests would vanish.
    return shapely.set_precision(areas, 0.0)


def build_walk_graph(
    net: Net,
    space: BaseGeometry,
    chair_ways: tuple[str, ...],
    phases: Iterable[SignalState] = (),
    barred: Sequence[F64] = (),
) -> WalkGraph:
    """The largest connected network of ways inside `space`; what is too narrow is left out.

    Args:
        net: The net, on its land.
        space: Where the middle of a wheelchair may be.
        chair_ways: What counts as a way.
        phases: Those of all the programs of its traffic lights.
        barred: Lines (n, 2) of ways on which walkers alone go; a lane is one of them where it lies
            on it for the most.
    """
    # 1. Add the lanes on which chairs may drive.
    builder = _Builder(space)
    strips = [shapely.LineString(line_m).buffer(_BESIDE_M) for line_m in barred]
    closed = Patches(shapely.union_all(strips))
    for lane in walkable_lanes(net, chair_ways):
        if _WAY_NAMES[lane.kind] not in chair_ways or lane.internal:
            continue
        if barred and lane.is_line:
            line = shapely.LineString(lane.points_m)
            if line.intersection(closed.near(line.bounds)).length > 0.5 * line.length:
                continue
        builder.add_lane(lane, WayKind.SIDEWALK)

    # 2. Add crossings, with their traffic light and the numbers of their signals.
    signals: dict[str, tuple[str, tuple[int, ...]]] = {}
    for edge_id, link in net.crossing_links():
        known = signals.get(edge_id, (link.tls_id, ()))[1]
        signals[edge_id] = (link.tls_id, tuple(sorted({*known, link.tls_link})))
    if "crossing" in chair_ways:
        for lane in net.lanes(LaneKind.CROSSING):
            builder.add_lane(lane, WayKind.CROSSING, signals.get(lane.edge_id, ("", ())))

    # 3. Link the lanes that meet in a walking area.
    ends = _ends_at_areas(net)
    for area in net.lanes(LaneKind.WALKINGAREA):
        builder.link(area, ends[area.edge_id])

    return _largest_part(builder.nodes, _with_dead_lights(builder.edges, phases))


def shortest_inside(area: BaseGeometry, start_m: F64, goal_m: F64) -> F64 | None:
    """Shortest polyline (K, 2) from start to goal inside `area`; None where its parts are apart."""
    # 1. Find the part that holds both. Often the straight line stays in it.
    both = shapely.points([start_m, goal_m])
    polygons = (part for part in shapely.get_parts(area) if part.geom_type == "Polygon")
    part = next((each for each in polygons if shapely.dwithin(each, both, _SLACK_M).all()), None)
    if part is None:
        return None
    roomy = part.buffer(_SLACK_M)
    shapely.prepare(roomy)
    if roomy.covers(shapely.LineString([start_m, goal_m])):
        return np.array([start_m, goal_m], np.float64)

    # 2. Search a graph of the corners that see each other: a shortest way bends at them alone.
    points = np.concatenate([[start_m, goal_m], _corners(part)])
    i, j = np.triu_indices(len(points), 1)
    lines = shapely.linestrings(np.stack([points[i], points[j]], axis=1))
    seen = shapely.covers(roomy, lines)
    length_m = shapely.length(lines)
    graph = networkx.Graph()
    graph.add_weighted_edges_from(
        zip(i[seen].tolist(), j[seen].tolist(), length_m[seen].tolist(), strict=True)
    )
    try:
        nodes = networkx.shortest_path(graph, 0, 1, weight="weight")
    except (networkx.NetworkXNoPath, networkx.NodeNotFound):
        return None
    way: F64 = points[nodes]
    return way


class _Builder:
    """Collects nodes and edges."""

    def __init__(self, space: BaseGeometry) -> None:
        self.nodes: list[F64] = []
        self.edges: list[WalkEdge] = []
        self._space = Patches(space)
        self._ends: dict[str, list[int]] = {}  # nodes by lane

    def add_lane(
        self, lane: Lane, kind: WayKind, signal: tuple[str, tuple[int, ...]] = ("", ())
    ) -> None:
        """Add the way along a lane, near its middle where there is room; its ends become nodes.

        A lane that cannot be passed has a way from either end, as far as one gets.
        """
        if not lane.is_line:
            return
        local = self._local(shapely.LineString(lane.points_m).buffer(lane.width_m / 2 + REACH_M))
        start_m, end_m = (_snapped(local, lane.points_m[k]) for k in (0, -1))
        nodes = self._ends.setdefault(lane.id, [])
        if start_m is not None and end_m is not None:
            # The lane itself where it lies in there, else the shortest way between its ends.
            way: F64 | None = np.concatenate([[start_m], lane.points_m[1:-1], [end_m]])
            if not shapely.covers(local.buffer(1e-4), shapely.LineString(way)):
                way = shortest_inside(local, start_m, end_m)
            if way is not None:
                both = (self._node(start_m), self._node(end_m))
                nodes += both
                self._add(lane.id, kind, both, way, lane.width_m, signal)
                return
        for end, points_m in ((start_m, lane.points_m), (end_m, lane.points_m[::-1])):
            if end is None:
                continue
            part = _first_part(local, np.concatenate([[end], points_m[1:]]))
            if part is not None:
                nodes.append(self._node(part[0]))
                both = (nodes[-1], self._node(part[-1]))
                self._add(lane.id, kind, both, part, lane.width_m, signal)

    def link(self, area: Lane, lane_ids: list[str]) -> None:
        """Ways through a walking area, from each lane that ends in it to each other."""
        outline = shapely.MultiPoint(area.points_m).convex_hull

        def away_m(node: int) -> float:
            return float(shapely.distance(outline, shapely.points(self.nodes[node])))

        ends = (self._ends.get(lane_id) for lane_id in lane_ids)
        nodes = [min(candidates, key=away_m) for candidates in ends if candidates]
        local = self._local(outline.buffer(REACH_M)) if len(nodes) > 1 else outline
        for i, a in enumerate(nodes):
            for b in nodes[i + 1 :]:
                way = shortest_inside(local, self.nodes[a], self.nodes[b]) if a != b else None
                if way is not None:
                    kind = WayKind.WALKINGAREA
                    self._add(area.edge_id, kind, (a, b), way, area.width_m, ("", ()))

    def _local(self, around: BaseGeometry) -> BaseGeometry:
        return self._space.near(around.bounds).intersection(around)

    def _node(self, p_m: F64) -> int:
        self.nodes.append(p_m)
        return len(self.nodes) - 1

    def _add(
        self,
        sumo_id: str,
        kind: WayKind,
        nodes: tuple[int, int],
        way: F64,
        width_m: float,
        signal: tuple[str, tuple[int, ...]],
    ) -> None:
        edge = WalkEdge(
            sumo_id=sumo_id,
            kind=kind,
            start=nodes[0],
            end=nodes[1],
            points_W_m=way,
            width_m=width_m,
            tls_id=signal[0],
            tls_links=signal[1],
        )
        self.edges.append(edge)


def _snapped(space: BaseGeometry, p_m: F64) -> F64 | None:
    """The nearest point of `space`, or None when that is far."""
    point = shapely.Point(p_m)
    if space.is_empty or not shapely.dwithin(space, point, _SNAP_M):
        return None
    nearest: F64 = shapely.get_coordinates(shapely.shortest_line(space, point))[0]
    return nearest


def _first_part(space: BaseGeometry, points_m: F64) -> F64 | None:
    """How far a polyline stays in `space` from its start on; None when that is hardly a way."""
    inside = shapely.LineString(points_m).intersection(space.buffer(1e-4))
    for part in shapely.get_parts(inside):
        if part.length > SHORTEST_M and shapely.dwithin(part, shapely.points(points_m[0]), 0.05):
            found: F64 = shapely.get_coordinates(part)
            return found if np.hypot(*(found[0] - points_m[0])) < 0.06 else found[::-1]
    return None


def _ends_at_areas(net: Net) -> dict[str, list[str]]:
    """Ids of the lanes that meet in each walking area."""
    areas = {lane.edge_id for lane in net.lanes(LaneKind.WALKINGAREA)}
    found: dict[str, dict[str, None]] = defaultdict(dict)
    for link in net.connections:
        if link.start in areas:
            found[link.start][f"{link.end}_{link.end_lane}"] = None
        if link.end in areas:
            found[link.end][f"{link.start}_{link.start_lane}"] = None
    return defaultdict(list, {area: list(lanes) for area, lanes in found.items()})


def _with_dead_lights(edges: list[WalkEdge], phases: Iterable[SignalState]) -> list[WalkEdge]:
    """The same edges, with crossings marked that no known phase frees."""
    programs: dict[str, list[SignalState]] = defaultdict(list)
    for phase in phases:
        programs[phase.tls_id].append(phase)
    marked: list[WalkEdge] = []
    for edge in edges:
        states = programs.get(edge.tls_id, []) if edge.tls_id else []
        dead = states and not any(state.frees(edge.tls_links) for state in states)
        marked.append(replace(edge, never_green=True) if dead else edge)
    return marked


def _largest_part(nodes: list[F64], edges: list[WalkEdge]) -> WalkGraph:
    """Only the connected part with the greatest length; its nodes are numbered anew."""
    graph = networkx.Graph((edge.start, edge.end) for edge in edges)
    part_of = {
        node: i for i, part in enumerate(networkx.connected_components(graph)) for node in part
    }
    total_m: dict[int, float] = defaultdict(float)
    for edge in edges:
        total_m[part_of[edge.start]] += length_of(edge.points_W_m)
    if not total_m:
        return WalkGraph(nodes_W_m=np.zeros((0, 2)), edges=())
    best = max(total_m, key=lambda part: (total_m[part], -part))
    edges = [edge for edge in edges if part_of[edge.start] == best]
    used = sorted({node for edge in edges for node in (edge.start, edge.end)})
    number = {node: i for i, node in enumerate(used)}
    return WalkGraph(
        nodes_W_m=np.array([nodes[node] for node in used]),
        edges=tuple(
            replace(edge, start=number[edge.start], end=number[edge.end]) for edge in edges
        ),
    )


def _corners(part: Polygon) -> F64:
    """Corners (n, 2) at which the free side turns away, for a shortest way can bend there."""
    for tolerance_m in (0.0, 0.02, 0.05, 0.1, 0.2):
        thinned = part.simplify(tolerance_m) if tolerance_m else part
        # The area lies on the left of its rings then.
        oriented = shapely.orient_polygons(thinned)
        inward: list[F64] = []
        for outline in (oriented.exterior, *oriented.interiors):
            ring = shapely.get_coordinates(outline)[:-1]
            before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
            inward.append(ring[cross_z(before, after) < 0.0])
        found = np.concatenate(inward)
        if len(found) <= _MAX_CORNERS:
            break
    return found[:_MAX_CORNERS]
