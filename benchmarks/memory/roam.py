"""Memory of a world whose wheelchairs roam a whole town: after every so many ticks, what the process holds.

A chair follows its user for a while and is then put on the next of the town's pavements, so that all of the town is
seen long before a chair could have driven through it.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np
import psutil  # type: ignore[import-untyped]

from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.core import seeding
from wcsim.towns.ground.tiles import TileStore
from wcsim.types import F64, TileKey, WayKind

STAY_TICKS = 150  # between two jumps of a chair
_LEAST_ROWS = 3  # at the start, in the middle, at the end


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryRow:
    """What was held after so many ticks."""

    tick: int
    rss_mb: float
    rasters_mb: float  # of that, the ground's rasters around the chairs, which come and go
    python_objects: int  # those that the collector watches
    tiles: int  # of the street, in the engine
    tiles_seen: int  # ... and all that ever were there
    bodies: int  # of actors, made so far
    actors: int  # in the whole town


class RoamingWorld(World):
    """A world that says what it holds."""

    def __enter__(self) -> RoamingWorld:
        return self

    @property
    def tiles(self) -> tuple[TileKey, ...]:
        """The tiles of the street that the engine has now."""
        return tuple(self._open.street.keys)

    @property
    def bodies(self) -> int:
        """Bodies of vehicles and people made so far; they are used again, and never go."""
        return self._open.bodies.made


def roam(
    world: RoamingWorld, ticks: int, every: int, seed: int, say: Callable[[MemoryRow], object]
) -> tuple[MemoryRow, ...]:
    """Run a world for `ticks` ticks; one row at its start, one after every `every` of them.

    Args:
        world: A world with at least one chair.
        ticks: How many.
        every: Ticks from one row to the next, at least 1.
        seed: Of the order in which the pavements are visited.
        say: Hears of each row.
    """
    places = _places(world, seed)
    seen = set(world.tiles)
    rows = []
    for tick in range(ticks + 1):
        if tick % every == 0:
            rows.append(_row(world, tick, len(seen)))
            say(rows[-1])
        if tick < ticks:
            next(rollout(world))
            _jump(world, tick, places)
            seen |= set(world.tiles)
    return tuple(rows)


def growth_mb(rows: Sequence[MemoryRow]) -> float | None:
    """By how much memory without the rasters grew in the second half of a run; None where no row is in its middle.

    >>> from dataclasses import replace
    >>> row = MemoryRow(
    ...     tick=0, rss_mb=300.0, rasters_mb=9.0, python_objects=0, tiles=0, tiles_seen=0, bodies=0, actors=0
    ... )
    >>> growth_mb((row, replace(row, tick=100, rss_mb=350.0), replace(row, tick=200, rss_mb=350.5)))
    0.5
    >>> growth_mb((row, replace(row, tick=100, rss_mb=350.0))) is None
    True
    """
    if len(rows) < _LEAST_ROWS:
        return None
    half = min(rows, key=lambda row: abs(row.tick - 0.5 * rows[-1].tick))
    return (rows[-1].rss_mb - rows[-1].rasters_mb) - (half.rss_mb - half.rasters_mb)


def _places(world: RoamingWorld, seed: int) -> Iterator[tuple[F64, float]]:
    """The middle (2,) of every pavement and the way it runs there, in a drawn order, again and again."""
    ways = [edge.points_W_m for edge in world.street.walk.edges if edge.kind is WayKind.SIDEWALK]
    order = seeding.generator(seed, "memory").permutation(len(ways)).tolist()
    return cycle([_middle(ways[number]) for number in order])


def _middle(way: F64) -> tuple[F64, float]:
    k = (len(way) - 1) // 2
    here, ahead = way[k], way[k + 1]
    return 0.5 * (here + ahead), float(np.arctan2(*(ahead - here)[::-1]))


def _jump(world: RoamingWorld, tick: int, places: Iterator[tuple[F64, float]]) -> None:
    """Put on another place whose turn it is; the chairs do not jump at the same time."""
    for seat in world.seats:
        if (tick + seat.index * STAY_TICKS // len(world.seats)) % STAY_TICKS == STAY_TICKS - 1:
            world.put_chair(seat.index, *next(places))


def _row(world: RoamingWorld, tick: int, seen: int) -> MemoryRow:
    gc.collect()
    grid = world.street.grid
    return MemoryRow(
        tick=tick,
        rss_mb=psutil.Process().memory_info().rss / 1e6,
        rasters_mb=grid.held_bytes / 1e6 if isinstance(grid, TileStore) else 0.0,
        python_objects=len(gc.get_objects()),
        tiles=len(world.tiles),
        tiles_seen=seen,
        bodies=world.bodies,
        actors=sum(world.sumo.counts()),
    )
