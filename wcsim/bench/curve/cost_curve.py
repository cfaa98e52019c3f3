"""The cost of a tick over the number of wheelchairs, the number of actors and the size of the town.

Along each axis the worlds take turns, so that all of them meet the same load.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from wcsim.bench.curve.grid_town import BLOCK_M, make_grid_town
from wcsim.bench.interleave import Contestant, in_turns
from wcsim.bench.tick.bridgeless_world import BLOCK_TICKS, STAGES, StopwatchedWorld, typical
from wcsim.config import RunConfig
from wcsim.towns.scenario.town import find_town
from wcsim.types import SeatSpec

STEEP = 1.15  # an exponent above this is more than noise
_WORTH_MS = 0.1  # and a stage below this is not worth a word
_BRIDGE = ("react", "read", "mirror")


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePoint:
    """One world."""

    at: float  # wheelchairs, actors, or kilometres along a side
    cpu_ms: float  # of the processor, a tick
    actors: float  # in the town
    stages_ms: Mapping[str, float]  # by name: the three of the bridge as one, and "rest"


@dataclass(frozen=True, slots=True, kw_only=True)
class CostCurve:
    """One axis; `steep` are the stages that grow faster than linearly between the last two points, and how fast."""

    axis: str
    points: tuple[CurvePoint, ...]
    steep: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Grids:
    """What the generated towns hold where their number is not the axis."""

    folder: Path
    actors: int = 200
    side_km: float = 2.0


def over_chairs(
    town: Path, config: RunConfig, chairs: Sequence[int], ticks: int, seed: int, done: Callable[[int], object]
) -> CostCurve:
    """The same town with more and more wheelchairs. Raises SumoError when a world dies."""
    worlds = [(town, config, (SeatSpec(),) * count, seed) for count in chairs]
    return _curve("wheelchairs", [float(count) for count in chairs], worlds, ticks, done)


def over_actors(
    grids: Grids, config: RunConfig, actors: Sequence[int], ticks: int, seed: int, done: Callable[[int], object]
) -> CostCurve:
    """One wheelchair in a generated town with more and more vehicles and people, one half each."""
    towns = [_town(grids, f"actors-{count}", count, grids.side_km) for count in actors]
    worlds = [(town, config, (SeatSpec(),), seed) for town in towns]
    return _curve("actors", [float(count) for count in actors], worlds, ticks, done)


def over_size(
    grids: Grids, config: RunConfig, sides_km: Sequence[float], ticks: int, seed: int, done: Callable[[int], object]
) -> CostCurve:
    """One wheelchair and as many actors in larger and larger towns."""
    towns = [_town(grids, f"side-{side_km:g}", grids.actors, side_km) for side_km in sides_km]
    worlds = [(town, config, (SeatSpec(),), seed) for town in towns]
    return _curve("kilometres", list(sides_km), worlds, ticks, done)


def _town(grids: Grids, name: str, actors: int, side_km: float) -> Path:
    blocks = max(2, round(1000.0 * side_km / BLOCK_M))
    folder = make_grid_town(grids.folder / name, blocks, vehicles=actors // 2, people=actors - actors // 2)
    return find_town(str(folder)).sumocfg


def _curve(
    axis: str,
    places: list[float],
    worlds: Sequence[tuple[object, ...]],
    ticks: int,
    done: Callable[[int], object],
) -> CostCurve:
    takers = [Contestant(make=StopwatchedWorld, given=given, ticks=BLOCK_TICKS) for given in worlds]
    rows = in_turns(takers, -(-ticks // BLOCK_TICKS), lambda turn: done(min(ticks, turn * BLOCK_TICKS)))
    points = tuple(point_of(at, found) for at, found in zip(places, rows, strict=True))
    return CostCurve(axis=axis, points=points, steep=steep(points))


def point_of(at: float, rows: list[tuple[float, ...]]) -> CurvePoint:
    """One point from the ticks of a `StopwatchedWorld`."""
    _, cpu_s, *middle, actors, _, _ = typical(rows)
    spent_ms = {name: 1e3 * spent_s for name, spent_s in zip(STAGES, middle, strict=True)}
    stages_ms = {name: ms for name, ms in spent_ms.items() if name not in _BRIDGE}
    stages_ms["bridge"] = sum(spent_ms[name] for name in _BRIDGE)
    stages_ms["rest"] = max(0.0, 1e3 * cpu_s - sum(stages_ms.values()))
    return CurvePoint(at=at, cpu_ms=1e3 * cpu_s, actors=actors, stages_ms=stages_ms)


def steep(points: Sequence[CurvePoint]) -> tuple[tuple[str, float], ...]:
    """Stages whose cost grows by more than the axis does between the last two points, with the exponent."""
    if len(points) < 2:
        return ()
    before, last = points[-2], points[-1]
    ratio = math.log(last.at / before.at)
    found = []
    for name, ms in sorted(last.stages_ms.items()):
        if ms > _WORTH_MS and before.stages_ms[name] > 0.0:
            exponent = math.log(ms / before.stages_ms[name]) / ratio
            if exponent > STEEP:
                found.append((name, exponent))
    return tuple(found)
