"""Endless traffic for a town: flows of every class that do not run dry, from a seed.

Ways from edge to edge are drawn, routed once by SUMO's `duarouter`, and those that it cannot route
are left out; the flows carry the routes, so that nothing is left to fail while the simulation runs.
SUMO makes all people of a personFlow when it reads it (48 hours of them: 2.4 s and 200 MB), but
reads its files only a little ahead of the clock; so the people come in slices, each along a part of
the ways.

A trial run finds walking ways on which people get stuck. Where SUMO's pavements are pinched, people
block each other for minutes, and with them the cars that wait for them.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from wcsim.core.reading import read_module_toml
from wcsim.core.seeding import derive_seed, make_rng
from wcsim.errors import SumoError
from wcsim.towns.ground.plane_geometry import arc_of
from wcsim.towns.sumo.net import Edge, Net
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.sumo.xml_io import read_root, write_gzip
from wcsim.types import F64

END_S = 1_000_000  # eleven days: longer than any run
_WALK_END_S = 172_800
_SLICE_S = 600
_SLICE_SHARE = 0.25  # of the walking ways are in use during one slice
_SHORTEST_M = 12.0  # no vehicle is put on a shorter edge
_VTYPES = "vtypes.xml"
_DATA = read_module_toml(__file__)

TRIAL_S = 600
ROUNDS = 2
_JAMMED = re.compile(r"Person 'walkers\.\d+\.(\d+)\.\d+' is jammed")


class _Traffic(NamedTuple):
    """How much of one class a town gets."""

    types: str  # id of the vType or vTypeDistribution
    vclass: str
    per_h_km: float  # departures per hour and kilometre of lane that the class may use
    flows_per_km: float  # how many different ways these are spread over
    shortest_m: float
    fringe: float  # how much likelier a way starts or ends where the town is cut off
    longest_m: float = math.inf  # straight line between the ends

    @property
    def walks(self) -> bool:
        """True for those on foot."""
        return self.vclass == "pedestrian"


MIX = tuple(_Traffic(**row) for row in _DATA["mix"])
CLASSES = tuple(dict.fromkeys(traffic.vclass for traffic in MIX))


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """A routed way of one class."""

    traffic: _Traffic
    edges: tuple[str, ...]


def build_ways(net: Net, net_path: Path, folder: Path, seed: int) -> tuple[Way, ...]:
    """Ways of all classes through a net; `folder` is for files in between. Raises SumoError."""
    drawn = [(traffic, pair) for traffic in MIX for pair in _draw(net, traffic, seed)]
    routed = _route(net_path, folder, drawn, seed)
    # The first ways that can be driven and are long enough are taken, as many as a class needs.
    length_m = {edge.id: edge.lanes[0].length_m for edge in net.edges if edge.lanes}
    left = {traffic.types: _flow_count(net, traffic) for traffic in MIX}
    ways: list[Way] = []
    for number, (traffic, _) in enumerate(drawn):
        edges = routed.get(number, [])
        way_m = sum(length_m[edge] for edge in edges)
        if left[traffic.types] and edges and way_m >= traffic.shortest_m:
            left[traffic.types] -= 1
            ways.append(Way(traffic=traffic, edges=tuple(edges)))
    return tuple(ways)


def vtypes_text(more: Sequence[str] = ()) -> str:
    """The vehicle and person types of the flows, as a SUMO additional file with `more` elements."""
    text = (Path(__file__).parent / _VTYPES).read_text(encoding="utf-8")
    lines = "".join(f"    {line}\n" for line in more)
    return text.replace("</additional>", f"{lines}</additional>")


def write_demand(
    sumocfg: Path,
    net: Net,
    ways: tuple[Way, ...],
    seed: int,
    scale: float = 1.0,
    per_hour: Mapping[str, float] | None = None,
    first: Sequence[str] = (),
) -> None:
    """Write the route file of a town's folder, <stem of its sumocfg>.rou.xml.gz.

    It has endless flows along `ways`, without the walking ones on which people get stuck, after the
    elements `first`. Its types are in `vtypes.xml`. A class has as many departures an hour as
    `per_hour` says, else those of MIX, all times `scale`.
    """
    for trials_left in reversed(range(ROUNDS + 1)):
        text = _flows_text(net, ways, seed, scale, per_hour or {}, first)
        write_gzip(sumocfg.with_suffix(".rou.xml.gz"), text.encode())
        stuck = _stuck_ways(sumocfg, ways) if trials_left and ways else ()
        if not stuck:
            return
        ways = tuple(way for way in ways if way not in stuck)


def _draw(net: Net, traffic: _Traffic, seed: int) -> list[tuple[str, str]]:
    """Pairs of edge ids, several times what is needed: some cannot be routed, or are short."""
    edges = [e for e in net.streets if any(lane.permits(traffic.vclass) for lane in e.lanes)]
    most = _flow_count(net, traffic) * 5
    if len(edges) < 2 or not most:
        return []
    rng = make_rng(seed, "demand", traffic.types)
    first = _weights(edges, {e.end for e in edges}, traffic, start=True)
    last = _weights(edges, {e.start for e in edges}, traffic, start=False)
    # At half the length: streets that bow between the same junctions have different middles.
    lines_m = [e.lanes[0].points_m for e in edges]
    arcs_m = [arc_of(points_m) for points_m in lines_m]
    middle_m = np.array(  # (E, 2)
        [
            [np.interp(arc_m[-1] / 2, arc_m, column) for column in points_m.T]
            for points_m, arc_m in zip(lines_m, arcs_m, strict=True)
        ]
    )
    pairs: dict[tuple[str, str], None] = {}
    for _ in range(most * 4):
        a = int(rng.choice(len(edges), p=first))
        far_m = np.hypot(*(middle_m - middle_m[a]).T)
        weight = last * ((far_m >= 0.6 * traffic.shortest_m) & (far_m <= traffic.longest_m))
        if weight.sum() > 0:
            b = int(rng.choice(len(edges), p=weight / weight.sum()))
            pairs[edges[a].id, edges[b].id] = None
        if len(pairs) >= most:
            break
    return list(pairs)


def _flow_count(net: Net, traffic: _Traffic) -> int:
    km = _usable_km(net, traffic.vclass)
    return max(1, round(traffic.flows_per_km * km)) if km > 0 else 0


def _usable_km(net: Net, vclass: str) -> float:
    """Kilometres of street lane that a class may use."""
    lanes = (lane for edge in net.streets for lane in edge.lanes if lane.permits(vclass))
    return sum(lane.length_m for lane in lanes) / 1e3


def _weights(edges: list[Edge], joined: set[str], traffic: _Traffic, *, start: bool) -> F64:
    """Chance (E,) of each edge to be an end.

    It goes by length inside the town, by capacity where the town is cut off.
    """
    weights = np.empty(len(edges))
    for i, edge in enumerate(edges):
        lanes = [lane for lane in edge.lanes if lane.permits(traffic.vclass)]
        cut = (edge.start if start else edge.end) not in joined
        length_m = max(lane.length_m for lane in lanes)
        capacity = 10.0 * len(lanes) * max(lane.speed_mps for lane in lanes)
        if length_m < _SHORTEST_M and not traffic.walks:
            weights[i] = 0.0
        elif cut:
            weights[i] = traffic.fringe * (length_m if traffic.walks else capacity)
        else:
            weights[i] = length_m
    return weights / weights.sum() if weights.sum() > 0 else np.full(len(edges), 1.0 / len(edges))


def _route(
    net_path: Path, folder: Path, drawn: list[tuple[_Traffic, tuple[str, str]]], seed: int
) -> dict[int, list[str]]:
    """Edges of each drawn way that duarouter finds, by its number."""
    trips, types = folder / "demand.trips.xml", folder / "demand.types.xml"
    out = folder / "demand.routes.xml"
    lines = ["<routes>"]
    for number, (traffic, (a, b)) in enumerate(drawn):
        ends = f"from={quoteattr(a)} to={quoteattr(b)}"
        if traffic.walks:
            lines.append(f'<person id="{number}" depart="{number}"><walk {ends}/></person>')
        else:
            lines.append(f'<trip id="{number}" type="{traffic.types}" depart="{number}" {ends}/>')
    trips.write_text("\n".join([*lines, "</routes>"]), encoding="utf-8")
    types.write_text(vtypes_text(), encoding="utf-8")
    options = ["-n", str(net_path.resolve()), "-r", trips.name, "-a", types.name, "-o", out.name]
    options += ["--ignore-errors", "--no-warnings", "--no-step-log", "--xml-validation", "never"]
    run = run_tool("duarouter", [*options, "--seed", str(derive_seed(seed, "duarouter"))], folder)
    if run.returncode:
        raise SumoError(f"no demand could be built: {run.reason()}")
    found: dict[int, list[str]] = {}
    for element in read_root(out):
        child = element.find("walk" if element.tag == "person" else "route")
        if child is not None and child.get("edges"):
            found[int(element.attrib["id"])] = child.attrib["edges"].split()
    for path in (trips, types, out, out.with_suffix(".alt.xml")):
        path.unlink(missing_ok=True)
    return found


def _flows_text(
    net: Net,
    ways: Sequence[Way],
    seed: int,
    scale: float,
    per_hour: Mapping[str, float],
    first: Sequence[str],
) -> str:
    """Vehicle flows stand before person flows, these by their begin, as SUMO reads ahead."""
    lines = ["<routes>", *(f"    {line}" for line in first)]
    for traffic in sorted(MIX, key=lambda traffic: traffic.walks):
        own = [way for way in ways if way.traffic is traffic]
        usual = traffic.per_h_km * _usable_km(net, traffic.vclass)
        per_s = scale * per_hour.get(traffic.vclass, usual) / 3600.0
        if not own or per_s <= 0.0:
            continue
        edges = [quoteattr(" ".join(way.edges)) for way in own]
        kind = f'type="{traffic.types}"'
        if not traffic.walks:
            rate = f'period="exp({per_s / len(own):.6f})" departLane="best" departSpeed="max"'
            for number, names in enumerate(edges):
                head = f'id="{traffic.types}.{number}" {kind} begin="0" end="{END_S}"'
                lines.append(f"    <flow {head} {rate}><route edges={names}/></flow>")
            continue
        # People walk in slices of time, each along some of the ways.
        lines += [f'    <route id="walk.{i}" edges={names}/>' for i, names in enumerate(edges)]
        rng = make_rng(seed, "demand", "slices")
        used = max(1, round(_SLICE_SHARE * len(own)))
        rate = f'period="exp({per_s / used:.6f})"'
        for number, begin in enumerate(range(0, _WALK_END_S, _SLICE_S)):
            span = f'begin="{begin}" end="{begin + _SLICE_S}" {rate}'
            for way in np.sort(rng.choice(len(own), used, replace=False)):
                head = f'id="{traffic.types}.{number}.{way}" {kind} {span}'
                walk = f'<walk route="walk.{way}" arrivalPos="random"/>'
                start = 'departPos="random" departPosLat="random"'
                lines.append(f"    <personFlow {head} {start}>{walk}</personFlow>")
    return "\n".join([*lines, "</routes>", ""])


def _stuck_ways(sumocfg: Path, ways: tuple[Way, ...]) -> tuple[Way, ...]:
    """The walking ways on which people got stuck within a trial of TRIAL_S.

    A trial that fails says nothing about ways: there are none then. The town is opened as it is,
    and `check_town` finds what is wrong.
    """
    options = ["-c", sumocfg.name, "--end", str(TRIAL_S), "--no-step-log"]
    try:
        run = run_tool("sumo", options, sumocfg.parent, Limits(wall_s=300.0))
    except SumoError:
        return ()
    if run.died:  # at a limit, so what it printed depends on the machine's speed
        return ()
    walking = [way for way in ways if way.traffic.walks]
    numbers = sorted({int(text) for text in _JAMMED.findall(run.output)})
    return tuple(walking[number] for number in numbers if number < len(walking))
