"""Towns made: `wcsim town import`, of a map or a scenario; `make`, from a seed; `pave`, of one without pavements."""

from __future__ import annotations

import math
import os
import shlex
import shutil
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg, create_mutex_group

from wcsim.cli.shared.common import (
    Bounds,
    Flag,
    InFile,
    OutFile,
    OutFolder,
    TownWord,
    check_folder,
    fresh_folders,
    words_of,
)
from wcsim.cli.shared.consoles import print_note
from wcsim.cli.town.town_check import checked, told_report, try_town
from wcsim.core.own_folder import temporary_folder
from wcsim.core.reading import counted
from wcsim.errors import ConfigError
from wcsim.towns.checks.cures import FASTEST_MPS
from wcsim.towns.importing.adopt import adopt_scenario
from wcsim.towns.importing.folder_texts import check_words
from wcsim.towns.making.asked_town import Wishes, check_wishes
from wcsim.towns.osm.read import Box, download
from wcsim.towns.scenario.town import Town, find_town, open_town
from wcsim.types import Street

if TYPE_CHECKING:  # loads what builds streets, which --help must not
    from wcsim.towns.checks.check import TownReport
    from wcsim.towns.importing.importer import ImportOrder
    from wcsim.towns.pave.pavements import Paved


_LAND, _SIDE = create_mutex_group(required=False), create_mutex_group(required=False)


@dataclass(kw_only=True)
class _TownOptions:
    """What every new town has."""

    name: str
    """The town's name."""
    split: Literal["train", "test"] = "train"
    """Use it for training, or only for tests."""
    out: OutFolder = None
    """Folder to create; default ./scenarios/sumo/NAME."""
    cycle_paths: Flag = False
    """Wheelchairs also drive on cycle paths beside the road, where the law allows it."""
    source: str = ""
    """Origin of the extract or scenario, for the licence notice."""
    json: OutFile = None
    """Write the result of the check to this file."""


@dataclass(kw_only=True)
class AdoptOptions(_TownOptions):
    """Import a town from a SUMO scenario, whose files are copied unchanged."""

    sumocfg: Annotated[Path, arg(metavar="FILE")]
    """The scenario."""
    allow_outside: Flag = False
    """Also copy files that the scenario names outside of its folder."""


@dataclass(kw_only=True)
class ImportOptions(_TownOptions):
    """Import a town from OpenStreetMap; with `--sumocfg FILE` from a SUMO scenario.

    `wcsim town import --sumocfg FILE -h` has the options for a scenario.
    """

    osm: InFile = None
    """An OpenStreetMap extract: .osm, .osm.xml, plain, .gz or .bz2, or .osm.pbf."""
    bbox: str = ""
    """Area to import, in degrees: west,south,east,north; without --osm it is downloaded."""
    url: str = ""
    """Overpass server to download from; default: the servers that SUMO knows."""
    lefthand: Annotated[Flag, _SIDE] = False
    """Traffic drives on the left; default: that of the country."""
    righthand: Annotated[Flag, _SIDE] = False
    """Traffic drives on the right."""
    per_hour: str = ""
    """Departures per hour by SUMO vehicle class, e.g. passenger=900,bicycle=300; other classes keep their density."""
    traffic: Annotated[float, Bounds(0.0, 10.0)] = 1.0
    """Factor for all traffic; 0 for none."""
    parked: Annotated[float, Bounds(0.0, 1.0)] = 0.7
    """Share of the mapped parking spaces with a parked car."""
    dem: Annotated[InFile, _LAND] = None
    """GeoTIFF of the land's heights in metres."""
    hill: Annotated[float, Bounds(0.0, 200.0), _LAND] = 0.0
    """Height in metres of an invented hill, instead of --dem."""
    max_grade: Annotated[float, Bounds(0.01, 0.25)] = 0.12
    """Largest grade of a street (rise over run); steeper land is smoothed and lowered."""
    keep_service: Flag = False
    """Include driveways and yards, each with its own crossing."""
    seed: int = 42
    """Seed of the demand, the parked cars and the hill."""
    replace: Flag = False
    """Replace a town that was edited; all edits are lost."""


