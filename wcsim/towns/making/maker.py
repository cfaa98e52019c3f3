"""Make a town without a map: the same seed gives the same bytes, another seed another town.

netgenerate draws the plan of the streets. Links that continue each other are one street, and each
street has a class and its widths. They are written as SUMO's plain nodes and edges, and netconvert
makes a net of them, with pavements and crossings.
"""

import itertools
import logging
import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import networkx
import numpy as np
from shapely.errors import GEOSException

from wcsim.core.files import write_folder_atomically
from wcsim.core.frames import deg2rad
from wcsim.core.reading import read_module_toml
from wcsim.core.seeding import derive_seed, make_rng
from wcsim.errors import SumoError, TownError
from wcsim.towns.ground.plane_geometry import length_of
from wcsim.towns.importing.demand import build_ways, vtypes_text, write_demand
from wcsim.towns.importing.elevation import Dem, Heights, lift_net
from wcsim.towns.importing.folder_texts import (
    check_place,
    check_words,
    town_toml_text,
    write_scenario,
)
from wcsim.towns.importing.map_marks import find_parking, map_marks
from wcsim.towns.making.asked_town import KINDS, Wishes, check_town_properties
from wcsim.towns.making.drawn_map import draw_map
from wcsim.towns.making.plan import StreetPlan, draw_plan, shape_plan
from wcsim.towns.osm.read import Box
from wcsim.towns.scenario.town import (
    TOWN_TOML,
    Town,
    chair_ways,
    hash_files,
    net_middle,
    open_town,
    read_town_file,
)
from wcsim.towns.sumo.net import LaneKind, Net, read_net
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.walking.islands import largest_share, walkable_parts
from wcsim.types import F64

log = logging.getLogger("wcsim.towns")

SOURCE = "made by wcsim: streets by SUMO's netgenerate, no map"
_CLASSES = read_module_toml(__file__)
_LIMITS = Limits(wall_s=120.0, cpu_s=120)
_NETCONVERT = """
--crossings.guess --crossings.guess.speed-threshold 18 --walkingareas --junctions.corner-detail 5
--tls.default-type actuated --no-turnarounds.except-deadend --output.street-names
"""
_NAMES = (
    "Oak",
    "Mill",
    "Station",
    "Church",
    "Harbour",
    "Market",
    "King",
    "Garden",
    "River",
    "Bridge",
    "Hill",
    "Park",
)
_ATTEMPTS = 10  # at streets that hang together
_GOOD_SHARE = 0.97  # of the walkable ground in one part
_LEAST_CROSSINGS = 6
_HILLS_M = (0.0, 0.0, 4.0, 10.0, 18.0, 30.0)
_GRADES = (0.04, 0.12)
_LAND_M = 100.0  # beyond the streets
_LEFTHAND_SHARE = 0.15
_STRAIGHT_RAD = deg2rad(38.0)  # a street goes on where it bends by less
_MAIN_SHARE = (0.12, 0.3)  # of all streets' length
_COLLECTOR_SHARE = 0.3
_TRAM_SHARE = 0.35  # of the towns have trams on their longest street

Stage = Callable[[str], None]
"""Is called with what starts now, in words."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _StreetClass:
    """What a class of streets is like; ranges are drawn from, once for each street."""

    name: str
    priority: int
    speeds_mps: tuple[float, ...]
    lanes: tuple[int, ...]  # in each direction
    lane_m: tuple[float, float]
    pavement_m: tuple[float, float]
    cycle_share: float  # of the streets have cycle lanes
    oneway_share: float
    closed: str  # SUMO classes that may not drive there


MAIN, COLLECTOR, RESIDENTIAL, WALK = (
    _StreetClass(name=name, **kind) for name, kind in _CLASSES.items()
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _NamedStreet:
    """One street with the links that it runs along."""

    number: int
    links: tuple[int, ...]
    kind: _StreetClass
    lanes: int
    lane_m: float
    pavements_m: tuple[float, float]  # right of the links' own direction, and left of it
    cycle_m: float  # width of the cycle lanes, 0 for none
    speed_mps: float
    oneway: bool
    tram: bool = False  # trams run on its lanes

    @property
    def closed(self) -> str:
        """SUMO classes that may not drive there."""
        return self.kind.closed.removeprefix("tram ") if self.tram else self.kind.closed


@dataclass(frozen=True, slots=True, kw_only=True)
class _Signals:
    """How a town's junctions are made."""

    share: float  # of the crossings of larger streets have signals
    crossing_m: float  # width of the crossings
    corner_m: float  # radius of the corners
    lefthand: bool  # traffic keeps to the left


