"""Street plans as SUMO's netgenerate draws them: junctions and the links between them, without widths or lanes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import networkx
import numpy as np
import shapely

from wcsim.core.frames import rad
from wcsim.core.seeding import derive
from wcsim.errors import SumoError
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.sumo.xml_io import read_root
from wcsim.types import F64

_LIMITS = Limits(wall_s=60.0, cpu_s=60)
_STUB_M = (30.0, 70.0)  # streets that lead out of the town
_WIDE_RAD = rad(55.0)
_APART_M = 40.0  # between an added link and streets that it does not meet
_SHORTEST_M = 55.0  # of a link
_LINKS_PER_HA = 3.4  # of a random net, so many that its rim can be cut off


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetPlan:
    """Junctions and straight links between them."""

    nodes_m: F64  # (N, 2)
    links: tuple[tuple[int, int], ...]  # rows of `nodes_m`

    def graph(self) -> networkx.Graph:
        """The links as a graph; the edges know their number as `link`."""
        graph = networkx.Graph()
        graph.add_nodes_from(range(len(self.nodes_m)))
        graph.add_edges_from((a, b, {"link": number}) for number, (a, b) in enumerate(self.links))
        return graph


def draw_plan(kind: str, size_m: float, seed: int, rng: np.random.Generator, folder: Path) -> StreetPlan:
    """A connected plan about `size_m` across, its middle at (0, 0); `folder` is for files in between.

    Args:
        kind: "grid", "spider" or "random".
        size_m: Width and height.
        seed: For netgenerate.
        rng: Draws the dimensions: block lengths, arms, rings.
        folder: A place to work in.

    Raises:
        SumoError: netgenerate failed.
    """
    options = {"grid": _grid, "spider": _spider, "random": _random}[kind](size_m, rng)
    run = run_tool(
        "netgenerate",
        [*options, "--seed", str(derive(seed, "netgenerate")), "--plain-output-prefix", "plan", "-o", "plan.net.xml"],
        folder,
        _LIMITS,
    )
    if run.returncode:
        raise SumoError(f"no streets could be drawn: {run.reason()}; use another seed or size")
    plan = _read(folder)
    for path in folder.glob("plan.*"):
        path.unlink()
    plan = _middle(plan, size_m)
    if kind == "spider":  # netgenerate attaches streets to the innermost ring only
        return _with_stubs(plan, rng)
    return _joined(merged(plan)) if kind == "random" else plan


def connected(plan: StreetPlan) -> StreetPlan:
    """The largest part of a plan that hangs together, its junctions numbered anew."""
    graph = plan.graph()
    graph.remove_nodes_from([node for node, degree in list(graph.degree()) if degree == 0])
    parts = [sorted(part) for part in networkx.connected_components(graph)]
    kept = max(parts, key=lambda part: (len(part), -part[0]))
    number = {node: new for new, node in enumerate(kept)}
    links = tuple((number[a], number[b]) for a, b in plan.links if a in number and b in number)
    return StreetPlan(nodes_m=plan.nodes_m[kept], links=links)


def merged(plan: StreetPlan) -> StreetPlan:
    """With junctions that are too close made one: netgenerate keeps a distance to junctions, but not to streets."""
    nodes_m, links = plan.nodes_m.copy(), sorted(plan.links)
    while links:
        lengths_m = np.hypot(*(nodes_m[[a for a, _ in links]] - nodes_m[[b for _, b in links]]).T)
        if lengths_m.min() >= _SHORTEST_M:
            break
        kept, gone = links[int(lengths_m.argmin())]
        nodes_m[kept] = 0.5 * (nodes_m[kept] + nodes_m[gone])
        moved = [tuple(kept if node == gone else node for node in link) for link in links]
        links = sorted({(min(a, b), max(a, b)) for a, b in moved if a != b})
    return connected(StreetPlan(nodes_m=nodes_m, links=tuple(links)))


def _grid(size_m: float, rng: np.random.Generator) -> list[str]:
    stub_m = rng.uniform(*_STUB_M)
    inner_m = size_m - 2.0 * stub_m
    options = ["--grid", "--grid.attach-length", f"{stub_m:.1f}"]
    for axis, block_m in zip("xy", rng.uniform((75.0, 65.0), (170.0, 110.0)), strict=True):
        blocks = max(1, round(inner_m / block_m))
        options += [f"--grid.{axis}-number", str(blocks + 1), f"--grid.{axis}-length", f"{inner_m / blocks:.1f}"]
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
    options += [
        "--rand.min-distance",
        f"{least_m:.1f}",
        "--rand.max-distance",
        f"{rng.uniform(1.5, 1.9) * least_m:.1f}",
    ]
    options += ["--rand.min-angle", "55", "--rand.connectivity", f"{rng.uniform(0.9, 0.99):.2f}"]
    return [*options, "--rand.neighbor-dist1", "0", "--rand.neighbor-dist3", "10", "--rand.neighbor-dist4", "10"]


def _with_stubs(plan: StreetPlan, rng: np.random.Generator) -> StreetPlan:
    """With a street outwards from each junction of the rim."""
    far_m = np.hypot(*plan.nodes_m.T)
    rim = np.flatnonzero(far_m > 0.85 * far_m.max())
    out_m = plan.nodes_m[rim] * (1.0 + rng.uniform(*_STUB_M) / far_m[rim])[:, None]
    links = [(int(node), len(far_m) + number) for number, node in enumerate(rim)]
    return StreetPlan(nodes_m=np.vstack([plan.nodes_m, out_m]), links=(*plan.links, *links))


def _joined(plan: StreetPlan) -> StreetPlan:
    """With links between near junctions that have none, the shortest first, where angles stay wide: no lone loops."""
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
        if (
            not _crowded(line, (a, b), links, lines)
            and min(_gap_rad(plan.nodes_m, links, a, b), _gap_rad(plan.nodes_m, links, b, a)) > _WIDE_RAD
        ):
            links.append((min(a, b), max(a, b)))
            lines.append(line)
    return connected(StreetPlan(nodes_m=plan.nodes_m, links=tuple(sorted(set(links)))))


def _crowded(
    line: shapely.LineString, link: tuple[int, int], links: list[tuple[int, int]], lines: list[shapely.LineString]
) -> bool:
    """Whether a line comes too near to others that it does not meet at a junction."""
    others = (other for ends, other in zip(links, lines, strict=True) if not set(link) & set(ends))
    return any(shapely.dwithin(line, other, _APART_M) for other in others)


def _gap_rad(nodes_m: F64, links: list[tuple[int, int]], node: int, other: int) -> float:
    """The smallest angle at a junction between the way to another one and the links that it has."""
    ends = [a + b - node for a, b in links if node in (a, b)]
    ways = nodes_m[[other, *ends]] - nodes_m[node]
    turn_rad = np.arctan2(*ways.T[::-1])
    return float(np.abs((turn_rad[1:] - turn_rad[0] + np.pi) % (2.0 * np.pi) - np.pi).min(initial=np.pi))


def _read(folder: Path) -> StreetPlan:
    nodes = list(read_root(folder / "plan.nod.xml").iterfind("node"))
    number = {node.attrib["id"]: row for row, node in enumerate(nodes)}
    ends = [
        (number[e.attrib["from"]], number[e.attrib["to"]]) for e in read_root(folder / "plan.edg.xml").iterfind("edge")
    ]
    links = sorted({(min(pair), max(pair)) for pair in ends})
    nodes_m = np.array([[float(node.attrib["x"]), float(node.attrib["y"])] for node in nodes])
    return StreetPlan(nodes_m=nodes_m, links=tuple(links))


def _middle(plan: StreetPlan, size_m: float) -> StreetPlan:
    """The part of a plan within a square of `size_m` about its middle."""
    nodes_m = plan.nodes_m - 0.5 * (plan.nodes_m.min(axis=0) + plan.nodes_m.max(axis=0))
    inside = np.abs(nodes_m).max(axis=1) <= 0.5 * size_m + 1.0
    links = tuple((a, b) for a, b in plan.links if inside[a] and inside[b])
    return connected(StreetPlan(nodes_m=nodes_m, links=links))
