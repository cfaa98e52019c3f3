"""Street plans as SUMO's netgenerate draws them: junctions and links, without widths or lanes.

A plan is then made to look grown: links left out, junctions moved, bends, the whole town turned.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import networkx
import numpy as np
import shapely

from wcsim.core.frames import deg2rad
from wcsim.core.seeding import derive_seed
from wcsim.errors import SumoError
from wcsim.towns.ground.plane_geometry import left_of, yaw_of
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.sumo.xml_io import read_root
from wcsim.types import F64

_LIMITS = Limits(wall_s=60.0, cpu_s=60)
_STUB_M = (30.0, 70.0)  # streets that lead out of the town
_WIDE_RAD = deg2rad(55.0)
_APART_M = 40.0  # between an added link and streets that it does not meet
_SHORTEST_M = 55.0  # of a link
_LINKS_PER_HA = 3.4  # of a random net, so many that its rim can be cut off
_SCALES = (1.0, 0.7, 0.5, 0.3, 0.15, 0.0)  # of the moves: the first that leaves room for junctions
_LEAST_ANGLE_RAD = deg2rad(42.0)  # between two streets at a junction
_STRAIGHT_RAD = deg2rad(35.0)  # where a street may lose the junction that it bends at
_LEAST_LINK_M = 48.0
_LEAST_STUB_M = 25.0
_CLEAR_M = 24.0  # between streets that do not meet
_BOWED_LINK_M = 80.0  # shorter ones stay straight
_BOW_POINTS = 7
_WAVES = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetPlan:
    """Junctions and links between them."""

    nodes_m: F64  # (N, 2)
    links: tuple[tuple[int, int], ...]  # rows of `nodes_m`
    # (K, 2) of each link, from its first junction on; none: all are straight.
    lines_m: tuple[F64, ...] = ()

    def arms(self, lines: Sequence[F64]) -> dict[int, list[tuple[int, float]]]:
        """The links at each junction with their directions (rad) from there, along their lines."""
        found: dict[int, list[tuple[int, float]]] = {}
        for number, ((a, b), line) in enumerate(zip(self.links, lines, strict=True)):
            for node, way in ((a, line[1] - line[0]), (b, line[-2] - line[-1])):
                found.setdefault(node, []).append((number, yaw_of(way)))
        return found

    def graph(self) -> networkx.Graph:
        """The links as a graph; the edges know their number as `link`."""
        graph = networkx.Graph()
        graph.add_nodes_from(range(len(self.nodes_m)))
        graph.add_edges_from((a, b, {"link": number}) for number, (a, b) in enumerate(self.links))
        return graph


def draw_plan(
    kind: str, size_m: float, seed: int, rng: np.random.Generator, folder: Path
) -> StreetPlan:
    """A connected plan about `size_m` across, its middle at (0, 0).

    Args:
        kind: "grid", "spider" or "random".
        size_m: Width and height.
        seed: For netgenerate.
        rng: Draws the dimensions: block lengths, arms, rings.
        folder: A place for files in between.

    Raises:
        SumoError: netgenerate failed.
    """
    # 1. Draw it.
    options = {"grid": _grid, "spider": _spider, "random": _random}[kind](size_m, rng)
    options += ["--seed", str(derive_seed(seed, "netgenerate"))]
    options += ["--plain-output-prefix", "plan", "-o", "plan.net.xml"]
    run = run_tool("netgenerate", options, folder, _LIMITS)
    if run.returncode:
        raise SumoError(f"no streets could be drawn: {run.reason()}; use another seed or size")

    # 2. Read it.
    nodes = list(read_root(folder / "plan.nod.xml").iterfind("node"))
    number = {node.attrib["id"]: row for row, node in enumerate(nodes)}
    edges = read_root(folder / "plan.edg.xml").iterfind("edge")
    ends = [(number[edge.attrib["from"]], number[edge.attrib["to"]]) for edge in edges]
    links = sorted({(min(pair), max(pair)) for pair in ends})
    nodes_m = np.array([[float(node.attrib["x"]), float(node.attrib["y"])] for node in nodes])
    for path in folder.glob("plan.*"):
        path.unlink()

    # 3. Cut out a square about its middle.
    nodes_m -= 0.5 * (nodes_m.min(axis=0) + nodes_m.max(axis=0))
    inside = np.abs(nodes_m).max(axis=1) <= 0.5 * size_m + 1.0
    links = [(a, b) for a, b in links if inside[a] and inside[b]]
    plan = _connected(StreetPlan(nodes_m=nodes_m, links=tuple(links)))
    if kind == "random":
        return _joined(_merged(plan))
    if kind == "grid":
        return plan

    # 4. Add streets outwards. netgenerate attaches them to the innermost ring of a spider only.
    far_m = np.hypot(*plan.nodes_m.T)
    rim = np.flatnonzero(far_m > 0.85 * far_m.max())
    out_m = plan.nodes_m[rim] * (1.0 + rng.uniform(*_STUB_M) / far_m[rim])[:, None]
    stubs = [(int(node), len(far_m) + row) for row, node in enumerate(rim)]
    return StreetPlan(nodes_m=np.vstack([plan.nodes_m, out_m]), links=(*plan.links, *stubs))


def shape_plan(plan: StreetPlan, rng: np.random.Generator) -> StreetPlan:
    """A plan with links left out, junctions moved, some links bent, and all of it turned."""
    thinned = _thinned(plan, rng.uniform(0.0, 0.22), rng)
    moved = _moved(thinned, rng)
    lines = _bent(moved, float(rng.choice([0.0, 0.3, 0.7])), rng)
    angle_rad = rng.uniform(0.0, 2.0 * np.pi)
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cos, sin], [-sin, cos]])
    turned = tuple(line @ turn for line in lines)
    return StreetPlan(nodes_m=moved.nodes_m @ turn, links=moved.links, lines_m=turned)


def _connected(plan: StreetPlan) -> StreetPlan:
    """The largest part of a plan that hangs together, its junctions numbered anew."""
    graph = plan.graph()
    graph.remove_nodes_from([node for node, degree in list(graph.degree()) if degree == 0])
    parts = [sorted(part) for part in networkx.connected_components(graph)]
    largest = max(parts, key=lambda part: (len(part), -part[0]))
    number = {node: new for new, node in enumerate(largest)}
    links = tuple((number[a], number[b]) for a, b in plan.links if a in number and b in number)
    return StreetPlan(nodes_m=plan.nodes_m[largest], links=links)


def _merged(plan: StreetPlan) -> StreetPlan:
    """With junctions that are too close made one.

    netgenerate keeps a distance between junctions, but not to streets.
    """
    nodes_m, links = plan.nodes_m.copy(), sorted(plan.links)
    while links:
        lengths_m = np.hypot(*(nodes_m[[a for a, _ in links]] - nodes_m[[b for _, b in links]]).T)
        if lengths_m.min() >= _SHORTEST_M:
            break
        node, other = links[int(lengths_m.argmin())]
        nodes_m[node] = 0.5 * (nodes_m[node] + nodes_m[other])
        moved = [tuple(node if end == other else end for end in link) for link in links]
        links = sorted({(min(a, b), max(a, b)) for a, b in moved if a != b})
    return _connected(StreetPlan(nodes_m=nodes_m, links=tuple(links)))


def _grid(size_m: float, rng: np.random.Generator) -> list[str]:
    stub_m = rng.uniform(*_STUB_M)
    inner_m = size_m - 2.0 * stub_m
    options = ["--grid", "--grid.attach-length", f"{stub_m:.1f}"]
    for axis, block_m in zip("xy", rng.uniform((75.0, 65.0), (170.0, 110.0)), strict=True):
        blocks = max(1, round(inner_m / block_m))
        options += [f"--grid.{axis}-number", str(blocks + 1)]
        options += [f"--grid.{axis}-length", f"{inner_m / blocks:.1f}"]
    return options


def _spider(size_m: float, rng: np.random.Generator) -> list[str]:
    arms, radius_m = int(rng.integers(5, 10)), 0.5 * size_m - _STUB_M[1]
    rings = max(1, round(radius_m / rng.uniform(65.0, 95.0)))
    options = ["--spider", "--spider.arm-number", str(arms), "--spider.circle-number", str(rings)]
    options += ["--spider.space-radius", f"{radius_m / rings:.1f}"]
    return [*options, *(["--spider.omit-center"] if arms > 5 else [])]


def _random(size_m: float, rng: np.random.Generator) -> list[str]:
    least_m = rng.uniform(65.0, 90.0)
    options = ["--rand", "--rand.iterations", str(round(_LINKS_PER_HA * (size_m / 100.0) ** 2))]
    options += ["--rand.min-distance", f"{least_m:.1f}"]
    options += ["--rand.max-distance", f"{rng.uniform(1.5, 1.9) * least_m:.1f}"]
    options += ["--rand.min-angle", "55", "--rand.connectivity", f"{rng.uniform(0.9, 0.99):.2f}"]
    options += ["--rand.neighbor-dist1", "0", "--rand.neighbor-dist3", "10"]
    return [*options, "--rand.neighbor-dist4", "10"]


def _joined(plan: StreetPlan) -> StreetPlan:
    """With links between near junctions that have none, the shortest first, where angles stay wide.

    So no loop hangs on the rest by one street.
    """
    links: list[tuple[int, int]] = []
    lines: list[shapely.LineString] = []
    for link in plan.links:
        line = shapely.LineString(plan.nodes_m[list(link)])
        if not _crowded(line, link, links, lines):
            links.append(link)
            lines.append(line)
    apart_m = np.hypot(*(plan.nodes_m[:, None] - plan.nodes_m[None]).transpose(2, 0, 1))
    longest_m = 1.2 * max(line.length for line in lines)
    near = np.argwhere(np.tril((apart_m >= _SHORTEST_M) & (apart_m < longest_m)))
    pairs = sorted((apart_m[a, b], a, b) for a, b in near.tolist())
    for _, a, b in pairs:
        line = shapely.LineString(plan.nodes_m[[a, b]])
        if _crowded(line, (a, b), links, lines):
            continue
        gaps_rad = [_gap_rad(plan.nodes_m, links, *ends) for ends in ((a, b), (b, a))]
        if min(gaps_rad) > _WIDE_RAD:
            links.append((min(a, b), max(a, b)))
            lines.append(line)
    return _connected(StreetPlan(nodes_m=plan.nodes_m, links=tuple(sorted(set(links)))))


def _crowded(
    line: shapely.LineString,
    link: tuple[int, int],
    links: list[tuple[int, int]],
    lines: list[shapely.LineString],
) -> bool:
    """Whether a line comes too near to others that it does not meet at a junction."""
    others = (other for ends, other in zip(links, lines, strict=True) if not set(link) & set(ends))
    return any(shapely.dwithin(line, other, _APART_M) for other in others)


def _gap_rad(nodes_m: F64, links: list[tuple[int, int]], node: int, other: int) -> float:
    """The smallest angle at a junction between the way to another one and the links that it has."""
    ends = [a + b - node for a, b in links if node in (a, b)]
    ways = nodes_m[[other, *ends]] - nodes_m[node]
    turn_rad = np.arctan2(*ways.T[::-1])
    gaps_rad = np.abs((turn_rad[1:] - turn_rad[0] + np.pi) % (2.0 * np.pi) - np.pi)
    return float(gaps_rad.min(initial=np.pi))


def _thinned(plan: StreetPlan, share: float, rng: np.random.Generator) -> StreetPlan:
    """Without some links, and most streets that only lead out; the rest hangs together."""
    graph = plan.graph()
    left, dropped = round(share * len(plan.links)), set()
    stubs = rng.uniform(0.3, 0.9)
    for number in rng.permutation(len(plan.links)).tolist():
        a, b = plan.links[number]
        degrees = sorted((graph.degree(a), graph.degree(b)))
        if degrees[0] == 1:
            if degrees[1] > 2 and rng.random() > stubs:
                graph.remove_edge(a, b)
                dropped.add(number)
        elif left and degrees[0] > 2 and _go_on(plan, graph, a, b) and _go_on(plan, graph, b, a):
            graph.remove_edge(a, b)
            # Two ways at least must be left between its ends.
            if networkx.edge_connectivity(graph, a, b) > 1:
                left -= 1
                dropped.add(number)
            else:
                graph.add_edge(a, b, link=number)
    links = tuple(link for number, link in enumerate(plan.links) if number not in dropped)
    return _connected(StreetPlan(nodes_m=plan.nodes_m, links=links))


def _go_on(plan: StreetPlan, graph: networkx.Graph, node: int, without: int) -> bool:
    """Whether a junction makes no sharp bend when its link to another one is left out."""
    ends = sorted(set(graph.neighbors(node)) - {without})
    if len(ends) > 2:
        return True
    ways = plan.nodes_m[ends] - plan.nodes_m[node]
    return bool(ways[0] @ ways[1] < -np.cos(_STRAIGHT_RAD) * np.prod(np.linalg.norm(ways, axis=1)))


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
        along = line[1] - line[0]
        if drawn < share and np.hypot(*along) > _BOWED_LINK_M:
            way = np.linspace(0.0, 1.0, _BOW_POINTS)[:, None]
            aside = 4.0 * bow * way * (1.0 - way) * left_of(along)
            lines[number] = line[0] + way * along + aside
            if not _has_room(plan, lines):
                lines[number] = line
    return lines


def _has_room(plan: StreetPlan, lines: Sequence[F64]) -> bool:
    """Whether junctions have room: no sharp angles, short links, or streets beside each other."""
    degree = np.bincount(np.array(plan.links).ravel(), minlength=len(plan.nodes_m))
    for (a, b), line in zip(plan.links, lines, strict=True):
        stub = min(degree[a], degree[b]) == 1
        if np.hypot(*(line[-1] - line[0])) < (_LEAST_STUB_M if stub else _LEAST_LINK_M):
            return False
    if _least_angle_rad(plan, lines) < _LEAST_ANGLE_RAD:
        return False
    shapes = [shapely.LineString(line) for line in lines]
    tree = shapely.STRtree(shapes)
    first, second = tree.query(shapes, predicate="dwithin", distance=_CLEAR_M)
    return not any(
        i < j and not set(plan.links[i]) & set(plan.links[j])
        for i, j in zip(first.tolist(), second.tolist(), strict=True)
    )


def _least_angle_rad(plan: StreetPlan, lines: Sequence[F64]) -> float:
    """The smallest angle between two streets at one junction."""
    directions_rad = (sorted(rad for _, rad in arms) for arms in plan.arms(lines).values())
    gaps = [
        float(np.diff([*angles, angles[0] + 2.0 * np.pi]).min())
        for angles in directions_rad
        if len(angles) > 1
    ]
    return min(gaps, default=np.pi)
