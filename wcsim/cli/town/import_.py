"""New towns: `wcsim town import` of a map or a scenario, `make` from a seed, `pave` of a copy."""

from __future__ import annotations

import math
import os
import shlex
import shutil
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from tyro.conf import Positional, arg, create_mutex_group

from wcsim.cli.shared.common import (
    Bounds,
    Flag,
    InFile,
    OutFile,
    OutFolder,
    TownWord,
    remove_folders_on_failure,
    require_writable_folder,
    split_comma_list,
)
from wcsim.cli.shared.consoles import print_note
from wcsim.cli.town.town_check import check_town_with_sumo, print_town_report, try_town_in_sumo
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import pluralize
from wcsim.errors import ConfigError
from wcsim.towns.checks.cures import FASTEST_MPS
from wcsim.towns.importing.adopt import adopt_scenario
from wcsim.towns.importing.folder_texts import check_words
from wcsim.towns.making.asked_town import Wishes, check_town_properties
from wcsim.towns.osm.read import Box, download
from wcsim.towns.scenario.town import find_town, open_town

if TYPE_CHECKING:  # loads what builds streets, which --help must not
    from wcsim.towns.checks.check import TownReport
    from wcsim.towns.pave.pavements import Paved

_TOWNS: Final = Path("scenarios/sumo")
_MOST_MOVED: Final = 5  # positions that are printed
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
class ScenarioImportOptions(_TownOptions):
    """Import a town from a SUMO scenario, whose files are copied unchanged.

    Ends with 0 when the town has no faults (notes are none), 1 when it has, 2 when none was made.
    """

    sumocfg: Annotated[Path, arg(metavar="FILE")]
    """The scenario."""
    allow_outside: Flag = False
    """Also copy files that the scenario names outside of its folder."""


@dataclass(kw_only=True)
class XodrImportOptions(_TownOptions):
    """Import a town from an OpenDRIVE map, with its sidewalks, and guessed pavements elsewhere.

    Ends with 0 when the town has no faults (notes are none), 1 when it has, 2 when none was made.
    """

    opendrive: Annotated[Path, arg(metavar="FILE")]
    """The map: .xodr, plain or .gz."""
    traffic: Annotated[float, Bounds(0.0, 10.0)] = 1.0
    """Factor for all traffic; 0 for none."""
    seed: int = 42
    """Seed of the demand."""
    replace: Flag = False
    """Replace a town that was edited; all edits are lost."""