def run(options: AdoptOptions | ImportOptions) -> int:
    """Import, check, and print the result; 0 when the town has no faults, else 1."""
    started_s = time.monotonic()
    out = options.out or Path("scenarios/sumo") / options.name
    check_folder("--out", out)
    result = options.json and options.json.resolve()  # this folder itself may be built anew
    with fresh_folders(out.parent):
        if isinstance(options, AdoptOptions):
            report, more = _adopt(options, out), dict[str, Any]()
        else:
            report, more = _build(options, out)
    return told_report(report, started_s, result, **more)


def _adopt(options: AdoptOptions, out: Path) -> TownReport:
    if options.allow_outside:
        print(
            f"note: files outside of the folder of {options.sumocfg} are copied too; check {out} before you share it"
        )
    named = options.name, out, options.split, options.source
    town = adopt_scenario(
        options.sumocfg, *named, outside=options.allow_outside, cycle_paths=options.cycle_paths
    )
    try:
        report = checked(town, told=print_note)
    except BaseException:  # what cannot be read is no town
        shutil.rmtree(town.folder, ignore_errors=True)
        raise
    print(f"wrote {town.folder}; open it with: sumo-gui -c {shlex.quote(str(town.sumocfg))}")
    return report


def _build(options: ImportOptions, out: Path) -> tuple[TownReport, dict[str, Any]]:
    """The check of a town that was built, and what else the result file says of it."""
    if options.osm is None and not options.bbox:
        raise ConfigError(
            "town import needs a source: --osm FILE, --bbox W,S,E,N to download an area, or --sumocfg FILE"
        )
    box = _bbox(options.bbox) if options.bbox else None
    if options.osm is not None and not options.osm.is_file():
        raise ConfigError(
            f"--osm {options.osm}: there is no such file; expected an OpenStreetMap extract"
        )
    if options.osm is not None and options.url:
        raise ConfigError(
            "--url is for a download and cannot be combined with --osm; leave one out"
        )

    from wcsim.towns.importing.importer import import_town

    with temporary_folder() as folder:
        osm = options.osm or download(_bbox(options.bbox), folder, options.url)
        made = import_town(_order(options, osm, box, out), _built, print_note)
    print(
        f"wrote {made.town.folder}; open it with: sumo-gui -c {shlex.quote(str(made.town.sumocfg))}"
    )
    print(f"traffic drives on the {made.side}")
    report = checked(made.town, made.walkable_share, print_note)
    more = {"left_out": asdict(made.left_out), **made.counts}
    return replace(report, notes=(*made.notes, *report.notes)), more


def _built(town: Town) -> Street:
    from wcsim.towns.street import load_street

    return load_street(town, print_note)


def _order(options: ImportOptions, osm: Path, box: Box | None, out: Path) -> ImportOrder:
    from wcsim.towns.importing.elevation import Heights
    from wcsim.towns.importing.importer import ImportOrder

    return ImportOrder(
        osm=osm,
        bbox=box,
        name=options.name,
        split=options.split,
        out=out,
        lefthand=options.lefthand if options.lefthand or options.righthand else None,
        seed=options.seed,
        traffic=options.traffic,
        per_hour=_per_hour(options.per_hour),
        parked=options.parked,
        relief=Heights(dem=options.dem, hill_m=options.hill, max_grade=options.max_grade),
        keep_service=options.keep_service,
        cycle_paths=options.cycle_paths,
        source=options.source,
        overwrite=options.replace,
    )


def _per_hour(text: str) -> dict[str, float]:
    found: dict[str, float] = {}
    for word in words_of(text):
        name, _, number = word.partition("=")
        try:
            rate = float(number)
        except ValueError:
            rate = math.nan
        if not name or not math.isfinite(rate) or name.strip() in found:
            raise ConfigError(
                f"--per-hour {word!r} is not CLASS=NUMBER, once per class, such as passenger=900"
            )
        found[name.strip()] = rate
    return found


