"""`wcsim snapshot TOWN --seed S --out x.png`: colours, classes and depth from a chair's camera, with actors in view."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from wcsim.cli.shared.common import Bounds, Repeated, check_output, parse, result_file
from wcsim.cli.shared.run_config import require_unset
from wcsim.towns.scenario.town import find_town

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.view.filming import Shot

MAX_SECONDS = 3600.0
OF_VIDEO = {"env.profile": "its user is competent; for another, use `wcsim video --profile NAME`"}


@dataclass
class Options:
    """Take a picture from a chair's camera in a town: colours, classes and depth."""

    town: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TOWN]")] = "helsinki"
    """A town's name, its folder, or a .sumocfg file."""
    seed: int = 0
    """Seed of the traffic and of the chair's start."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("snapshot.png")
    """The picture (PNG)."""
    width: int = 640
    """Width of each of the three images, in pixels."""
    seconds: Annotated[float, Bounds(0.0, MAX_SECONDS)] = 20.0
    """Time to drive; the picture shows the moment with most road users in view."""
    set: Repeated = ()
    """section.key=value, over the settings, such as chair.plant=mine.toml; may be given several times."""


def run(words: list[str]) -> int:
    """Take the picture at the moment when most actors are in view."""
    options = parse(Options, words, "snapshot")
    require_unset(options.set, OF_VIDEO)
    check_output("--out", options.out, ".png")
    town = find_town(options.town)

    # Loads the simulators, which --help must not.
    from wcsim.view.filming import BusiestMoment, FilmDriver, FilmedDrive

    with FilmedDrive(town, options.seed, options.width, FilmDriver(settings=options.set)) as film:
        busiest = BusiestMoment(film)
        for done in range(1, max(1, round(options.seconds / film.tick_s)) + 1):
            film.drive()
            busiest.look(done * film.tick_s)
    keep_shot(options.out, busiest.shot, f"{options.town}, seed {options.seed}")
    return 0


def keep_shot(out: Path, shot: Shot, place: str) -> None:
    """Write a moment as a picture, and say what it shows."""
    from wcsim.view.pictures import triptych, write_png

    picture = triptych(shot.rgb, shot.class_id, shot.depth_m)
    with result_file(out) as part:
        write_png(part, picture)
    print(f"{out}: {place}, after {shot.after_s:.1f} s, {shot.in_view} actor{'s' * (shot.in_view != 1)} near in view")
