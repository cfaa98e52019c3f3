"""`wcsim bench ...`: measure this machine and this product, as ratios of things timed in the same run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from wcsim.cli.bench import barrier, bridge, camera, chair, crashes, memory, parallel, reaction, soak, tick, users
from wcsim.cli.bench.barrier import BarrierOptions
from wcsim.cli.bench.bridge import BridgeOptions
from wcsim.cli.bench.camera import CameraOptions
from wcsim.cli.bench.chair import ChairOptions
from wcsim.cli.bench.crashes import CrashesOptions
from wcsim.cli.bench.memory import MemoryOptions
from wcsim.cli.bench.parallel import ParallelOptions
from wcsim.cli.bench.reaction import ReactionOptions
from wcsim.cli.bench.soak import SoakOptions
from wcsim.cli.bench.tick import TickOptions
from wcsim.cli.bench.users import UsersOptions
from wcsim.cli.shared.common import parse, subcommand

Bench = tuple[type, Callable[[Any], int]]


def run(words: list[str]) -> int:
    """Run one bench."""
    known: dict[str, Bench] = {
        "tick": (TickOptions, tick.run),
        "camera": (CameraOptions, camera.run),
        "chair": (ChairOptions, chair.run),
        "users": (UsersOptions, users.run),
        "crashes": (CrashesOptions, crashes.run),
        "reaction": (ReactionOptions, reaction.run),
        "bridge": (BridgeOptions, bridge.run),
        "barrier": (BarrierOptions, barrier.run),
        "parallel": (ParallelOptions, parallel.run),
        "soak": (SoakOptions, soak.run),
        "memory": (MemoryOptions, memory.run),
    }
    name = subcommand(words, "bench", {name: options for name, (options, _) in known.items()})
    if not name:
        return 0
    options, bench = known[name]
    return bench(parse(options, words[1:], f"bench {name}"))
