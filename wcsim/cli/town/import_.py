"""`wcsim town import`: from a map, from the internet, or from a SUMO scenario."""

from __future__ import annotations

import math
import shlex
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from wcsim.cli.shared.common import Bounds, Flag, OutFile, OutFolder, check_folder, fresh_folders, words_of
from wcsim.cli.shared.consoles import say
from wcsim.cli.town.stage_costs import StageClock
from wcsim.cli.town.town_check import checked, told_report
from wcsim.errors import ConfigError
from wcsim.towns.importing.adopt import adopt_scenario
from wcsim.towns.osm.read import Box, download
from wcsim.towns.scenario.town import Town
from wcsim.types import Street

if TYPE_CHECKING:  # loads what builds streets, which --help must not
    from wcsim.towns.checks.check import TownReport
    from wcsim.towns.importing.importer import ImportOrder

_LAND, _SIDE = tyro.conf.create_mutex_group(required=False), tyro.conf.create_mutex_group(required=False)
Stage = Callable[[str], None]  # what begins now, in words


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

    sumocfg: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """The scenario."""
    allow_outside: Flag = False
    """Also copy files that the scenario names outside of its folder."""


@dataclass(kw_only=True)
class ImportOptions(_TownOptions):
    """Import a town from OpenStreetMap; with `--sumocfg FILE` from a SUMO scenario.

    `wcsim town import --sumocfg FILE -h` has the options for a scenario.
    """

    osm: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
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
    dem: Annotated[Path | None, tyro.conf.arg(metavar="FILE"), _LAND] = None
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
    clock = StageClock(say)
    with fresh_folders(out.parent):
        if isinstance(options, AdoptOptions):
            report, more = _adopt(options, out, clock.begin), dict[str, Any]()
        else:
            report, more = _build(options, out, clock.begin)
    return told_report(report, started_s, result, clock, **more)


def _adopt(options: AdoptOptions, out: Path, stage: Stage) -> TownReport:
    if options.allow_outside:
        print(f"note: files outside of the folder of {options.sumocfg} are copied too; check {out} before you share it")
    named = options.name, out, options.split, options.source
    town = adopt_scenario(options.sumocfg, *named, outside=options.allow_outside, cycle_paths=options.cycle_paths)
    try:
        report = checked(town, told=stage)
    except BaseException:  # what cannot be read is no town
        shutil.rmtree(town.folder, ignore_errors=True)
        raise
    print(f"wrote {town.folder}; open it with: sumo-gui -c {shlex.quote(str(town.sumocfg))}")
    return report


def _build(options: ImportOptions, out: Path, stage: Stage) -> tuple[TownReport, dict[str, Any]]:
    """The check of a town that was built, and what else the result file says of it."""
    if options.osm is None and not options.bbox:
        raise ConfigError(
            "town import needs a source: --osm FILE, --bbox W,S,E,N to download an area, or --sumocfg FILE"
        )
    box = _bbox(options.bbox) if options.bbox else None
    if options.osm is not None and not options.osm.is_file():
        raise ConfigError(f"--osm {options.osm}: there is no such file; expected an OpenStreetMap extract")
    if options.osm is not None and options.url:
        raise ConfigError("--url is for a download and cannot be combined with --osm; leave one out")

    from wcsim.towns.importing.importer import import_town

    with tempfile.TemporaryDirectory(prefix="wcsim-osm-") as folder:
        osm = options.osm or download(_bbox(options.bbox), Path(folder), options.url)
        made = import_town(_order(options, osm, box, out), _built, stage)
    print(f"wrote {made.town.folder}; open it with: sumo-gui -c {shlex.quote(str(made.town.sumocfg))}")
    print(f"traffic drives on the {made.side}")
    report = checked(made.town, made.walkable_share, stage)
    counted = ("parked", "crossings_mapped", "crossings_unpainted", "stops_mapped", "stops")
    more = {"left_out": asdict(made.left_out), **{name: getattr(made, name) for name in counted}}
    return replace(report, notes=(*made.notes, *report.notes)), more


def _built(town: Town) -> Street:
    from wcsim.towns.street import load_street

    return load_street(town, say)


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
            raise ConfigError(f"--per-hour {word!r} is not CLASS=NUMBER, once per class, such as passenger=900")
        found[name.strip()] = rate
    return found


def _bbox(text: str) -> Box:
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(
            f"--bbox {text!r} is not west,south,east,north in degrees, such as 24.9,60.1,25.0,60.2"
        ) from None
    if not (-180 <= west < east <= 180 and -90 <= south < north <= 90):
        raise ConfigError(f"--bbox {text!r} is empty or outside of the globe; expected west < east and south < north")
    return west, south, east, north
