"""`wcsim look TOWN`: a picture and a ten-second video, without any training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from wcsim.cli.pictures.snapshot import keep_shot
from wcsim.cli.pictures.video import MAX_SECONDS, MIN_SECONDS
from wcsim.cli.shared.common import check_output, in_bounds, missing_folder, parse, tell_made
from wcsim.cli.shared.stage_bar import StageBar
from wcsim.towns.scenario.town import find_town

_WIDTH_PX = 640


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
    """One drive: it is filmed, and its busiest moment is the picture."""
    options = parse(Options, words, "look")
    town = find_town(options.town)
    picture, video = (options.out / f"{town.name}.{kind}" for kind in ("png", "webm"))
    check_output("--out", video)
    in_bounds("--seconds", options.seconds, MIN_SECONDS, MAX_SECONDS)
    missing = missing_folder(video)

    from wcsim.view.filming import BusiestMoment, open_stage  # loads the simulators, which --help must not

    with (
        StageBar("filming") as bar,
        open_stage(town, options.seed, _WIDTH_PX) as stage,
        stage.film(video) as film,
    ):
        busiest, frames = BusiestMoment(stage), round(options.seconds / film.tick_s)
        for done in range(1, frames + 1):
            film.add()
            busiest.look(done * film.tick_s)
            bar.show(done / frames, f"second {done * film.tick_s:.0f} of {options.seconds:g}")
    tell_made(missing)
    place = f"{options.town}, seed {options.seed}"
    keep_shot(picture, busiest.shot, place)
    print(f"{video}: {place}, {options.seconds:g} s")
    return 0
