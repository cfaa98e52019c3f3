"""Writes streets as SUMO's plain nodes and edges, and lets netconvert make a net with pavements and crossings of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wcsim.errors import SumoError
from wcsim.towns.making.named_streets import MAIN, RESIDENTIAL, WALK, NamedStreet
from wcsim.towns.making.shaping import ShapedPlan
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.types import F64

_LIMITS = Limits(wall_s=120.0, cpu_s=120)
_NETCONVERT = (
    "--crossings.guess",
    "--crossings.guess.speed-threshold",
    "18",
    "--walkingareas",
    "--junctions.corner-detail",
    "5",
    "--tls.default-type",
    "actuated",
    "--no-turnarounds.except-deadend",
    "--output.street-names",
)
_LEFTHAND_SHARE = 0.15
_NAMES = ("Oak", "Mill", "Station", "Church", "Harbour", "Market", "King", "Garden", "River", "Bridge", "Hill", "Park")


@dataclass(frozen=True, slots=True, kw_only=True)
class Signals:
    """How a town's junctions are made."""

    share: float  # of the crossings of larger streets have signals
    crossing_m: float  # width of the crossings
    corner_m: float  # radius of the corners
    lefthand: bool  # traffic keeps to the left


def draw_signals(rng: np.random.Generator) -> Signals:
    """How the junctions of a town are made."""
    share, crossing_m, corner_m = rng.uniform((0.2, 2.8, 2.5), (0.9, 5.0, 6.0)).tolist()
    return Signals(share=share, crossing_m=crossing_m, corner_m=corner_m, lefthand=bool(rng.random() < _LEFTHAND_SHARE))


def write_net(
    name: str,
    shaped: ShapedPlan,
    streets: tuple[NamedStreet, ...],
    signals: Signals,
    folder: Path,
    rng: np.random.Generator,
) -> Path:
    """Make <name>.net.xml in `folder`. Raises SumoError when netconvert fails."""
    nodes, edges = folder / "made.nod.xml", folder / "made.edg.xml"
    nodes.write_text(_nodes(shaped, streets, signals, rng), encoding="utf-8")
    edges.write_text(_edges(shaped, streets), encoding="utf-8")
    options = ["-n", nodes.name, "-e", edges.name, *_NETCONVERT, "-o", f"{name}.net.xml"]
    options += ["--default.crossing-width", f"{signals.crossing_m:.2f}"]
    options += ["--default.junctions.radius", f"{signals.corner_m:.2f}"]
    options += ["--lefthand"] * signals.lefthand
    run = run_tool("netconvert", options, folder, _LIMITS)
    for path in (nodes, edges):
        path.unlink()
    if run.returncode:
        raise SumoError(f"no net could be built: {run.reason()}; use another seed or size")
    return folder / f"{name}.net.xml"


def _nodes(shaped: ShapedPlan, streets: tuple[NamedStreet, ...], signals: Signals, rng: np.random.Generator) -> str:
    meeting: dict[int, list[NamedStreet]] = {}
    for street in streets:
        for link in street.links:
            for node in shaped.plan.links[link]:
                meeting.setdefault(node, []).append(street)
    lines = ["<nodes>"]
    for number, (x_m, y_m) in enumerate(shaped.plan.nodes_m.tolist()):
        kind = _node_kind(meeting[number], signals.share, float(rng.random()))
        lines.append(f'    <node id="j{number}" x="{x_m:.2f}" y="{y_m:.2f}" type="{kind}"/>')
    return "\n".join([*lines, "</nodes>", ""])


def _node_kind(arms: list[NamedStreet], share: float, drawn: float) -> str:
    """Signals where larger streets meet, else priority; where only small streets meet, right before left."""
    driven = [street for street in arms if street.kind is not WALK]
    larger = {street.number for street in driven if street.kind is not RESIDENTIAL}
    main = any(street.kind is MAIN for street in driven)
    if len(driven) > 2 and ((len(larger) > 1 and drawn < share) or (main and drawn < 0.4 * share)):
        return "traffic_light"
    if len(driven) > 2 and not larger and drawn < 0.7:
        return "right_before_left"
    return "priority"


def _edges(shaped: ShapedPlan, streets: tuple[NamedStreet, ...]) -> str:
    lines = ["<edges>"]
    for street in streets:
        name = f"{_NAMES[street.number % len(_NAMES)]} Street {street.number // len(_NAMES) + 1}"
        for link in street.links:
            a, b = shaped.plan.links[link]
            line_m = shaped.lines_m[link]
            backward = street.kind.name != WALK.name and (not street.oneway or street.pavements_m[1] > 0.0)
            lines.append(_edge(str(link), (a, b), line_m, street, name, street.pavements_m[0]))
            if backward and not street.oneway:
                lines.append(_edge(f"-{link}", (b, a), line_m[::-1], street, name, street.pavements_m[1]))
            elif backward:
                lines.append(_footway(f"-{link}", (b, a), line_m[::-1], street, name))
    return "\n".join([*lines, "</edges>", ""])


def _edge(edge: str, ends: tuple[int, int], line_m: F64, street: NamedStreet, name: str, pavement_m: float) -> str:
    kind = street.kind
    head = f'    <edge id="{edge}" from="j{ends[0]}" to="j{ends[1]}" name="{name}" type="{kind.name}"'
    rules = f'priority="{kind.priority}" numLanes="{street.lanes}" speed="{street.speed_mps}" width="{street.lane_m}"'
    if kind is WALK:
        return f'{head} {rules} spreadType="center" allow="pedestrian bicycle"{_shape(line_m)}/>'
    more = f' bikeLaneWidth="{street.cycle_m}"' if street.cycle_m else ""
    spread = ' spreadType="right"'
    return f'{head} {rules}{spread} disallow="{street.closed}" sidewalkWidth="{pavement_m}"{more}{_shape(line_m)}/>'


def _footway(edge: str, ends: tuple[int, int], line_m: F64, street: NamedStreet, name: str) -> str:
    """The pavement on the left side of a one-way street."""
    head = f'    <edge id="{edge}" from="j{ends[0]}" to="j{ends[1]}" name="{name}" type="footway" priority="1"'
    rules = f'numLanes="1" speed="2.78" width="{street.pavements_m[1]}" allow="pedestrian" spreadType="right"'
    return f"{head} {rules}{_shape(line_m)}/>"


def _shape(line_m: F64) -> str:
    if len(line_m) < 3:
        return ""
    return ' shape="' + " ".join(f"{x:.2f},{y:.2f}" for x, y in line_m.tolist()) + '"'
