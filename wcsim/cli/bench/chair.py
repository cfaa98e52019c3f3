"""`wcsim bench chair`: each plant on the test yard, a table in the manner of ISO 7176."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Column, Table

from wcsim.bench.chair.compare import Change, changes
from wcsim.bench.chair.row import FASTEST_HZ, SLOWEST_HZ, Row
from wcsim.cli.shared.common import OutFile, OutFolder, check_folder, in_bounds, some_words, words_of, write_json
from wcsim.errors import ConfigError

_WORKERS = 2


@dataclass
class ChairOptions:
    """What each plant drives, climbs, bears and how it tips, beside what is expected."""

    plants: str = "rwd,mwd"
    """Plants to try, by name or as the path of a .toml file, joined by commas."""
    hz: int = 120
    """Rate of the physics, a multiple of 10."""
    rows: str = ""
    """Only rows whose names begin with one of these words, joined by commas."""
    compare_hz: str = ""
    """Rates to compare instead, joined by commas, as 120,240,480."""
    workers: int = _WORKERS
    """Processes that share the work."""
    pictures: OutFolder = None
    """Draw each plant into this folder instead."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: ChairOptions) -> int:
    """Run the bench; 1 when a row is outside its range, or changes too much with the rate."""
    in_bounds("--workers", options.workers, 1, 64)
    plants = some_words("--plants", options.plants)
    if options.pictures is not None:
        return _draw(plants, options.pictures)
    return _compare(plants, options) if options.compare_hz else _bench(plants, options)


def _bench(plants: Sequence[str], options: ChairOptions) -> int:
    _check_hz("--hz", options.hz)
    found = {plant: _table(plant, options.hz, options) for plant in plants}
    for plant, rows in found.items():
        Console().print(_shown(plant, rows))
    if options.json is not None:
        write_json(options.json, {"plants": {plant: {"rows": _plain(rows)} for plant, rows in found.items()}})
    return 0 if all(row.ok for rows in found.values() for row in rows) else 1


def _compare(plants: Sequence[str], options: ChairOptions) -> int:
    rates = _rates(options.compare_hz)
    found = {plant: changes({hz: _table(plant, hz, options) for hz in rates}) for plant in plants}
    for plant, rows in found.items():
        Console().print(_compared(plant, rates, rows))
    if options.json is not None:
        plain = {plant: {"rows": [asdict(row) for row in rows]} for plant, rows in found.items()}
        write_json(options.json, {"hz": rates, "plants": plain})
    return 0 if all(row.ok for rows in found.values() for row in rows) else 1


def _draw(plants: Sequence[str], folder: Path) -> int:
    from wcsim.bench.chair.plant_picture import draw_plant

    check_folder("--pictures", folder)
    for plant in plants:
        print(draw_plant(plant, folder))
    return 0


def _table(plant: str, hz: int, options: ChairOptions) -> list[Row]:
    from wcsim.bench.chair.rows.table import table  # loads the engine, which --help must not

    with Console(stderr=True).status(f"{plant} at {hz} Hz") as status:
        return table(
            plant,
            hz,
            words_of(options.rows),
            options.workers,
            lambda name: status.update(f"{plant} at {hz} Hz: {name}"),
        )


def _rates(text: str) -> list[int]:
    try:
        rates = [int(word) for word in some_words("--compare-hz", text)]
    except ValueError:
        raise ConfigError(f"--compare-hz {text!r}: expected whole numbers joined by commas, as 120,240") from None
    if len(set(rates)) < 2:
        raise ConfigError(f"--compare-hz {text!r}: expected two different rates or more")
    for rate in rates:
        _check_hz("--compare-hz", rate)
    return rates


def _check_hz(option: str, hz: int) -> None:
    in_bounds(option, hz, SLOWEST_HZ, FASTEST_HZ)
    if hz % 10:
        raise ConfigError(f"{option} {hz}: expected a multiple of 10")


def _plain(rows: Sequence[Row]) -> list[dict[str, Any]]:
    return [{key: value for key, value in asdict(row).items() if key != "impact"} for row in rows]


def _shown(plant: str, rows: Sequence[Row]) -> Table:
    out = _frame(f"{plant}: {sum(row.ok for row in rows)} of {len(rows)} rows as expected")
    for heading in ("value", "low", "high"):
        out.add_column(heading, justify="right")
    out.add_column("unit")
    out.add_column("")
    for row in rows:
        numbers = (f"{number:.4g}" for number in (row.value, row.low, row.high))
        out.add_row(row.name, *numbers, row.unit, "" if row.ok else "[bold red]RED[/]")
    return out


def _compared(plant: str, rates: Sequence[int], rows: Sequence[Change]) -> Table:
    out = _frame(f"{plant}: {sum(row.ok for row in rows)} of {len(rows)} rows change little")
    for rate in rates:
        out.add_column(f"{rate} Hz", justify="right")
    out.add_column("change", justify="right")
    out.add_column("")
    for row in rows:
        values = (f"{value:.4g}" for value in row.values)
        out.add_row(row.name, *values, f"{row.change:.1%}", "" if row.ok else "[bold red]RED[/]")
    return out


def _frame(title: str) -> Table:
    name = Column("row", overflow="fold")
    return Table(name, title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
