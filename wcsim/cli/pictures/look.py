"""`wcsim look TOWN`: two pictures and a ten-second video, without any training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from wcsim.cli.pictures.snapshot import OF_VIDEO, keep_shot
from wcsim.cli.pictures.video import MAX_SECONDS, MIN_SECONDS
from wcsim.cli.shared.common import Bounds, Repeated, check_output, missing_folder, parse, result_file, tell_made
from wcsim.cli.shared.run_config import require_unset
from wcsim.cli.shared.stage_bar import StageBar
from wcsim.towns.scenario.town import find_town

_WIDTH_PX = 640


@dataclass
class Options:
    """Take pictures of a chair and from its camera, and film it; its user drives alone."""

    town: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TOWN]")] = "helsinki"
    """A town's name, its folder, or a .sumocfg file."""
    seed: int = 4
    """Seed of the traffic and of the chair's start."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("look")
    """Folder for TOWN-street.png, TOWN.png and TOWN.webm."""
    seconds: Annotated[float, Bounds(MIN_SECONDS, MAX_SECONDS)] = 10.0
    """Length of the film. The pictures show its busiest moment in which the chair faces its route."""
    set: Repeated = ()
    """section.key=value, over the settings, such as chair.plant=mine.toml; may be given several times."""


def run(words: list[str]) -> int:
    """One drive: it is filmed, and its busiest moment is the picture."""
    options = parse(Options, words, "look")
    require_unset(options.set, OF_VIDEO)
    town = find_town(options.town)
    street, picture, video = (options.out / f"{town.name}{kind}" for kind in ("-street.png", ".png", ".webm"))
    check_output("--out", video)
    missing = missing_folder(video)

    from wcsim.drive.pictures import StillPictures  # these load the simulators, which --help must not
    from wcsim.view.filming import BusiestMoment, FilmDriver, FilmedDrive
    from wcsim.view.pictures import write_png

    with (
        StageBar("filming") as bar,
        FilmedDrive(town, options.seed, _WIDTH_PX, FilmDriver(settings=options.set), video) as film,
    ):
        stills = StillPictures(film.world)
        busiest = BusiestMoment(film, stills.on_way)
        seen, frames = stills.draw(), round(options.seconds / film.tick_s)
        with result_file(street) as part:
            write_png(part, seen)  # something to look at while it is filmed
        for done in range(1, frames + 1):
            film.add()
            if busiest.look(done * film.tick_s, stills.on_way):
                seen = stills.draw()
            bar.show(done / frames, f"second {done * film.tick_s:.0f} of {options.seconds:g}")
    tell_made(missing)
    place = f"{options.town}, seed {options.seed}"
    with result_file(street) as part:
        write_png(part, seen)
    print(f"{street}: {place}, the chair from behind")
    keep_shot(picture, busiest.shot, place)
    print(f"{video}: the chair's camera and a map, {options.seconds:g} s; a browser plays it")
    return 0