def make_town(
    folder: Path,
    seed: int,
    wishes: Wishes | None = None,
    *,
    name: str = "",
    overwrite: bool = False,
    stage: Stage = lambda text: None,
) -> Town:
    """Generate a town from a seed; it replaces a generated town in the folder that was not edited.

    Args:
        folder: Folder of the town.
        seed: Seed of the whole town, 0 to MOST_SEED.
        wishes: Properties that the seed does not choose.
        name: The town's name; by default that of its folder.
        overwrite: Also replace an imported or edited town.
        stage: Is called with the name of each stage when it starts.

    Raises:
        TownError: Seed, name or wishes cannot be used, or the folder holds something else or an
            edited town.
        SumoError: One of SUMO's tools failed.
    """
    # 1. Check first, so that a mistake costs no time.
    wishes = wishes or Wishes()
    out = folder.resolve()
    name = name or out.name
    check_words(name, wishes.split)
    check_town_properties(seed, wishes)
    check_place(out, overwrite=overwrite)
    toml = out / TOWN_TOML
    if not overwrite and toml.is_file() and "town make" not in read_town_file(toml).rebuild:
        raise TownError(
            f"{out} contains an imported town; "
            "choose another name or --out, or use --replace, which deletes it"
        )
    # 2. Note the command that makes the same town again, run in its folder.
    words = [name, "--seed", str(seed), "--out", ".", "--split", wishes.split]
    words += ["--size", f"{wishes.size_m:g}", *(["--kind", wishes.kind] if wishes.kind else [])]
    words += ["--traffic", f"{wishes.traffic:g}", "--parked", f"{wishes.parked:g}"]
    words += ["--hill", f"{wishes.hill_m:g}"] if wishes.hill_m is not None else []
    with write_folder_atomically(out) as work:
        # 3. Make the net, and what stands in the town.
        stage("drawing the streets")
        net = _bare_net(name, seed, wishes, work)
        stage("adding buildings, furniture, parked cars and routes")
        poly, ground, left = draw_map(net, name, work, make_rng(seed, "making", "map"))
        marks = map_marks(net, poly, ground)
        lots, cars = find_parking(net, poly, wishes.parked, seed)
        ground.unlink()
        net_path = work / f"{name}.net.xml"
        ways = build_ways(net, net_path, work, seed) if wishes.traffic > 0.0 else ()
        # 4. Write the scenario and its traffic.
        write_scenario(work, name, seed, vtypes_text((*lots, *marks.elements, *left)))
        stage("testing the traffic")
        write_demand(work / f"{name}.sumocfg", net, ways, seed, wishes.traffic, first=cars)
        text = town_toml_text(
            name=name,
            split=wishes.split,
            origin_m=net_middle(work / f"{name}.net.xml.gz"),
            source=SOURCE,
            rebuild=shlex.join(["wcsim", "town", "make", *words]),
            hashes=hash_files(work, name),
        )
        (work / TOWN_TOML).write_text(text, encoding="utf-8")
    return open_town(folder if (folder / f"{name}.sumocfg").is_file() else out)


def _bare_net(name: str, seed: int, wishes: Wishes, work: Path) -> Net:
    """<name>.net.xml of streets that hang together, on its land. Raises TownError."""
    # 1. Draw streets until all hang together.
    kind = wishes.kind or str(make_rng(seed, "making", "kind").choice(KINDS))
    for attempt in range(_ATTEMPTS):
        rng = make_rng(seed, "making", "streets", attempt)
        try:
            drawn = draw_plan(kind, wishes.size_m, derive_seed(seed, "making", attempt), rng, work)
            plan = shape_plan(drawn, rng)
            streets = _make_streets(plan, rng)
            share, crossing_m, corner_m = rng.uniform((0.2, 2.8, 2.5), (0.9, 5.0, 6.0)).tolist()
            signals = _Signals(
                share=share,
                crossing_m=crossing_m,
                corner_m=corner_m,
                lefthand=bool(rng.random() < _LEFTHAND_SHARE),
            )
            path = _write_net(name, plan, streets, signals, work, rng)
            net = read_net(path)
            largest = largest_share(walkable_parts(net, chair_ways(cycle_paths=False)))
        except (SumoError, TownError, GEOSException) as error:
            # GEOS fails at the outlines of some junctions.
            log.info("town %s, attempt %d: %s", name, attempt, error)
            continue
        if largest >= _GOOD_SHARE and len(net.lanes(LaneKind.CROSSING)) >= _LEAST_CROSSINGS:
            break
    else:
        raise TownError(
            f"town {name}: no connected {kind} streets of {wishes.size_m:g} m were found "
            f"in {_ATTEMPTS} attempts; use another seed, or a larger size"
        )
    # 2. Put them on land that is level or a few broad bumps.
    rng = make_rng(seed, "making", "land")
    hill_m, grade = float(rng.choice(_HILLS_M)), rng.uniform(*_GRADES)
    hill_m = hill_m if wishes.hill_m is None else wishes.hill_m
    if hill_m > 0.0:
        (west, south), (east, north) = (corner_m.tolist() for corner_m in net.corners_m())
        box_m = Box(west - _LAND_M, south - _LAND_M, east + _LAND_M, north + _LAND_M)
        land = Dem.hill(hill_m, box_m, seed)
        lift_net(path, land, Heights(hill_m=hill_m, max_grade=grade), on_globe=False)
    return read_net(path)


