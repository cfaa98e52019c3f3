"""`wcsim town make`: a town without a map, from a seed."""

from __future__ import annotations

import shlex
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from wcsim.cli.shared.common import Flag, OutFile, OutFolder, check_folder
from wcsim.cli.shared.consoles import say
from wcsim.cli.town.stage_costs import StageClock
from wcsim.cli.town.town_check import checked, told_report
from wcsim.towns.importing.folder_texts import check_words
from wcsim.towns.making.asked_town import Wishes, check_wishes


@dataclass
class TownMakeOptions:
    """Generate a town from a seed, without a map."""

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """The town's name."""
    seed: int = 0
    """Seed of the whole town; the same seed and name give the same bytes."""
    size: float = 700.0
    """Approximate width in metres."""
    kind: Literal["any", "grid", "spider", "random"] = "any"
    """Kind of street network; any: chosen by the seed."""
    split: Literal["train", "test"] = "train"
    """Use it for training, or only for tests."""
    out: OutFolder = None
    """Folder to create; default ./scenarios/sumo/NAME."""
    traffic: float = 1.0
    """Factor for all traffic; 0 for none."""
    parked: float = 0.7
    """Share of the parking spaces with a parked car."""
    hill: float | None = None
    """Height of its hills in metres, 0 for a level town; default: chosen by the seed."""
    replace: Flag = False
    """Also replace an imported or edited town; it is lost."""
    json: OutFile = None
    """Write the result of the check to this file."""


def run(options: TownMakeOptions) -> int:
    """Generate, check, and print the result; 0 when the town has no faults, else 1."""
    started_s = time.monotonic()
    out = options.out or Path("scenarios/sumo") / options.name
    wishes = Wishes(
        size_m=options.size,
        kind="" if options.kind == "any" else options.kind,
        split=options.split,
        traffic=options.traffic,
        parked=options.parked,
        hill_m=options.hill,
    )
    check_words(options.name, options.split)
    check_wishes(options.seed, wishes)
    check_folder("--out", out)
    result = options.json and options.json.resolve()  # this folder itself may be made anew

    from wcsim.towns.making.maker import make_town  # loads what builds streets, which --help must not

    clock = StageClock(say)
    town = make_town(out, options.seed, wishes, name=options.name, overwrite=options.replace, stage=clock.begin)
    print(f"wrote {town.folder}; open it with: sumo-gui -c {shlex.quote(str(town.sumocfg))}")
    return told_report(checked(town, told=clock.begin), started_s, result, clock)
