"""`wcsim town import`: from a map, from the internet, or from a SUMO scenario."""

from __future__ import annotations

import math
import shlex
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from wcsim.cli.shared.common import Bounds, OutFile, OutFolder, check_folder, words_of, write_json
from wcsim.cli.shared.consoles import stderr_console, stdout_console
from wcsim.cli.town.stage_costs import StageClock, costs_json, costs_table
from wcsim.cli.town.town_check import checked, print_report, report_json
from wcsim.errors import ConfigError
from wcsim.towns.importing.adopt import adopt_scenario
from wcsim.towns.osm.area import Box
from wcsim.towns.osm.read import download
from wcsim.towns.scenario.town import Town
from wcsim.types import Street

if TYPE_CHECKING:  # loads what builds streets, which --help must not
    from wcsim.towns.checks.check import TownReport
    from wcsim.towns.importing.importer import ImportOrder

# Options that a ready scenario knows.
_ADOPTED = ("name", "sumocfg", "allow_outside", "cycle_paths", "split", "out", "source", "json")
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Stage = Callable[[str], None]  # what begins now, in words


@dataclass
class ImportOptions:
    """Import a town from OpenStreetMap, or from a SUMO scenario."""

    name: str
    """The town's name."""
    osm: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """An OpenStreetMap extract: .osm, .osm.xml, plain, .gz or .bz2, or .osm.pbf."""
    bbox: str = ""
    """Area to import, in degrees: west,south,east,north; without --osm it is downloaded."""
    sumocfg: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """A SUMO scenario instead of a map; its files are copied unchanged."""
    allow_outside: Flag = False
    """Also copy files that the scenario names outside of its folder."""
    url: str = ""
    """Overpass server to download from; default: the servers that SUMO knows."""
    split: Literal["train", "test"] = "train"
    """Use it for training, or only for tests."""
    out: OutFolder = None
    """Folder to create; default ./scenarios/sumo/NAME."""
    lefthand: Flag = False
    """Traffic drives on the left; default: that of the country."""
    righthand: Flag = False
    """Traffic drives on the right."""
    per_hour: str = ""
    """Departures per hour by SUMO vehicle class, e.g. passenger=900,bicycle=300; other classes keep their density."""
    traffic: Annotated[float, Bounds(0.0, 10.0)] = 1.0
    """Factor for all traffic; 0 for none."""
    parked: Annotated[float, Bounds(0.0, 1.0)] = 0.7
    """Share of the mapped parking spaces with a parked car."""
    dem: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """GeoTIFF of the land's heights in metres."""
    hill: Annotated[float, Bounds(0.0, 200.0)] = 0.0
    """Height in metres of an invented hill, instead of --dem."""
    max_grade: Annotated[float, Bounds(0.01, 0.25)] = 0.12
    """Largest grade of a street (rise over run); steeper land is smoothed and lowered."""
    keep_service: Flag = False
    """Include driveways and yards, each with its own crossing."""
    cycle_paths: Flag = False
    """Wheelchairs also drive on cycle paths beside the road, where the law allows it."""
    seed: int = 42
    """Seed of the demand, the parked cars and the hill."""
    source: str = ""
    """Origin of the extract or scenario, for the licence notice."""
    replace: Flag = False
    """Replace a town that was edited; all edits are lost."""
    json: OutFile = None
    """Write the result of the check to this file."""


def run(options: ImportOptions) -> int:
    """Import, check, and print the result; 0 when the town has no faults, else 1."""
    started_s = time.monotonic()
    out = options.out if options.out is not None else Path("scenarios/sumo") / options.name
    check_folder("--out", out)
    result = options.json.resolve() if options.json is not None else None  # this folder itself may be built anew
    clock = StageClock(_say)
    with _fresh_folders(out.parent):
        if options.sumocfg is None:
            report, more = _build(options, out, clock.begin)
        else:
            report, more = _adopt(options, options.sumocfg, out, clock.begin), dict[str, Any]()
    costs = clock.costs()
    code = print_report(report)
    stdout_console().print(costs_table(costs))
    if result is not None:
        write_json(result, {**report_json(report, time.monotonic() - started_s), **more, "cpu": costs_json(costs)})
    return code


def _adopt(options: ImportOptions, sumocfg: Path, out: Path, stage: Stage) -> TownReport:
    given = [f.name for f in fields(options) if getattr(options, f.name) != f.default]
    idle = [f"--{name.replace('_', '-')}" for name in given if name not in _ADOPTED]
    if idle:
        raise ConfigError(
            f"--sumocfg copies a scenario unchanged, so {', '.join(idle)} cannot be combined with it: leave one out"
        )
    if options.allow_outside:
        print(f"note: files outside of the folder of {sumocfg} are copied too; check {out} before you share it")
    named = options.name, out, options.split, options.source
    town = adopt_scenario(sumocfg, *named, outside=options.allow_outside, cycle_paths=options.cycle_paths)
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
    if options.allow_outside:
        raise ConfigError("--allow-outside is for --sumocfg: a map names no files; leave it out")
    box = _bbox(options.bbox) if options.bbox else None
    if options.osm is not None and not options.osm.is_file():
        raise ConfigError(f"--osm {options.osm}: there is no such file; expected an OpenStreetMap extract")
    if options.osm is not None and options.url:
        raise ConfigError("--url is for a download and cannot be combined with --osm; leave one out")
    _check_numbers(options)

    from wcsim.towns.importing.importer import import_town

    with tempfile.TemporaryDirectory(prefix="wcsim-osm-") as folder:
        osm = options.osm if options.osm is not None else download(_needed(box), Path(folder), options.url)
        made = import_town(_order(options, osm, box, out), _built, stage)
    print(f"wrote {made.town.folder}; open it with: sumo-gui -c {shlex.quote(str(made.town.sumocfg))}")
    print(f"traffic drives on the {made.side}")
    report = checked(made.town, made.walkable_share, stage)
    counted = ("parked", "crossings_mapped", "crossings_unpainted", "stops_mapped", "stops")
    more = {"left_out": asdict(made.left_out), **{name: getattr(made, name) for name in counted}}
    return replace(report, notes=(*made.notes, *report.notes)), more


def _built(town: Town) -> Street:
    from wcsim.towns.street import load_street

    return load_street(town, _say)


def _say(told: str) -> None:
    stderr_console().print(told, style="dim", markup=False, soft_wrap=True)


def _needed(box: Box | None) -> Box:
    if box is None:
        raise ConfigError("a download needs --bbox W,S,E,N")
    return box


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


def _check_numbers(options: ImportOptions) -> None:
    if options.lefthand and options.righthand:
        raise ConfigError("--lefthand and --righthand exclude each other; leave one out")
    if options.dem is not None and options.hill:
        raise ConfigError("--dem and --hill exclude each other; leave one out")


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


@contextmanager
def _fresh_folders(folder: Path) -> Iterator[None]:
    """Leave no empty folders behind when the block fails."""
    fresh = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        yield
    except BaseException:
        for place in fresh:
            if place.is_dir() and not any(place.iterdir()):
                place.rmdir()
        raise
