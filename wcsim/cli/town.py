"""`wcsim town import | list | check`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Column, Table

from wcsim.cli.common import OutFile, OutFolder, check_folder, parse, subcommand, write_json
from wcsim.errors import ConfigError
from wcsim.towns.check import TownReport, check_town
from wcsim.towns.importer import ImportOrder, import_town
from wcsim.towns.town import find_town, list_towns


@dataclass
class ImportOptions:
    """Import a town from an OpenStreetMap extract: streets, pavements, buildings, trees, and endless traffic."""

    osm: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """The extract: .osm, .osm.xml or .osm.xml.gz."""
    bbox: str
    """What to keep of it, in degrees: west,south,east,north."""
    name: str
    """The town's name."""
    split: Literal["train", "test"] = "train"
    """Whether networks may be trained in it, or only tested."""
    out: OutFolder = None
    """Where to put it; default ./scenarios/sumo/NAME."""
    lefthand: bool = False
    """Traffic drives on the left."""
    seed: int = 42
    """Seed of the demand."""
    source: str = ""
    """Where the extract comes from, for the licence notice."""


@dataclass
class ListOptions:
    """List the towns that can be named."""


@dataclass
class CheckOptions:
    """Check a town: can it be walked through, does its traffic find its way, is the ground without holes."""

    town: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TOWN")]
    """A town's name or folder."""
    json: OutFile = None
    """Write the result to this file."""


def run(words: list[str]) -> int:
    """Run one of the subcommands."""
    name = subcommand(words, "town", {"import": ImportOptions, "list": ListOptions, "check": CheckOptions})
    if name == "import":
        return _import(parse(ImportOptions, words[1:], "town import"))
    if name == "list":
        parse(ListOptions, words[1:], "town list")
        return _list()
    return _check(parse(CheckOptions, words[1:], "town check")) if name else 0


def _import(options: ImportOptions) -> int:
    out = options.out if options.out is not None else Path("scenarios/sumo") / options.name
    bbox = _bbox(options.bbox)
    check_folder("--out", out)
    if not options.osm.is_file():
        raise ConfigError(f"--osm {options.osm}: there is no such file; expected an OpenStreetMap extract (.osm[.gz])")
    with _fresh_folders(out.parent):
        town = import_town(
            ImportOrder(
                osm=options.osm,
                bbox=bbox,
                name=options.name,
                split=options.split,
                out=out,
                lefthand=options.lefthand,
                seed=options.seed,
                source=options.source,
            )
        )
    print(f"wrote {town.folder}; open it with: sumo-gui -c {town.sumocfg}")
    return _report(check_town(town))


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


def _list() -> int:
    table = Table("town", "split", Column("folder", overflow="fold"))
    for town in list_towns():
        table.add_row(town.name, town.split, str(town.folder))
    Console().print(table)
    return 0


def _check(options: CheckOptions) -> int:
    report = check_town(find_town(options.town))
    code = _report(report)
    if options.json is not None:
        write_json(
            options.json,
            {
                "town": report.town,
                "crossings": report.crossings,
                "walkingareas": report.walkingareas,
                "walkable_largest_share": report.walkable_largest_share,
                "classes": list(report.classes),
                "unroutable": report.unroutable,
                "mesh_faults": report.mesh_faults,
                "cures": list(report.cures),
            },
        )
    return code


def _report(report: TownReport) -> int:
    table = Table(f"town {report.town}", "")
    table.add_row("crossings", str(report.crossings))
    table.add_row("walking areas", str(report.walkingareas))
    table.add_row("walkable area in the largest connected part", f"{report.walkable_largest_share:.3f}")
    table.add_row("classes in the demand", ", ".join(report.classes))
    table.add_row("trips that find no way", str(report.unroutable))
    table.add_row("faults in the mesh", str(report.mesh_faults))
    console = Console()
    console.print(table)
    for cure in report.cures:
        console.print(f"cure: {cure}", markup=False, highlight=False)
    return 0


def _bbox(text: str) -> tuple[float, float, float, float]:
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"--bbox {text!r} is not west,south,east,north in degrees, as 24.9,60.1,25.0,60.2") from None
    if not (-180 <= west < east <= 180 and -90 <= south < north <= 90):
        raise ConfigError(f"--bbox {text!r} is empty or leaves the globe; expected west < east and south < north")
    return west, south, east, north