def _bbox(text: str) -> Box:
    try:
        box = Box.of(text)
    except ValueError:
        raise ConfigError(
            f"--bbox {text!r} is not west,south,east,north in degrees, such as 24.9,60.1,25.0,60.2"
        ) from None
    if not (-180 <= box.west < box.east <= 180 and -90 <= box.south < box.north <= 90):
        raise ConfigError(
            f"--bbox {text!r} is empty or outside of the globe; expected west < east and south < north"
        )
    return box


@dataclass
class TownMakeOptions:
    """Generate a town from a seed, without a map."""

    name: Annotated[str, Positional, arg(metavar="NAME")]
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


def make(options: TownMakeOptions) -> int:
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

    from wcsim.towns.making.maker import (
        make_town,
    )  # loads what builds streets, which --help must not

    town = make_town(
        out, options.seed, wishes, name=options.name, overwrite=options.replace, stage=print_note
    )
    print(f"wrote {town.folder}; open it with: sumo-gui -c {shlex.quote(str(town.sumocfg))}")
    return told_report(checked(town, told=print_note), started_s, result)


TOLD = 5


@dataclass
class PaveOptions:
    """Copy a scenario into a folder and add pavements and crossings."""

    town: TownWord
    """A town's name, its folder, or a .sumocfg file; it is not changed."""
    out: Annotated[Path, arg(metavar="FOLDER")]
    """New folder for the copy."""
    max_speed: Annotated[float, Bounds(1.0, 100.0)] = FASTEST_MPS
    """Streets faster than this, in m/s, get no pavement."""
    allow_outside: Flag = False
    """Also copy files that a .sumocfg names outside of its folder."""
    json: OutFile = None
    """Write the result to this file."""


def pave(options: PaveOptions) -> int:
    """Pave, let SUMO try the copy, check it, and say what was done; 0 when the copy has no faults, else 1."""
    started_s = time.monotonic()
    check_folder("--out", options.out)
    bare = find_town(options.town, outside=options.allow_outside)

    from wcsim.towns.checks.check import (
        check_town,
    )  # loads what builds streets, which --help must not
    from wcsim.towns.pave.pavements import pave_town

    print_note(f"adding pavements in {options.out}")
    paved = pave_town(bare, options.out, options.max_speed)
    town = _copy_of(bare, paved.sumocfg, outside=options.allow_outside)
    print_note("testing the first steps in SUMO")
    try_town(town)
    print_note("checking the copy")
    report = check_town(town)
    _print(paved)
    return told_report(
        report, started_s, options.json, paved={**asdict(paved), "sumocfg": str(paved.sumocfg)}
    )


def _copy_of(bare: Town, sumocfg: Path, *, outside: bool) -> Town:
    """The copy, opened as the scenario was: by the folder whose town.toml says where it lies, or as it is."""
    deep = len(Path(os.path.relpath(bare.sumocfg, bare.folder)).parts)
    return open_town(sumocfg if deep == 1 else sumocfg.parents[deep - 1], outside=outside)


def _print(paved: Paved) -> None:
    print(f"wrote {paved.sumocfg}; open it with: sumo-gui -c {shlex.quote(str(paved.sumocfg))}")
    streets = (
        [f"{counted(paved.streets, 'street')} got a pavement"]
        if paved.streets or not paved.had
        else []
    )
    streets += [f"{counted(paved.had, 'street')} already had one"] if paved.had else []
    print(
        f"{', '.join(streets)}; added {counted(paved.crossings, 'crossing')} and "
        f"{counted(paved.walkingareas, 'walking area')}; checked {counted(paved.placed, 'element')} on lanes (stops, "
        f"detectors, ...) and {counted(paved.programs, 'signal program')}"
    )
    if paved.moved_m:
        print(
            f"{counted(len(paved.moved_m), 'position')} moved off junctions that grew; the farthest, in m:"
        )
        for name, along_m in paved.moved_m[:TOLD]:
            print(f"  {name}: {along_m:.2f}")
    for note in paved.notes:
        print(f"note: {note}")
