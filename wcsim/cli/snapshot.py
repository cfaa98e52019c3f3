"""`wcsim snapshot TOWN --seed S --out x.png`: colours, classes and depth from a chair's camera, with actors in view."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from wcsim.cli.common import parse
from wcsim.view.pictures import triptych, write_png
from wcsim.view.stage import open_stage


@dataclass
class Options:
    """Take a picture from a chair's camera in the traffic of a town: colours, classes and depth side by side."""

    town: Annotated[str, tyro.conf.Positional] = "helsinki"
    """A town's name or folder."""
    seed: int = 0
    """Seed of the traffic and of the chair's place."""
    out: Path = Path("snapshot.png")
    """The picture."""
    width: int = 640
    """Width of each of the three images, in pixels."""
    seconds: float = 20.0
    """How long the chair may drive until most is in view."""


def run(words: list[str]) -> int:
    """Take the picture at the moment when most actors are in view."""
    options = parse(Options, words, "snapshot")
    with open_stage(options.town, options.seed, options.width) as stage:
        shot = stage.busiest_moment(options.seconds)
    write_png(options.out, triptych(shot.rgb, shot.class_id, shot.depth_m))
    place = f"{options.town}, seed {options.seed}, after {shot.after_s:.1f} s"
    print(f"{options.out}: {place}, {shot.in_view} actors in view")
    return 0