def _make_streets(plan: StreetPlan, rng: np.random.Generator) -> tuple[_NamedStreet, ...]:
    """All streets of a plan with their classes: the longest ones are main streets.

    A street is one-way, or for walkers alone, only where every place can still be reached.
    """
    # 1. Rank them by their lengths, and a little by chance.
    chains = _chains(plan)
    lengths_m = np.array([sum(length_of(plan.lines_m[link]) for link in chain) for chain in chains])
    order = np.argsort(-lengths_m * rng.uniform(0.8, 1.25, len(chains)))
    rank = np.cumsum(lengths_m[order]) / lengths_m.sum()
    main, walks = rng.uniform(*_MAIN_SHARE), float(rng.choice([0.0, 0.1, 0.2]))
    widths = rng.uniform(-1.0, 1.0)  # a town of wide pavements, or of narrow ones
    found: list[_NamedStreet] = []
    for number, (row, so_far) in enumerate(zip(order.tolist(), rank.tolist(), strict=True)):
        kind = RESIDENTIAL
        if not number or so_far <= main:
            kind = MAIN
        elif so_far <= main + _COLLECTOR_SHARE:
            kind = COLLECTOR
        found.append(_drawn(number, chains[row], kind, float(widths), rng))
    found[0] = replace(found[0], tram=bool(rng.random() < _TRAM_SHARE))
    # 2. Make some of them one-way, or close them to vehicles.
    for number, drawn in enumerate(rng.random((len(found), 2)).tolist()):
        street = found[number]
        if drawn[0] < street.kind.oneway_share:
            found[number] = _if_reachable(plan, found, replace(street, oneway=True))
        elif street.kind is RESIDENTIAL and drawn[1] < walks and len(street.links) <= 3:
            walk = _drawn(number, street.links, WALK, float(widths), rng)
            found[number] = _if_reachable(plan, found, walk)
    return tuple(found)


def _drawn(
    number: int, links: tuple[int, ...], kind: _StreetClass, widths: float, rng: np.random.Generator
) -> _NamedStreet:
    low_m, high_m = kind.pavement_m
    drawn = np.clip(0.35 * widths + rng.uniform(0.0, 1.0, 2), 0.0, 1.0)
    pavements_m = low_m + (high_m - low_m) * drawn
    cycles, lane_m = rng.random() < kind.cycle_share, rng.uniform(*kind.lane_m)
    return _NamedStreet(
        number=number,
        links=links,
        kind=kind,
        lanes=int(rng.choice(kind.lanes)),
        lane_m=round(lane_m, 2),
        pavements_m=(round(float(pavements_m[0]), 2), round(float(pavements_m[1]), 2)),
        cycle_m=round(rng.uniform(1.25, 2.0), 2) if cycles else 0.0,
        speed_mps=float(rng.choice(kind.speeds_mps)),
        oneway=kind is WALK,
    )


def _if_reachable(
    plan: StreetPlan, streets: list[_NamedStreet], changed: _NamedStreet
) -> _NamedStreet:
    """The changed street, or the one before where a place would be cut off by the change."""
    graph = networkx.DiGraph()
    for street in (*streets[: changed.number], changed, *streets[changed.number + 1 :]):
        if street.kind is not WALK:
            ends = [plan.links[link] for link in street.links]
            graph.add_edges_from(ends)
            graph.add_edges_from((b, a) for a, b in ends if not street.oneway)
    touched = {node for link in changed.links for node in plan.links[link]}
    whole = networkx.is_strongly_connected(graph) and touched <= set(graph)
    return changed if whole else streets[changed.number]


def _chains(plan: StreetPlan) -> list[tuple[int, ...]]:
    """Links grouped to streets: at each junction the straightest pairs go on, best first."""
    same = networkx.Graph()
    same.add_nodes_from(range(len(plan.lines_m)))
    for _, arms in sorted(plan.arms(plan.lines_m).items()):
        pairs = []
        for (first, first_rad), (second, second_rad) in itertools.combinations(arms, 2):
            angle_rad = abs((first_rad - second_rad + np.pi) % (2.0 * np.pi) - np.pi)
            pairs.append((abs(angle_rad - np.pi), first, second))
        used: set[int] = set()
        for bend_rad, first, second in sorted(pairs):
            if bend_rad < _STRAIGHT_RAD and not {first, second} & used:
                used |= {first, second}
                same.add_edge(first, second)
    return sorted(tuple(sorted(part)) for part in networkx.connected_components(same))


