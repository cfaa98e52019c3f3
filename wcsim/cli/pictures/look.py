"""`wcsim look TOWN`: a picture and a ten-second video, without any training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from wcsim.cli.pictures import snapshot, video
from wcsim.cli.shared.common import parse
from wcsim.towns.scenario.town import find_town


@dataclass
class Options:
    """Take a picture from a chair's camera and film ten seconds of its way, its user driving alone."""

    town: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TOWN]")] = "helsinki"
    """A town's name or folder."""
    seed: int = 4
    """Seed of the traffic and of the chair's place."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("look")
    """Where TOWN.png and TOWN.webm go."""
    seconds: float = 10.0
    """How long it is filmed; the picture is of the busiest moment of these."""


def run(words: list[str]) -> int:
    """The picture first, then the video."""
    options = parse(Options, words, "look")
    place = options.out / find_town(options.town).name
    same = [options.town, "--seed", str(options.seed), "--seconds", str(options.seconds)]
    snapshot.run([*same, "--out", f"{place}.png"])
    return video.run([*same, "--out", f"{place}.webm"])
