"""`python -m benchmarks NAME [options]`: measure this machine and wcsim, as ratios of things timed in the same run."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

from wcsim.cli.main import run_with_exit_code
from wcsim.cli.shared.common import parse_options
from wcsim.errors import ConfigError, meant

SCRIPTS = {
    "tick": "TickOptions",
    "camera": "CameraOptions",
    "users": "UsersOptions",
    "reaction": "ReactionOptions",
    "barrier": "BarrierOptions",
    "parallel": "ParallelOptions",
    "soak": "SoakOptions",
    "judge": "KerbOptions",
    "sight": "SightOptions",
    "map_truth": "MapTruthOptions",
    "rolling": "RollingOptions",
}
"""Each a file of that name in `scripts/` with a `run(options)`, and its class of options."""
PROGRAM = "python -m benchmarks"


def main(arguments: list[str] | None = None) -> int:
    """Run one script; only its own file is loaded. Returns the exit code, as that of `wcsim`."""
    return run_with_exit_code(_run, arguments)


def _run(words: list[str]) -> int:
    name = words[0] if words else "--help"
    if name in ("-h", "--help"):
        lines = [f"  {each:<10}{(_script(each)[0].__doc__ or '').strip()}" for each in SCRIPTS]
        print("\n".join([f"usage: {PROGRAM} NAME [options]", "", *lines]))
        return 0
    if name not in SCRIPTS:
        raise ConfigError(f"unknown benchmark {name!r}; expected one of: {', '.join(SCRIPTS)}{meant(name, SCRIPTS)}")
    options, run = _script(name)
    return int(run(parse_options(options, words[1:], name, PROGRAM)))


def _script(name: str) -> tuple[type, Callable[[Any], int]]:
    """The class of options of a script, and what runs it."""
    module = import_module(f"benchmarks.scripts.{name}")
    return getattr(module, SCRIPTS[name]), module.run


if __name__ == "__main__":
    sys.exit(main())
