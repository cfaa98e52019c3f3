"""`wcsim bench ...`: measure this machine and this product, as ratios of things timed in the same run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from wcsim.cli import (
    bench_barrier,
    bench_bridge,
    bench_camera,
    bench_chair,
    bench_crashes,
    bench_parallel,
    bench_reaction,
    bench_soak,
    bench_tick,
    bench_users,
)
from wcsim.cli.bench_barrier import BarrierOptions
from wcsim.cli.bench_bridge import BridgeOptions
from wcsim.cli.bench_camera import CameraOptions
from wcsim.cli.bench_chair import ChairOptions
from wcsim.cli.bench_crashes import CrashesOptions
from wcsim.cli.bench_parallel import ParallelOptions
from wcsim.cli.bench_reaction import ReactionOptions
from wcsim.cli.bench_soak import SoakOptions
from wcsim.cli.bench_tick import TickOptions
from wcsim.cli.bench_users import UsersOptions
from wcsim.cli.common import parse, subcommand

Bench = tuple[type, Callable[[Any], int]]


def run(words: list[str]) -> int:
    """Run one bench."""
    known: dict[str, Bench] = {
        "tick": (TickOptions, bench_tick.run),
        "camera": (CameraOptions, bench_camera.run),
        "chair": (ChairOptions, bench_chair.run),
        "users": (UsersOptions, bench_users.run),
        "crashes": (CrashesOptions, bench_crashes.run),
        "reaction": (ReactionOptions, bench_reaction.run),
        "bridge": (BridgeOptions, bench_bridge.run),
        "barrier": (BarrierOptions, bench_barrier.run),
        "parallel": (ParallelOptions, bench_parallel.run),
        "soak": (SoakOptions, bench_soak.run),
    }
    name = subcommand(words, "bench", {name: options for name, (options, _) in known.items()})
    if not name:
        return 0
    options, bench = known[name]
    return bench(parse(options, words[1:], f"bench {name}"))
