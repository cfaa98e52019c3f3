"""`wcsim bench ...`: measure this machine and this product, as ratios of things timed in the same run."""

from __future__ import annotations

from importlib import import_module

from wcsim.cli.shared.common import parse, subcommand

BENCHES = {
    "tick": "TickOptions",
    "camera": "CameraOptions",
    "chair": "ChairOptions",
    "users": "UsersOptions",
    "crashes": "CrashesOptions",
    "reaction": "ReactionOptions",
    "bridge": "BridgeOptions",
    "barrier": "BarrierOptions",
    "parallel": "ParallelOptions",
    "soak": "SoakOptions",
    "memory": "MemoryOptions",
}
"""The benches, each a file here of that name with a `run(options)`, and its class of options."""


def run(words: list[str]) -> int:
    """Run one bench; only its own file is loaded."""
    name = subcommand(words, "bench", BENCHES, options_of)
    if not name:
        return 0
    return int(import_module(_home(name)).run(parse(options_of(name), words[1:], f"bench {name}")))


def options_of(name: str) -> type:
    """A bench's class of options."""
    found: type = getattr(import_module(_home(name)), BENCHES[name])
    return found


def _home(name: str) -> str:
    return f"{__package__}.{name}"
