"""What the bridge costs: one world beside a twin in which the bridge is left out, tick by tick in turns.

Each world lives in a process of its own (libsumo holds one a process); they take turns, so that both are timed under
the same load. The twin's SUMO and engine do the same work on the same town with the same seed; nobody reacts and
nothing is mirrored in it.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from wcsim.bridge.stopwatch import Stopwatch
from wcsim.bridge.world import World, as_users_wish
from wcsim.config import RunConfig
from wcsim.errors import SumoError
from wcsim.towns.town import Town, open_town
from wcsim.types import Command, SeatSpec

SETTLE_TICKS = 50
BLOCK_TICKS = 10
ANSWER_S = 120.0
STAGES = ("react", "read", "mirror")


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
        return (self.react_ms + self.read_ms + self.mirror_ms) / self.engines_ms


class _Twin(World):
    """A world without a bridge, whose engines are timed alone."""

    engines_s = 0.0

    def _react(self, commands: Sequence[Command]) -> None:
        self._check(commands)

    def _step(self) -> None:
        start_s = time.thread_time()
        self._sumo.step()
        self.engines_s = time.thread_time() - start_s

    def _mirror(self) -> None:
        """Nothing is mirrored."""

    def _drive(self, commands: Sequence[Command]) -> None:
        self._reach_street()
        for seat, command in zip(self.seats, commands, strict=True):
            seat.chair.command(command.joystick)
        for _ in range(self.config.world.substeps):
            for seat in self.seats:
                seat.chair.before_step()
            start_s = time.thread_time()
            self._open_engine.step()
            self.engines_s += time.thread_time() - start_s
            for seat in self.seats:
                seat.after_substep(self.config.world.tick_s / self.config.world.substeps)


def measure_bridge(
    town: Town, config: RunConfig, ticks: int, seed: int, progress: Callable[[int], object]
) -> BridgeCost:
    """Run both worlds for `ticks` ticks, in turns. Raises SumoError when one of them dies."""
    context = multiprocessing.get_context("spawn")
    rows: tuple[list[tuple[float, ...]], list[tuple[float, ...]]] = ([], [])
    with ExitStack() as held:
        ends = []
        for bare in (False, True):
            mine, theirs = context.Pipe()
            child = context.Process(target=_serve, args=(theirs, town.sumocfg, config, seed, bare), daemon=True)
            child.start()
            theirs.close()
            held.callback(child.join, 10.0)
            held.callback(child.terminate)
            held.enter_context(mine)
            ends.append(mine)
        for end in ends:
            _answer(end)
        for tick in range(ticks):
            for end, found in zip(ends, rows, strict=True):
                end.send(True)
                found.append(_answer(end))
            progress(tick + 1)
    react, read, mirror, actors, mirrored = _typical(rows[0])
    (engines,) = _typical(rows[1])
    return BridgeCost(
        react_ms=1e3 * react,
        read_ms=1e3 * read,
        mirror_ms=1e3 * mirror,
        engines_ms=1e3 * engines,
        actors=actors,
        mirrored=mirrored,
    )


def _typical(rows: list[tuple[float, ...]]) -> list[float]:
    """The median of each column over the means of blocks of ticks."""
    whole = np.array(rows[: len(rows) // BLOCK_TICKS * BLOCK_TICKS])
    typical: list[float] = np.median(whole.reshape(-1, BLOCK_TICKS, whole.shape[1]).mean(axis=1), axis=0).tolist()
    return typical


def _answer(end: Connection) -> tuple[float, ...]:
    try:
        if end.poll(ANSWER_S):
            numbers: tuple[float, ...] = end.recv()
            return numbers
    except EOFError:
        pass
    raise SumoError("a world of the comparison died or hangs; run `wcsim doctor`, then try again")


def _serve(end: Connection, sumocfg: Path, config: RunConfig, seed: int, bare: bool) -> None:
    """One of the two worlds: a tick for each message, the numbers of that tick as the answer."""
    kind = _Twin if bare else World
    with kind(open_town(sumocfg), config, (SeatSpec(),), seed) as world:
        world.stopwatch = Stopwatch(time.thread_time)
        for _ in range(SETTLE_TICKS):
            world.tick(as_users_wish(world.snapshot))
        end.send(())
        while True:
            try:
                end.recv()
            except EOFError:
                return
            world.stopwatch.take()
            world.tick(as_users_wish(world.snapshot))
            if isinstance(world, _Twin):
                end.send((world.engines_s,))
            else:
                spent = dict(world.stopwatch.take())
                end.send((*(spent.get(name, 0.0) for name in STAGES), sum(world.counts()), len(world.snapshot.actors)))
