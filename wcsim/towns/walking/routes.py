"""Ways for a wheelchair through a town, from its place to its destination."""

from itertools import pairwise

import networkx
import numpy as np
import shapely

from wcsim.errors import TownError
from wcsim.towns.ground.plane_geometry import arc_of, length_of, yaw_of
from wcsim.types import F64, I32, Bool, Route, WalkGraph, WayKind

SPACING_M = 1.0  # of a route's points
_START_MARGIN_M = 1.0  # no start lies at the very end of a pavement
# People walk this far round to save a crossing, and round any town rather than wait at a light that
# no program frees.
_CROSSING_COST_M = 10.0
_NEVER_GREEN_COST_M = 10_000.0
SOON_M = 80.0  # most ways of some hundred metres cross a road, but few episodes last until they do
# A way that comes back to itself so soon and so near went nowhere.
_SPUR_M, _SPUR_GAP_M, _SPUR_RATIO = 8.0, 0.7, 3.0

XY = tuple[float, float]


class Router:
    """Finds routes in one walk graph."""

    def __init__(self, walk: WalkGraph) -> None:
        """Raises TownError when there is nothing to drive on."""
        if not walk.edges:
            raise TownError("the town has no connected pavement; check it with `wcsim town check`")
        self.walk = walk
        self._length_m = np.array([length_of(edge.points_W_m) for edge in walk.edges])  # (E,)
        self._lines = shapely.linestrings(
            np.concatenate([edge.points_W_m for edge in walk.edges]),
            indices=np.repeat(
                np.arange(len(walk.edges)), [len(edge.points_W_m) for edge in walk.edges]
            ),
        )
        self._tree = shapely.STRtree(self._lines)
        self._graph = self._weighted()
        starts = np.array([e.kind is WayKind.SIDEWALK for e in walk.edges]) & (
            self._length_m > 2 * _START_MARGIN_M
        )
        self._starts = np.flatnonzero(starts if starts.any() else self._length_m > 0.0)

    def route(self, start_xy: XY, goal_xy: XY) -> Route:
        """The shortest route between the points of the network that are nearest to two places."""
        first, first_m = self._snap(start_xy)
        last, last_m = self._snap(goal_xy)
        if first == last:
            best = [(first, _part(self.walk.edges[first].points_W_m, first_m, last_m))]
        else:
            best = self._through(first, first_m, last, last_m)
        points_m = np.concatenate([piece for _, piece in best])
        edges = np.concatenate([np.full(len(piece), index, np.int32) for index, piece in best])
        return _resampled(points_m, edges)

    def away_m(self, xy: XY) -> float:
        """How far a place is from the network; infinite for one that is no place."""
        if not np.isfinite(xy).all():
            return float("inf")
        point = shapely.Point(xy)
        return float(shapely.distance(self._lines[int(self._tree.nearest(point))], point))

    def random_start(self, rng: np.random.Generator) -> tuple[XY, float]:
        """A place on a pavement, every metre equally likely, and a direction (rad) along it."""
        weights = self._length_m[self._starts]
        index = int(self._starts[rng.choice(len(weights), p=weights / weights.sum())])
        length_m = float(self._length_m[index])
        margin_m = min(_START_MARGIN_M, 0.25 * length_m)
        at_m = rng.uniform(margin_m, length_m - margin_m)
        here, ahead = self._at(index, at_m), self._at(index, min(length_m, at_m + 0.1))
        if np.allclose(here, ahead):
            here = self._at(index, at_m - 0.1)
        yaw_rad = yaw_of(ahead - here)
        if rng.random() >= 0.5:
            yaw_rad += -np.pi if yaw_rad > 0.0 else np.pi
        return (float(here[0]), float(here[1])), yaw_rad

    def random_goal(
        self,
        rng: np.random.Generator,
        start_xy: XY,
        min_m: float,
        max_m: float,
        crossing_share: float = 0.0,
    ) -> XY:
        """A place on a pavement, min_m to max_m of way from `start_xy`, or as near as there is one.

        With the chance `crossing_share` it is one of those to which the way leads over a crossing
        within `SOON_M`, where there are any.
        """
        over_road = crossing_share > 0.0 and bool(rng.random() < crossing_share)
        reach_m, near_m, over = self._reach(start_xy, max_m)
        middle_m = near_m + 0.5 * self._length_m[self._starts]
        fits = (middle_m >= min_m) & (middle_m <= max_m)
        if not fits.any():
            reach_m, near_m, over = self._reach(start_xy, None)
            middle_m = near_m + 0.5 * self._length_m[self._starts]
            miss_m = np.maximum(min_m - middle_m, middle_m - max_m)
            fits = miss_m <= miss_m.min() + 1e-9
        if over_road and (fits & over).any():
            fits &= over
        weights = np.where(fits, self._length_m[self._starts], 0.0)
        index = int(self._starts[rng.choice(len(weights), p=weights / weights.sum())])
        edge, length_m = self.walk.edges[index], float(self._length_m[index])
        low_m, high_m = (
            np.clip(bound - near_m[self._starts == index][0], 0.1 * length_m, 0.9 * length_m)
            for bound in (min_m, max_m)
        )
        along_m = rng.uniform(low_m, max(low_m, high_m))
        starts_nearer = reach_m.get(edge.start, np.inf) <= reach_m.get(edge.end, np.inf)
        at_m = along_m if starts_nearer else length_m - along_m
        goal = self._at(index, at_m)
        return float(goal[0]), float(goal[1])

    def _weighted(self) -> networkx.MultiGraph:
        graph = networkx.Graph()
        for index, edge in enumerate(self.walk.edges):
            cost_m = float(self._length_m[index])
            cost_m += _CROSSING_COST_M * (edge.kind is WayKind.CROSSING)
            cost_m += _NEVER_GREEN_COST_M * edge.never_green
            known = graph.get_edge_data(edge.start, edge.end)
            if known is None or cost_m < known["weight"]:
                graph.add_edge(edge.start, edge.end, weight=cost_m, index=index)
        return graph

    def _reach(self, start_xy: XY, cutoff_m: float | None) -> tuple[dict[int, float], F64, Bool]:
        """How far it is from a point, up to a limit.

        Returns:
            The cost of the way to each node; that to the nearer end of each edge of `_starts`; and
            to which of these edges the way leads over a crossing within `SOON_M`.
        """
        first, at_m = self._snap(start_xy)
        edge = self.walk.edges[first]
        ends = ((edge.start, at_m), (edge.end, float(self._length_m[first]) - at_m))
        reach_m: dict[int, float] = {}
        over: dict[int, bool] = {}
        for node, offset_m in ends:
            before, found = networkx.dijkstra_predecessor_and_distance(
                self._graph, node, cutoff=cutoff_m
            )
            crosses = {node: False}
            # The nearest is first, so what lies before a node is known.
            for other, cost_m in found.items():
                if other != node:
                    last = before[other][0]
                    soon = offset_m + found[last] <= SOON_M
                    way = self.walk.edges[self._graph[last][other]["index"]]
                    crosses[other] = crosses[last] or (soon and way.kind is WayKind.CROSSING)
                if offset_m + cost_m < reach_m.get(other, np.inf):
                    reach_m[other], over[other] = offset_m + cost_m, crosses[other]
        edges = [self.walk.edges[index] for index in self._starts.tolist()]
        nearer = [min((e.start, e.end), key=lambda node: reach_m.get(node, np.inf)) for e in edges]
        near_m = np.array([reach_m.get(node, np.inf) for node in nearer])
        return reach_m, near_m, np.array([over.get(node, False) for node in nearer], np.bool_)

    def _snap(self, xy: XY) -> tuple[int, float]:
        """The nearest edge and the distance along it."""
        point = shapely.Point(xy)
        index = int(self._tree.nearest(point))
        return index, float(shapely.line_locate_point(self._lines[index], point))

    def _at(self, index: int, at_m: float) -> F64:
        point = shapely.line_interpolate_point(self._lines[index], at_m)
        place_m: F64 = shapely.get_coordinates(point)[0]
        return place_m

    def _through(
        self, first: int, first_m: float, last: int, last_m: float
    ) -> list[tuple[int, F64]]:
        """Pieces of the cheapest way over one end of the first and one end of the last edge."""
        # 1. Search, with both places as nodes of the graph for once.
        a, b = self.walk.edges[first], self.walk.edges[last]
        a_m, b_m = float(self._length_m[first]), float(self._length_m[last])
        graph = self._graph
        graph.add_edge("start", a.start, weight=first_m)
        graph.add_edge("start", a.end, weight=max(0.0, a_m - first_m))
        graph.add_edge("goal", b.start, weight=last_m)
        graph.add_edge("goal", b.end, weight=max(0.0, b_m - last_m))
        nodes = networkx.shortest_path(graph, "start", "goal", weight="weight")[1:-1]
        graph.remove_nodes_from(("start", "goal"))

        # 2. Turn each edge into the direction of the way.
        leaves_m = 0.0 if nodes[0] == a.start else a_m
        pieces = [(first, _part(a.points_W_m, first_m, leaves_m))]
        for node, following in pairwise(nodes):
            index = graph[node][following]["index"]
            edge = self.walk.edges[index]
            pieces.append((index, edge.points_W_m if edge.start == node else edge.points_W_m[::-1]))
        enters_m = 0.0 if nodes[-1] == b.start else b_m
        return [*pieces, (last, _part(b.points_W_m, enters_m, last_m))]


