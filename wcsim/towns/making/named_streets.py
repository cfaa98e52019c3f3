"""Which street is what: links that continue each other are one street, and each street has a class and its widths."""

from __future__ import annotations

from dataclasses import dataclass, replace

import networkx
import numpy as np

from wcsim.core.frames import rad
from wcsim.towns.making.shaping import ShapedPlan
from wcsim.types import F64

_STRAIGHT_RAD = rad(38.0)  # a street goes on where it bends by less
_MAIN_SHARE = (0.12, 0.3)  # of all streets' length
_COLLECTOR_SHARE = 0.3
_TRAM_SHARE = 0.35  # of the towns have trams on their longest street


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetClass:
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


_RAIL = (
    "tram rail_urban rail rail_electric rail_fast ship container cable_car subway aircraft wheelchair drone pedestrian"
)
MAIN = StreetClass(
    name="main", priority=12, speeds_mps=(13.89,), lanes=(1, 2, 2), lane_m=(3.0, 3.6), pavement_m=(2.4, 5.0),
    cycle_share=0.6, oneway_share=0.0, closed=f"{_RAIL} scooter",
)  # fmt: skip
COLLECTOR = StreetClass(
    name="collector", priority=9, speeds_mps=(8.33, 13.89), lanes=(1,), lane_m=(2.9, 3.5), pavement_m=(1.8, 3.8),
    cycle_share=0.3, oneway_share=0.1, closed=_RAIL,
)  # fmt: skip
RESIDENTIAL = StreetClass(
    name="residential", priority=3, speeds_mps=(5.56, 8.33, 8.33), lanes=(1,), lane_m=(2.75, 3.3),
    pavement_m=(1.5, 2.8), cycle_share=0.0, oneway_share=0.25, closed=_RAIL,
)  # fmt: skip
WALK = StreetClass(
    name="walk", priority=1, speeds_mps=(5.56,), lanes=(1,), lane_m=(3.0, 6.0), pavement_m=(0.0, 0.0),
    cycle_share=0.0, oneway_share=1.0, closed="",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedStreet:
    """One street with the links that it runs along."""

    number: int
    links: tuple[int, ...]
    kind: StreetClass
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


def streets_of(shaped: ShapedPlan, rng: np.random.Generator) -> tuple[NamedStreet, ...]:
    """All streets of a plan with their classes: the longest ones are main streets.

    A street is one-way, or for walkers alone, only where everybody still gets everywhere.
    """
    chains = _chains(shaped)
    lengths_m = np.array([sum(_length_m(shaped.lines_m[link]) for link in chain) for chain in chains])
    order = np.argsort(-lengths_m * rng.uniform(0.8, 1.25, len(chains)))
    rank = np.cumsum(lengths_m[order]) / lengths_m.sum()
    main, walks = float(rng.uniform(*_MAIN_SHARE)), float(rng.choice([0.0, 0.1, 0.2]))
    widths = rng.uniform(-1.0, 1.0)  # a town of wide pavements, or of narrow ones
    found: list[NamedStreet] = []
    for number, (row, so_far) in enumerate(zip(order.tolist(), rank.tolist(), strict=True)):
        kind = MAIN if not number or so_far <= main else COLLECTOR if so_far <= main + _COLLECTOR_SHARE else RESIDENTIAL
        found.append(_drawn(number, chains[row], kind, float(widths), rng))
    found[0] = replace(found[0], tram=bool(rng.random() < _TRAM_SHARE))
    for number, drawn in enumerate(rng.random((len(found), 2)).tolist()):
        street = found[number]
        if drawn[0] < street.kind.oneway_share:
            found[number] = _if_reachable(shaped, found, replace(street, oneway=True))
        elif street.kind is RESIDENTIAL and drawn[1] < walks and len(street.links) <= 3:
            walk = _drawn(number, street.links, WALK, float(widths), rng)
            found[number] = _if_reachable(shaped, found, walk)
    return tuple(found)


def _drawn(
    number: int, links: tuple[int, ...], kind: StreetClass, widths: float, rng: np.random.Generator
) -> NamedStreet:
    low_m, high_m = kind.pavement_m
    drawn = np.clip(0.35 * widths + rng.uniform(0.0, 1.0, 2), 0.0, 1.0)
    pavements_m = low_m + (high_m - low_m) * drawn
    cycles, lane_m = rng.random() < kind.cycle_share, float(rng.uniform(*kind.lane_m))
    return NamedStreet(
        number=number,
        links=links,
        kind=kind,
        lanes=int(rng.choice(kind.lanes)),
        lane_m=round(lane_m, 2),
        pavements_m=(round(float(pavements_m[0]), 2), round(float(pavements_m[1]), 2)),
        cycle_m=round(float(rng.uniform(1.25, 2.0)), 2) if cycles else 0.0,
        speed_mps=float(rng.choice(kind.speeds_mps)),
        oneway=kind is WALK,
    )


def _if_reachable(shaped: ShapedPlan, streets: list[NamedStreet], changed: NamedStreet) -> NamedStreet:
    """The changed street, or the one that it was when somebody could not get somewhere then."""
    graph = networkx.DiGraph()
    for street in (*streets[: changed.number], changed, *streets[changed.number + 1 :]):
        if street.kind is not WALK:
            ends = [shaped.plan.links[link] for link in street.links]
            graph.add_edges_from(ends)
            graph.add_edges_from((b, a) for a, b in ends if not street.oneway)
    touched = {node for link in changed.links for node in shaped.plan.links[link]}
    whole = networkx.is_strongly_connected(graph) and touched <= set(graph)
    return changed if whole else streets[changed.number]


def _chains(shaped: ShapedPlan) -> list[tuple[int, ...]]:
    """Links grouped to streets: at each junction the straightest pairs go on, best first."""
    same = networkx.Graph()
    same.add_nodes_from(range(len(shaped.lines_m)))
    arms: dict[int, list[tuple[int, float]]] = {}
    for number, ((a, b), line) in enumerate(zip(shaped.plan.links, shaped.lines_m, strict=True)):
        for node, way in ((a, line[1] - line[0]), (b, line[-2] - line[-1])):
            arms.setdefault(node, []).append((number, float(np.arctan2(way[1], way[0]))))
    for node in sorted(arms):
        pairs = sorted(
            (_bend_rad(one[1], other[1]), one[0], other[0])
            for place, one in enumerate(arms[node])
            for other in arms[node][place + 1 :]
        )
        used: set[int] = set()
        for bend_rad, first, second in pairs:
            if bend_rad < _STRAIGHT_RAD and not {first, second} & used:
                used |= {first, second}
                same.add_edge(first, second)
    return sorted(tuple(sorted(part)) for part in networkx.connected_components(same))


def _bend_rad(one_rad: float, other_rad: float) -> float:
    """How far from straight on a way between two arms is."""
    return abs(abs((one_rad - other_rad + np.pi) % (2.0 * np.pi) - np.pi) - np.pi)


def _length_m(line: F64) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())
