"""`wcsim video TOWN --out x.webm`: ten seconds from a chair's camera, beside a map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.progress import track

from wcsim.cli.shared.common import check_output, in_bounds, missing_folder, parse, tell_made
from wcsim.towns.scenario.town import find_town

_MIN_SECONDS, MAX_SECONDS = 0.1, 3600.0


@dataclass
class Options:
    """Film a chair that does what its user asks for: its camera beside a map."""

    town: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TOWN]")] = "helsinki"
    """A town's name or folder."""
    seed: int = 0
    """Seed of the traffic and of the chair's place."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("video.webm")
    """The video (WebM)."""
    seconds: float = 10.0
    """How long."""
    width: int = 480
    """Width of the camera image in pixels."""


def run(words: list[str]) -> int:
    """Film it."""
    options = parse(Options, words, "video")
    check_output("--out", options.out, ".webm")
    in_bounds("--seconds", options.seconds, _MIN_SECONDS, MAX_SECONDS)
    town = find_town(options.town)

    from wcsim.view.filming import open_stage  # loads the simulators, which --help must not

    console = Console(stderr=True)
    quiet = not console.is_terminal
    missing = missing_folder(options.out)
    with open_stage(town, options.seed, options.width) as stage, stage.film(options.out) as film:
        frames = range(round(options.seconds / stage.tick_s))
        for _ in track(frames, description="filming", console=console, transient=True, disable=quiet):
            film.add()
    tell_made(missing)
    print(f"{options.out}: {options.town}, seed {options.seed}, {options.seconds:g} s")
    return 0
