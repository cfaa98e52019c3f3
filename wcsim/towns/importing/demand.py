"""Endless traffic for a town: flows of every class that do not run dry, from a seed.

Ways from edge to edge are drawn, routed once by SUMO's `duarouter`, and those that it cannot route are left out; the
flows carry the routes, so that nothing is left to fail while the simulation runs. SUMO makes all people of a personFlow
when it reads it (48 hours of them: 2.4 s and 200 MB), but reads its files only a little ahead of the clock; so the
people come in slices, each along a part of the ways.

A trial run finds walking ways on which people get stuck. Where SUMO's pavements are pinched, people block each other
for minutes, and with them the cars that wait for them.
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
_VTYPES = "vtypes.xml"

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


_DATA = read_module_toml(__file__)
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
    return _choose(net, drawn, _route(net_path, folder, drawn, seed))


def vtypes_text(more: Sequence[str] = ()) -> str:
    """The vehicle and person types that the flows name, as a SUMO additional file, with `more` elements in it."""
    text = (Path(__file__).parent / _VTYPES).read_text(encoding="utf-8")
    return text.replace("</additional>", "".join(f"    {line}\n" for line in more) + "</additional>")


def _usable_km(net: Net, vclass: str) -> float:
    """Kilometres of street lane that a class may use."""
    return sum(lane.length_m for edge in net.streets for lane in edge.lanes if lane.permits(vclass)) / 1e3


def _wanted_flows(net: Net, traffic: _Traffic) -> int:
    km = _usable_km(net, traffic.vclass)
    return max(1, round(traffic.flows_per_km * km)) if km > 0 else 0


def _draw(net: Net, traffic: _Traffic, seed: int) -> list[tuple[str, str]]:
    """Pairs of edge ids, several times more than wanted: some cannot be routed or turn out too short."""
    edges = [e for e in net.streets if any(lane.permits(traffic.vclass) for lane in e.lanes)]
    wanted = _wanted_flows(net, traffic) * 5
    if len(edges) < 2 or not wanted:
        return []
    rng = make_rng(seed, "demand", traffic.types)
    first = _weights(edges, {e.end for e in edges}, traffic, start=True)
    last = _weights(edges, {e.start for e in edges}, traffic, start=False)
    middle_m = np.array([_middle_m(e) for e in edges])  # (E, 2)
    pairs: dict[tuple[str, str], None] = {}
    for _ in range(wanted * 4):
        a = int(rng.choice(len(edges), p=first))
        far_m = np.hypot(*(middle_m - middle_m[a]).T)
        weight = last * ((far_m >= 0.6 * traffic.shortest_m) & (far_m <= traffic.longest_m))
        if weight.sum() > 0:
            b = int(rng.choice(len(edges), p=weight / weight.sum()))
            pairs[edges[a].id, edges[b].id] = None
        if len(pairs) >= wanted:
            break
    return list(pairs)


def _middle_m(edge: Edge) -> F64:
    """The point (2,) at half the length of an edge: streets that bow between the same junctions have different ones."""
    points_m = edge.lanes[0].points_m
    arc_m = arc_of(points_m)
    return np.array([np.interp(arc_m[-1] / 2, arc_m, column) for column in points_m.T])


def _weights(edges: list[Edge], joined: set[str], traffic: _Traffic, *, start: bool) -> F64:
    """Chance (E,) of each edge to be an end: by length inside the town, by capacity where the town is cut off."""
    weights = np.empty(len(edges))
    for i, edge in enumerate(edges):
        lanes = [lane for lane in edge.lanes if lane.permits(traffic.vclass)]
        cut = (edge.start if start else edge.end) not in joined
        length_m = max(lane.length_m for lane in lanes)
        capacity = 10.0 * len(lanes) * max(lane.speed_mps for lane in lanes)
        weights[i] = (
            traffic.fringe * capacity if cut and not traffic.walks else length_m * (traffic.fringe if cut else 1.0)
        )
        if length_m < 12.0 and not traffic.walks:
            weights[i] = 0.0  # too short to put a vehicle on
    return weights / weights.sum() if weights.sum() > 0 else np.full(len(edges), 1.0 / len(edges))


def _route(
    net_path: Path, folder: Path, drawn: list[tuple[_Traffic, tuple[str, str]]], seed: int
) -> dict[int, list[str]]:
    """Edges of each drawn way that duarouter finds, by its number."""
    trips, types, out = folder / "demand.trips.xml", folder / "demand.types.xml", folder / "demand.routes.xml"
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
    options += ["--ignore-errors", "--no-warnings", "--no-step-log", "--seed", str(derive_seed(seed, "duarouter"))]
    run = run_tool("duarouter", [*options, "--xml-validation", "never"], folder)
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


def _choose(net: Net, drawn: list[tuple[_Traffic, tuple[str, str]]], routed: dict[int, list[str]]) -> tuple[Way, ...]:
    length_m = {edge.id: edge.lanes[0].length_m for edge in net.edges if edge.lanes}
    left = {traffic.types: _wanted_flows(net, traffic) for traffic in MIX}
    ways: list[Way] = []
    for number, (traffic, _) in enumerate(drawn):
        edges = routed.get(number, [])
        way_m = sum(length_m[edge] for edge in edges)
        if left[traffic.types] and edges and way_m >= traffic.shortest_m:
            left[traffic.types] -= 1
            ways.append(Way(traffic=traffic, edges=tuple(edges)))
    return tuple(ways)


def _flows_text(
    net: Net, ways: Sequence[Way], seed: int, scale: float, per_hour: Mapping[str, float], first: Sequence[str]
) -> str:
    """Vehicle flows come first, then person flows by their begin, as SUMO's reading ahead needs it."""
    lines = ["<routes>", *(f"    {line}" for line in first)]
    order = sorted(MIX, key=lambda traffic: traffic.walks)
    for traffic in order:
        mine = [way for way in ways if way.traffic is traffic]
        usual = traffic.per_h_km * _usable_km(net, traffic.vclass)
        per_s = scale * per_hour.get(traffic.vclass, usual) / 3600.0
        if not mine or per_s <= 0.0:
            continue
        if traffic.walks:
            lines += _walks(mine, traffic, per_s, make_rng(seed, "demand", "slices"))
            continue
        for number, way in enumerate(mine):
            head = f'id="{traffic.types}.{number}" type="{traffic.types}" begin="0" end="{END_S}"'
            route = f"<route edges={quoteattr(' '.join(way.edges))}/>"
            rate = f'period="exp({per_s / len(mine):.6f})" departLane="best" departSpeed="max"'
            lines.append(f"    <flow {head} {rate}>{route}</flow>")
    return "\n".join([*lines, "</routes>", ""])


