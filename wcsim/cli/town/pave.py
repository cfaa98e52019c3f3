"""`wcsim town pave`: a copy of a scenario with pavements and crossings."""

from __future__ import annotations

import os
import shlex
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from wcsim.cli.shared.common import Bounds, Flag, OutFile, TownWord, check_folder
from wcsim.cli.shared.consoles import say
from wcsim.cli.town.town_check import told_report, try_town
from wcsim.core.reading import counted
from wcsim.towns.checks.cures import FASTEST_MPS
from wcsim.towns.scenario.town import Town, find_town, open_town

if TYPE_CHECKING:
    from wcsim.towns.pave.pavements import Paved

TOLD = 5


@dataclass
class PaveOptions:
    """Copy a scenario into a folder and add pavements and crossings."""

    town: TownWord
    """A town's name, its folder, or a .sumocfg file; it is not changed."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """New folder for the copy."""
    max_speed: Annotated[float, Bounds(1.0, 100.0)] = FASTEST_MPS
    """Streets faster than this, in m/s, get no pavement."""
    allow_outside: Flag = False
    """Also copy files that a .sumocfg names outside of its folder."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: PaveOptions) -> int:
    """Pave, let SUMO try the copy, check it, and say what was done; 0 when the copy has no faults, else 1."""
    started_s = time.monotonic()
    check_folder("--out", options.out)
    bare = find_town(options.town, outside=options.allow_outside)

    from wcsim.towns.checks.check import check_town  # loads what builds streets, which --help must not
    from wcsim.towns.pave.pavements import pave_town

    say(f"adding pavements in {options.out}")
    paved = pave_town(bare, options.out, options.max_speed)
    town = _copy_of(bare, paved.sumocfg, outside=options.allow_outside)
    say("testing the first steps in SUMO")
    try_town(town)
    say("checking the copy")
    report = check_town(town)
    _print(paved)
    return told_report(report, started_s, options.json, paved={**asdict(paved), "sumocfg": str(paved.sumocfg)})


def _copy_of(bare: Town, sumocfg: Path, *, outside: bool) -> Town:
    """The copy, opened as the scenario was: by the folder whose town.toml says where it lies, or as it is."""
    deep = len(Path(os.path.relpath(bare.sumocfg, bare.folder)).parts)
    return open_town(sumocfg if deep == 1 else sumocfg.parents[deep - 1], outside=outside)


def _print(paved: Paved) -> None:
    print(f"wrote {paved.sumocfg}; open it with: sumo-gui -c {shlex.quote(str(paved.sumocfg))}")
    streets = [f"{counted(paved.streets, 'street')} got a pavement"] if paved.streets or not paved.had else []
    streets += [f"{counted(paved.had, 'street')} already had one"] if paved.had else []
    print(
        f"{', '.join(streets)}; added {counted(paved.crossings, 'crossing')} and "
        f"{counted(paved.walkingareas, 'walking area')}; checked {counted(paved.placed, 'element')} on lanes (stops, "
        f"detectors, ...) and {counted(paved.programs, 'signal program')}"
    )
    if paved.moved_m:
        print(f"{counted(len(paved.moved_m), 'position')} moved off junctions that grew; the farthest, in m:")
        for name, along_m in paved.moved_m[:TOLD]:
            print(f"  {name}: {along_m:.2f}")
    for note in paved.notes:
        print(f"note: {note}")
