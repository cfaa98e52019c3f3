"""`wcsim replay`: what a run recorded, for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from wcsim.cli.common import OutFile, check_output, parse, write_json, write_whole
from wcsim.errors import ConfigError

TRACE = "trace"


@dataclass
class Options:
    """Show a recorded run in other programs: write its traffic and wheelchairs as SUMO's floating car data."""

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """A run folder of `wcsim town run`, or a trace."""
    fcd: Annotated[Path, tyro.conf.arg(metavar="FILE.xml")]
    """The file to write; SUMO's tools and sumo-gui read it."""
    epoch: int = 0
    """Which epoch of the world, when it was made anew during the run."""
    json: OutFile = None
    """Write the result to this file."""


def run(words: list[str]) -> int:
    """Write the file."""
    options = parse(Options, words, "replay")
    check_output("--fcd", options.fcd)
    trace = options.run / TRACE if options.run.is_dir() else options.run
    if not trace.is_file():
        raise ConfigError(f"{options.run}: has no trace; expected a folder that `wcsim town run` made, or a trace")
    from wcsim.bridge.fcd import write_fcd  # the simulators are loaded here, not for --help

    steps = 0

    def fill(part: Path) -> None:
        nonlocal steps
        steps = write_fcd(trace, part, options.epoch)

    write_whole(options.fcd, fill)
    print(f"wrote {options.fcd}: {steps} time steps")
    if options.json is not None:
        write_json(options.json, {"run": str(options.run), "fcd": str(options.fcd), "steps": steps})
    return 0