def _walks(ways: list[Way], traffic: _Traffic, per_s: float, rng: np.random.Generator) -> list[str]:
    lines = [f'    <route id="walk.{i}" edges={quoteattr(" ".join(way.edges))}/>' for i, way in enumerate(ways)]
    used = max(1, round(_SLICE_SHARE * len(ways)))
    rate = f'period="exp({per_s / used:.6f})"'
    for number, begin in enumerate(range(0, _WALK_END_S, _SLICE_S)):
        for way in np.sort(rng.choice(len(ways), used, replace=False)):
            span = f'begin="{begin}" end="{begin + _SLICE_S}" {rate}'
            head = f'id="{traffic.types}.{number}.{way}" type="{traffic.types}" {span}'
            walk = f'<walk route="walk.{way}" arrivalPos="random"/>'
            lines.append(f'    <personFlow {head} departPos="random" departPosLat="random">{walk}</personFlow>')
    return lines


def write_demand(
    sumocfg: Path,
    net: Net,
    ways: tuple[Way, ...],
    seed: int,
    scale: float = 1.0,
    per_hour: Mapping[str, float] | None = None,
    first: Sequence[str] = (),
) -> None:
    """Write the route file of a town's folder, <stem of its sumocfg>.rou.xml.gz; its types are in `vtypes.xml`.

    It has endless flows along `ways`, without the walking ones on which people get stuck, after the elements `first`.
    A class has as many departures an hour as `per_hour` says, else those of MIX, all times `scale`.
    """
    for trials_left in reversed(range(ROUNDS + 1)):
        text = _flows_text(net, ways, seed, scale, per_hour or {}, first)
        write_gzip(sumocfg.with_suffix(".rou.xml.gz"), text.encode())
        stuck = _stuck_ways(sumocfg, ways) if trials_left and ways else ()
        if not stuck:
            return
        ways = tuple(way for way in ways if way not in stuck)


def _stuck_ways(sumocfg: Path, ways: tuple[Way, ...]) -> tuple[Way, ...]:
    """The walking ways on which people got stuck within a trial of TRIAL_S; none when the trial fails.

    A trial that fails says nothing about ways; the town is then opened as it is, and `check_town` says what is wrong.
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