def edges_ahead(walk: WalkGraph, route: Route, arc_m: float) -> tuple[str, ...]:
    """SUMO's edges of a route in their order; the first is that at `arc_m`."""
    first = max(0, int(np.searchsorted(route.arc_m, arc_m, side="right")) - 1)
    found: dict[str, None] = {}
    for index in route.edge_index[first:].tolist():
        # The graph has an edge of SUMO for a walking area, and a lane of one for other ways.
        way = walk.edges[index]
        is_area = way.kind is WayKind.WALKINGAREA
        found[way.sumo_id if is_area else way.sumo_id.rpartition("_")[0]] = None
    return tuple(found)


def _part(points_m: F64, from_m: float, to_m: float) -> F64:
    """The part of a polyline between two distances along it, from the first to the second."""
    arc_m = arc_of(points_m)
    low_m, high_m = min(from_m, to_m), max(from_m, to_m)
    inner = points_m[(arc_m > low_m + 1e-9) & (arc_m < high_m - 1e-9)]
    ends = np.column_stack([np.interp([low_m, high_m], arc_m, points_m[:, k]) for k in (0, 1)])
    part = np.concatenate([ends[:1], inner, ends[1:]])
    return part if from_m <= to_m else part[::-1]


def _resampled(points_m: F64, edges: I32) -> Route:
    """A route of all corners and points between them, each with the edge that starts there."""
    # 1. Drop doubles.
    step_m = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    moves = np.concatenate([step_m > 1e-6, [True]])
    if not moves[:-1].any():
        points_m, edges = np.repeat(points_m[-1:], 2, axis=0), np.repeat(edges[-1:], 2)
        return Route(points_W_m=points_m, arc_m=np.zeros(2), edge_index=edges)
    points_m, edges = points_m[moves], edges[moves]

    # 2. Put points between the corners.
    corner_m = arc_of(points_m)
    count = np.maximum(1, np.ceil(np.diff(corner_m) / SPACING_M).astype(int))
    fine = [
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in zip(corner_m[:-1], corner_m[1:], count, strict=True)
    ]
    arc_m = np.concatenate([*fine, corner_m[-1:]])
    owner = np.concatenate([np.repeat(edges[:-1], count), edges[-1:]]).astype(np.int32)
    fine_m = np.column_stack([np.interp(arc_m, corner_m, points_m[:, k]) for k in (0, 1)])

    # 3. Leave out spurs to a node and back: a way goes on where it comes by again.
    through: list[int] = []
    at = 0
    while at < len(fine_m):
        through.append(at)
        reach = int(np.searchsorted(arc_m, arc_m[at] + _SPUR_M, side="right"))
        way_m = arc_m[at + 2 : reach] - arc_m[at]
        gap_m = np.linalg.norm(fine_m[at + 2 : reach] - fine_m[at], axis=1)
        is_near = (gap_m > 1e-6) & (gap_m < _SPUR_GAP_M)
        back = np.flatnonzero(is_near & (way_m > _SPUR_RATIO * gap_m))
        at = at + 2 + int(back[-1]) if len(back) else at + 1
    if len(through) < len(fine_m):
        fine_m, owner = fine_m[through], owner[through]
        arc_m = arc_of(fine_m)
    return Route(points_W_m=fine_m, arc_m=arc_m, edge_index=owner)