def _write_net(
    name: str,
    plan: StreetPlan,
    streets: tuple[_NamedStreet, ...],
    signals: _Signals,
    folder: Path,
    rng: np.random.Generator,
) -> Path:
    """Make <name>.net.xml in `folder`. Raises SumoError when netconvert fails."""
    nodes, edges = folder / "made.nod.xml", folder / "made.edg.xml"
    meeting: dict[int, list[_NamedStreet]] = {}
    for street in streets:
        for link in street.links:
            for node in plan.links[link]:
                meeting.setdefault(node, []).append(street)
    lines = ["<nodes>"]
    for number, (x_m, y_m) in enumerate(plan.nodes_m.tolist()):
        driven = [street for street in meeting[number] if street.kind is not WALK]
        kind = _junction_kind(driven, signals.share, rng.random())
        lines.append(f'    <node id="j{number}" x="{x_m:.2f}" y="{y_m:.2f}" type="{kind}"/>')
    nodes.write_text("\n".join([*lines, "</nodes>", ""]), encoding="utf-8")
    edges.write_text(_edges_xml(plan, streets), encoding="utf-8")
    options = ["-n", nodes.name, "-e", edges.name, *_NETCONVERT.split(), "-o", f"{name}.net.xml"]
    options += ["--default.crossing-width", f"{signals.crossing_m:.2f}"]
    options += ["--default.junctions.radius", f"{signals.corner_m:.2f}"]
    options += ["--lefthand"] * signals.lefthand
    run = run_tool("netconvert", options, folder, _LIMITS)
    for path in (nodes, edges):
        path.unlink()
    if run.returncode:
        raise SumoError(f"no net could be built: {run.reason()}; use another seed or size")
    return folder / f"{name}.net.xml"


def _junction_kind(driven: list[_NamedStreet], share: float, drawn: float) -> str:
    """Signals where larger streets meet; else priority, or right before left at small streets.

    `driven` are the streets for vehicles that meet there; one that goes on is there twice.
    """
    larger = {street.number for street in driven if street.kind is not RESIDENTIAL}
    main = any(street.kind is MAIN for street in driven)
    if len(driven) < 3:
        return "priority"
    if (len(larger) > 1 and drawn < share) or (main and drawn < 0.4 * share):
        return "traffic_light"
    return "right_before_left" if not larger and drawn < 0.7 else "priority"


def _edges_xml(plan: StreetPlan, streets: tuple[_NamedStreet, ...]) -> str:
    lines = ["<edges>"]
    for street in streets:
        right_m, left_m = street.pavements_m
        for link in street.links:
            a, b = plan.links[link]
            line_m = plan.lines_m[link]
            lines.append(_edge(str(link), (a, b), line_m, street, right_m))
            if street.kind is WALK:
                continue
            if not street.oneway:
                lines.append(_edge(f"-{link}", (b, a), line_m[::-1], street, left_m))
            elif left_m > 0.0:
                # The pavement on the left side of a one-way street is an edge of its own.
                head = _edge_head(f"-{link}", (b, a), street, "footway", 1)
                rules = f'numLanes="1" speed="2.78" width="{left_m}" allow="pedestrian"'
                lines.append(f'{head} {rules} spreadType="right"{_shape(line_m[::-1])}/>')
    return "\n".join([*lines, "</edges>", ""])


def _edge(
    edge: str, ends: tuple[int, int], line_m: F64, street: _NamedStreet, pavement_m: float
) -> str:
    kind = street.kind
    head = _edge_head(edge, ends, street, kind.name, kind.priority)
    head += f' numLanes="{street.lanes}" speed="{street.speed_mps}" width="{street.lane_m}"'
    if kind is WALK:
        return f'{head} spreadType="center" allow="pedestrian bicycle"{_shape(line_m)}/>'
    rules = f'disallow="{street.closed}" sidewalkWidth="{pavement_m}"'
    rules += f' bikeLaneWidth="{street.cycle_m}"' if street.cycle_m else ""
    return f'{head} spreadType="right" {rules}{_shape(line_m)}/>'


def _edge_head(
    edge: str, ends: tuple[int, int], street: _NamedStreet, kind: str, priority: int
) -> str:
    name = f"{_NAMES[street.number % len(_NAMES)]} Street {street.number // len(_NAMES) + 1}"
    head = f'    <edge id="{edge}" from="j{ends[0]}" to="j{ends[1]}" name="{name}"'
    return f'{head} type="{kind}" priority="{priority}"'


def _shape(line_m: F64) -> str:
    if len(line_m) < 3:
        return ""
    return ' shape="' + " ".join(f"{x:.2f},{y:.2f}" for x, y in line_m.tolist()) + '"'
