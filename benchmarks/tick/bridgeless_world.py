"""What the bridge costs: one world beside a twin in which the bridge is left out, ten ticks each in turns.

The twin's SUMO and engine do the same work on the same town with the same seed; nobody reacts and nothing is mirrored
in it.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil  # type: ignore[import-untyped]

from wcsim.bridge.stage_timer import Stopwatch
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig
from wcsim.towns.scenario.town import open_town
from wcsim.types import Command, SeatSpec

_SETTLE_TICKS = 50
BLOCK_TICKS = 10
STAGES = ("react", "sumo", "read", "mirror", "physics", "user", "render", "truth", "street")


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeCost:
    """Milliseconds of processor time a tick: medians over blocks of ten ticks, for not every tick asks for the same."""

    react_ms: float
    read_ms: float
    mirror_ms: float
    engines_ms: float  # SUMO's step and the physics steps of the twin
    actors: float  # vehicles and people in the town
    mirrored: float  # of these, near the wheelchair

    @property
    def overhead(self) -> float:
        """The bridge's share of the bare engines."""
        return self.bridge_ms / self.engines_ms

    @property
    def bridge_ms(self) -> float:
        """Milliseconds of the bridge itself."""
        return self.react_ms + self.read_ms + self.mirror_ms


class Twin(World):
    """A world without a bridge, whose engines are timed alone."""

    engines_s = 0.0

    def _react(self, commands: Sequence[Command]) -> None:
        """Nobody reacts to a chair."""

    def _step(self) -> None:
        start_s = time.thread_time()
        self.sumo.step()
        self.engines_s = time.thread_time() - start_s

    def _mirror(self) -> None:
        """Nothing is mirrored; only the street is there."""
        self._load_tiles(self._places())

    def _check_mirror(self) -> None:
        """There is none."""

    def _drive(self, commands: Sequence[Command]) -> None:
        for seat, command in zip(self.seats, commands, strict=True):
            seat.command(command.joystick)
        for _ in range(self.config.world.usual_substeps):
            for seat in self.seats:
                seat.chair.before_step()
            start_s = time.thread_time()
            self._open.engine.step()
            self.engines_s += time.thread_time() - start_s
            for seat in self.seats:
                seat.chair.after_step()


class StopwatchedWorld:
    """A world that follows its users and times its stages; see `STAGES` and `turns.Runner`."""

    def __init__(self, sumocfg: Path, config: RunConfig, specs: tuple[SeatSpec, ...], seed: int) -> None:
        self.world = World(open_town(sumocfg), config, specs, seed)
        self.world.stopwatch = Stopwatch(time.thread_time)
        settle(self.world)

    def tick(self) -> tuple[float, ...]:
        """Seconds of the tick: wall, processor (all threads), each stage; then actors in town, mirrored, memory."""
        self.world.stopwatch.take()
        wall_s, cpu_s, own_s = time.perf_counter(), time.process_time(), time.thread_time()
        next(rollout(self.world))
        wall_s, cpu_s, own_s = time.perf_counter() - wall_s, time.process_time() - cpu_s, time.thread_time() - own_s
        spent = dict(self.world.stopwatch.take())
        # the stopwatch knows this thread alone; all others of the process draw, and do nothing else
        spent["render"] = spent.get("render", 0.0) + max(0.0, cpu_s - own_s)
        stages = (spent.get(name, 0.0) for name in STAGES)
        memory, everyone = float(psutil.Process().memory_info().rss), float(sum(self.world.sumo.counts()))
        return (wall_s, cpu_s, *stages, everyone, float(len(self.world.snapshot.actors)), memory)

    def close(self) -> None:
        """End the world."""
        self.world.close()


class TimedTwin:
    """The twin; a tick gives the processor seconds of its bare engines. See `turns.Runner`."""

    def __init__(self, sumocfg: Path, config: RunConfig, specs: tuple[SeatSpec, ...], seed: int) -> None:
        self.world = Twin(open_town(sumocfg), config, specs, seed)
        settle(self.world)

    def tick(self) -> tuple[float, ...]:
        """The processor seconds of SUMO's step and the physics steps."""
        next(rollout(self.world))
        return (self.world.engines_s,)

    def close(self) -> None:
        """End the world."""
        self.world.close()


def bridge_cost(ours: list[tuple[float, ...]], bare: list[tuple[float, ...]]) -> BridgeCost:
    """The cost of the bridge from the ticks of a `StopwatchedWorld` and a `TimedTwin`."""
    _, _, *middle, actors, mirrored, _ = typical(ours)
    spent = dict(zip(STAGES, middle, strict=True))
    (engines,) = typical(bare)
    return BridgeCost(
        react_ms=1e3 * spent["react"],
        read_ms=1e3 * spent["read"],
        mirror_ms=1e3 * spent["mirror"],
        engines_ms=1e3 * engines,
        actors=actors,
        mirrored=mirrored,
    )


def typical(rows: list[tuple[float, ...]]) -> list[float]:
    """The median of each column over the means of blocks of ticks (of the ticks themselves, when they are few)."""
    block = BLOCK_TICKS if len(rows) >= 2 * BLOCK_TICKS else 1
    whole = np.array(rows[: len(rows) // block * block])
    values: list[float] = np.median(whole.reshape(-1, block, whole.shape[1]).mean(axis=1), axis=0).tolist()
    return values


def settle(world: World) -> None:
    """Let a world follow its users for a while; what it holds then is never looked through again, as in a server."""
    for _ in range(_SETTLE_TICKS):
        next(rollout(world))
    gc.collect()
    gc.freeze()