@dataclass(kw_only=True)
class OsmImportOptions(_TownOptions):
    """Import a town from OpenStreetMap, a SUMO scenario or an OpenDRIVE map.

    `wcsim town import --sumocfg FILE -h` has the options for a scenario, `--opendrive FILE -h`
    those for OpenDRIVE.
    Ends with 0 when the town has no faults (notes are none), 1 when it has, 2 when none was made.
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
    """Departures per hour by SUMO vehicle class, e.g. passenger=900,bicycle=300; other classes keep their density."""  # noqa: E501
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


@dataclass
class TownMakeOptions:
    """Generate a town from a seed, without a map.

    Ends with 0 when the town has no faults (notes are none), 1 when it has, 2 when none was made.
    """

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


@dataclass
class TownPaveOptions:
    """Copy a scenario into a folder and add pavements and crossings.

    Ends with 0 when the town has no faults (notes are none), 1 when it has, 2 when none was made.
    """

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


def run(options: ScenarioImportOptions | XodrImportOptions | OsmImportOptions) -> int:
    """Import, check, and print the result; 0 when the town has no faults, else 1."""
    started_s = time.monotonic()
    out = options.out or _TOWNS / options.name
    require_writable_folder("--out", out)
    # The import may replace the working folder itself.
    json = options.json and options.json.resolve()
    more: dict[str, Any] = {}
    with remove_folders_on_failure(out.parent):
        if isinstance(options, ScenarioImportOptions):
            report = _adopt(options, out)
        elif isinstance(options, XodrImportOptions):
            report = _convert(options, out)
        else:
            report, more = _build(options, out)
    return print_town_report(report, started_s, json, **more)


def _adopt(options: ScenarioImportOptions, out: Path) -> TownReport:
    """Copy a scenario and check the copy."""
    if options.allow_outside:
        print(
            f"note: files outside of the folder of {options.sumocfg} are copied too; "
            f"check {out} before you share it"
        )
    town = adopt_scenario(
        options.sumocfg,
        options.name,
        out,
        options.split,
        options.source,
        outside=options.allow_outside,
        cycle_paths=options.cycle_paths,
    )
    try:
        report = check_town_with_sumo(town, show=print_note)
    except BaseException:
        # What cannot be read is no town.
        shutil.rmtree(town.folder, ignore_errors=True)
        raise
    _print_written(town.folder, town.sumocfg)
    return report


def _convert(options: XodrImportOptions, out: Path) -> TownReport:
    """Build a town from an OpenDRIVE map and check it."""
    # It loads what builds streets, which --help must not.
    from wcsim.towns.importing.importer import ImportOrder, import_opendrive

    order = ImportOrder(
        map_file=options.opendrive,
        opendrive=True,
        name=options.name,
        split=options.split,
        out=out,
        seed=options.seed,
        traffic=options.traffic,
        cycle_paths=options.cycle_paths,
        source=options.source,
        overwrite=options.replace,
    )
    town, notes = import_opendrive(order, print_note)
    _print_written(town.folder, town.sumocfg)
    report = check_town_with_sumo(town, show=print_note)
    return replace(report, notes=(*notes, *report.notes))


def _build(options: OsmImportOptions, out: Path) -> tuple[TownReport, dict[str, Any]]:
    """Build a town from a map and check it; also what else goes into the result file."""
    # 1. Refuse what cannot be used, before streets are built.
    if options.osm is None and not options.bbox:
        raise ConfigError(
            "town import needs a source: --osm FILE, --bbox W,S,E,N to download an area, "
            "--opendrive FILE or --sumocfg FILE"
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

    from wcsim.towns.importing.elevation import Heights
    from wcsim.towns.importing.importer import ImportOrder, import_town
    from wcsim.towns.street import load_street

    # 2. Download the map where there is no file, and build.
    with create_temporary_folder() as folder:
        order = ImportOrder(
            map_file=options.osm or download(_bbox(options.bbox), folder, options.url),
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
        made = import_town(order, lambda town: load_street(town, print_note), print_note)
    _print_written(made.town.folder, made.town.sumocfg)
    print(f"traffic drives on the {made.side}")
    # 3. Check it.
    report = check_town_with_sumo(made.town, made.walkable_share, print_note)
    more = {"left_out": asdict(made.left_out), **made.counts}
    return replace(report, notes=(*made.notes, *report.notes)), more


def _per_hour(text: str) -> dict[str, float]:
    found: dict[str, float] = {}
    for word in split_comma_list(text):
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
        return Box.of(text)
    except ValueError:
        raise ConfigError(
            f"--bbox {text!r} is not west,south,east,north in degrees, such as 24.9,60.1,25.0,60.2"
        ) from None


def run_town_make(options: TownMakeOptions) -> int:
    """Generate, check, and print the result; 0 when the town has no faults, else 1."""
    started_s = time.monotonic()
    out = options.out or _TOWNS / options.name
    requested = Wishes(
        size_m=options.size,
        kind="" if options.kind == "any" else options.kind,
        split=options.split,
        traffic=options.traffic,
        parked=options.parked,
        hill_m=options.hill,
    )
    check_words(options.name, options.split)
    check_town_properties(options.seed, requested)
    require_writable_folder("--out", out)
    # It may replace the working folder itself.
    json = options.json and options.json.resolve()

    from wcsim.towns.making.maker import make_town  # loads what builds streets

    town = make_town(
        out, options.seed, requested, name=options.name, overwrite=options.replace, stage=print_note
    )
    _print_written(town.folder, town.sumocfg)
    return print_town_report(check_town_with_sumo(town, show=print_note), started_s, json)


def run_town_pave(options: TownPaveOptions) -> int:
    """Pave a copy, let SUMO try it, check it; 0 when the copy has no faults, else 1."""
    started_s = time.monotonic()
    require_writable_folder("--out", options.out)
    bare = find_town(options.town, outside=options.allow_outside)

    from wcsim.towns.checks.check import check_town  # loads what builds streets
    from wcsim.towns.pave.pavements import pave_town

    print_note(f"adding pavements in {options.out}")
    paved = pave_town(bare, options.out, options.max_speed)
    # Opened as the scenario was: by the folder whose town.toml names its place, or as it is.
    depth = len(Path(os.path.relpath(bare.sumocfg, bare.folder)).parts)
    place = paved.sumocfg if depth == 1 else paved.sumocfg.parents[depth - 1]
    town = open_town(place, outside=options.allow_outside)
    print_note("testing the first steps in SUMO")
    try_town_in_sumo(town)
    print_note("checking the copy")
    report = check_town(town, faster=paved.faster)
    _print_paved(paved)
    result = {**asdict(paved), "sumocfg": str(paved.sumocfg)}
    return print_town_report(report, started_s, options.json, paved=result)


def _print_paved(paved: Paved) -> None:
    _print_written(paved.sumocfg, paved.sumocfg)
    streets = []
    if paved.streets or not paved.had:
        streets.append(f"{pluralize(paved.streets, 'street')} got a pavement")
    if paved.had:
        streets.append(f"{pluralize(paved.had, 'street')} already had one")
    print(
        f"{', '.join(streets)}; added {pluralize(paved.crossings, 'crossing')} and "
        f"{pluralize(paved.walkingareas, 'walking area')}; checked "
        f"{pluralize(paved.placed, 'element')} on lanes (stops, detectors, ...) and "
        f"{pluralize(paved.programs, 'signal program')}"
    )
    if paved.moved_m:
        positions = pluralize(len(paved.moved_m), "position")
        print(f"{positions} moved off junctions that grew; the farthest, in m:")
        for name, along_m in paved.moved_m[:_MOST_MOVED]:
            print(f"  {name}: {along_m:.2f}")
    for note in paved.notes:
        print(f"note: {note}")


def _print_written(place: Path, sumocfg: Path) -> None:
    print(f"wrote {place}; open it with: sumo-gui -c {shlex.quote(str(sumocfg))}")
