"""What a tick costs: the world beside its bare engines and beside the loop that one would write first, in turns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.interleave import Contestant, Runner, in_turns
from benchmarks.tick.bridgeless_world import BLOCK_TICKS, STAGES, StopwatchedWorld, TimedTwin, bridge_cost, typical
from wcsim.config import RunConfig
from wcsim.server.specs import seat_spec_from_env
from wcsim.towns.scenario.town import Town


@dataclass(frozen=True, slots=True, kw_only=True)
class TickCost:
    """One number of wheelchairs: rates in wall time, ratios and shares in processor time."""

    ticks_per_s: float
    ms_median: float
    ratio_vs_naive: float | None  # without the naive loop
    bridge_overhead: float  # reaction, reading and mirror over the bare engines
    bridge_ms: float  # these three
    share: tuple[tuple[str, float], ...]
    actors: float
    mirrored: float
    rss_mb: float


def measure_tick(
    town: Town,
    config: RunConfig,
    chairs: int,
    ticks: int,
    seed: int,
    naive: Callable[..., Runner] | None,
    progress: Callable[[int], object],
) -> TickCost:
    """Run the world, its twin without a bridge and, where there is one, the naive loop for `ticks` ticks, in turns.

    Raises:
        SumoError: One of the three dies or hangs.
    """
    given = (town.sumocfg, config, (seat_spec_from_env(config.env),) * chairs, seed)
    takers = [Contestant(make=make, given=given, ticks=BLOCK_TICKS) for make in (StopwatchedWorld, TimedTwin)]
    if naive is not None:
        takers.append(Contestant(make=naive, given=(town.sumocfg, config, chairs, seed), ticks=BLOCK_TICKS))
    turns = -(-ticks // BLOCK_TICKS)
    ours, bare, *rival = in_turns(takers, turns, lambda done: progress(min(ticks, done * BLOCK_TICKS)))
    whole = np.array(ours)
    wall_s, cpu_s = whole[:, 0], typical(ours)[1]
    share = {name: float(part) for name, part in zip(STAGES, whole[:, 2:-3].sum(0) / whole[:, 1].sum(), strict=True)}
    share["rest"] = max(0.0, 1.0 - sum(share.values()))
    cost = bridge_cost(ours, bare)
    return TickCost(
        ticks_per_s=float(len(wall_s) / wall_s.sum()),
        ms_median=1e3 * float(np.median(wall_s)),
        ratio_vs_naive=typical(rival[0])[1] / cpu_s if rival else None,
        bridge_overhead=cost.overhead,
        bridge_ms=cost.bridge_ms,
        share=tuple(sorted(share.items(), key=lambda item: -item[1])),
        actors=cost.actors,
        mirrored=cost.mirrored,
        rss_mb=float(whole[-1, -1]) / 1e6,
    )
