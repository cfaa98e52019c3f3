"""Makes a drawn plan look grown: links left out, junctions moved, bends, the whole town turned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import networkx
import numpy as np
import shapely

from wcsim.core.frames import rad
from wcsim.towns.making.plan import StreetPlan, connected
from wcsim.types import F64

_SCALES = (1.0, 0.7, 0.5, 0.3, 0.15, 0.0)  # of the moves: the first that leaves room for junctions
_LEAST_ANGLE_RAD = rad(42.0)  # between two streets at a junction
_STRAIGHT_RAD = rad(35.0)  # where a street may lose the junction that it bends at
_LEAST_LINK_M = 48.0
_LEAST_STUB_M = 25.0
_APART_M = 24.0  # between streets that do not meet
_BOWED_LINK_M = 80.0  # shorter ones stay straight
_BOW_POINTS = 7
_WAVES = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapedPlan:
    """A plan whose links have shapes."""

    plan: StreetPlan
    lines_m: tuple[F64, ...]  # (K, 2) of each link, from its first junction to its second


def shape_plan(plan: StreetPlan, rng: np.random.Generator) -> ShapedPlan:
    """A plan with links left out, junctions moved, some links bent, and all of it turned by a random angle."""
    thinned = _thinned(plan, float(rng.uniform(0.0, 0.22)), rng)
    moved = _moved(thinned, rng)
    lines = _bent(moved, float(rng.choice([0.0, 0.3, 0.7])), rng)
    angle_rad = rng.uniform(0.0, 2.0 * np.pi)
    turn = np.array([[np.cos(angle_rad), np.sin(angle_rad)], [-np.sin(angle_rad), np.cos(angle_rad)]])
    turned = StreetPlan(nodes_m=moved.nodes_m @ turn, links=moved.links)
    return ShapedPlan(plan=turned, lines_m=tuple(line @ turn for line in lines))


def _thinned(plan: StreetPlan, share: float, rng: np.random.Generator) -> StreetPlan:
    """Without some links, and without most streets that only lead out; everything still hangs together."""
    graph = plan.graph()
    wanted, dropped = round(share * len(plan.links)), set()
    stubs = rng.uniform(0.3, 0.9)
    for number in rng.permutation(len(plan.links)).tolist():
        a, b = plan.links[number]
        degrees = sorted((graph.degree(a), graph.degree(b)))
        if degrees[0] == 1:
            if degrees[1] > 2 and rng.random() > stubs:
                graph.remove_edge(a, b)
                dropped.add(number)
        elif wanted and degrees[0] > 2 and _go_on(plan, graph, a, b) and _go_on(plan, graph, b, a):
            graph.remove_edge(a, b)
            if networkx.has_path(graph, a, b) and not _cut_points(graph, a, b):
                wanted -= 1
                dropped.add(number)
            else:
                graph.add_edge(a, b, link=number)
    links = tuple(link for number, link in enumerate(plan.links) if number not in dropped)
    return connected(StreetPlan(nodes_m=plan.nodes_m, links=links))


def _go_on(plan: StreetPlan, graph: networkx.Graph, node: int, without: int) -> bool:
    """Whether a junction makes no sharp bend when its link to another one is left out."""
    ends = sorted(set(graph.neighbors(node)) - {without})
    if len(ends) > 2:
        return True
    ways = plan.nodes_m[ends] - plan.nodes_m[node]
    return bool(ways[0] @ ways[1] < -np.cos(_STRAIGHT_RAD) * np.prod(np.linalg.norm(ways, axis=1)))


def _cut_points(graph: networkx.Graph, a: int, b: int) -> bool:
    """Whether there is only one way left between two junctions."""
    return bool(networkx.edge_connectivity(graph, a, b) < 2)


def _moved(plan: StreetPlan, rng: np.random.Generator) -> StreetPlan:
    """Junctions moved by waves as wide as the town, and each by a little of its own."""
    size_m = float(np.ptp(plan.nodes_m, axis=0).max())
    shift_m = np.zeros_like(plan.nodes_m)
    for _ in range(_WAVES):
        way, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        length_m, high_m = size_m * rng.uniform(0.7, 1.6), size_m * rng.uniform(0.0, 0.03)
        along_m = plan.nodes_m @ np.array([np.cos(way), np.sin(way)])
        aside = np.array([-np.sin(way), np.cos(way)])
        shift_m += high_m * np.sin(2.0 * np.pi * along_m / length_m + phase)[:, None] * aside
    shift_m += rng.normal(0.0, rng.choice([0.0, 4.0, 10.0]), plan.nodes_m.shape)
    for scale in _SCALES:
        moved = StreetPlan(nodes_m=plan.nodes_m + scale * shift_m, links=plan.links)
        if _has_room(moved, [moved.nodes_m[list(link)] for link in moved.links]):
            return moved
    return plan


def _bent(plan: StreetPlan, share: float, rng: np.random.Generator) -> list[F64]:
    """The lines of all links, a share of the long ones bowed to a side."""
    lines = [plan.nodes_m[list(link)] for link in plan.links]
    for number, line in enumerate(lines):
        drawn, bow = rng.random(), rng.uniform(-0.12, 0.12)
        if drawn < share and np.hypot(*(line[1] - line[0])) > _BOWED_LINK_M:
            straight, lines[number] = line, _bowed(line, bow)
            if not _has_room(plan, lines):
                lines[number] = straight
    return lines


def _bowed(line: F64, bow: float) -> F64:
    along = line[1] - line[0]
    aside = np.array([-along[1], along[0]])
    share = np.linspace(0.0, 1.0, _BOW_POINTS)[:, None]
    return np.asarray(line[0] + share * along + 4.0 * bow * share * (1.0 - share) * aside)


def _has_room(plan: StreetPlan, lines: Sequence[F64]) -> bool:
    """Whether junctions have room: no sharp angles, no short links, no streets beside each other."""
    degree = np.bincount(np.array(plan.links).ravel(), minlength=len(plan.nodes_m))
    for (a, b), line in zip(plan.links, lines, strict=True):
        stub = min(degree[a], degree[b]) == 1
        if np.hypot(*(line[-1] - line[0])) < (_LEAST_STUB_M if stub else _LEAST_LINK_M):
            return False
    if least_angle_rad(plan, lines) < _LEAST_ANGLE_RAD:
        return False
    shapes = [shapely.LineString(line) for line in lines]
    tree = shapely.STRtree(shapes)
    first, second = tree.query(shapes, predicate="dwithin", distance=_APART_M)
    return not any(
        i < j and not set(plan.links[i]) & set(plan.links[j])
        for i, j in zip(first.tolist(), second.tolist(), strict=True)
    )


def least_angle_rad(plan: StreetPlan, lines: Sequence[F64]) -> float:
    """The smallest angle between two streets at one junction."""
    ways: dict[int, list[float]] = {}
    for (a, b), line in zip(plan.links, lines, strict=True):
        for node, way in ((a, line[1] - line[0]), (b, line[-2] - line[-1])):
            ways.setdefault(node, []).append(float(np.arctan2(way[1], way[0])))
    gaps = [
        float(np.diff([*sorted(angles), min(angles) + 2.0 * np.pi]).min())
        for angles in ways.values()
        if len(angles) > 1
    ]
    return min(gaps, default=np.pi)
