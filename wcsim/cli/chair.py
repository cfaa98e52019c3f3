"""`wcsim chair check`: each plant on the test rig, a table in the manner of ISO 7176."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from rich import box
from rich.table import Column, Table

from wcsim.chair_check.row import FASTEST_HZ, SLOWEST_HZ, Change, Row, Setup, changes
from wcsim.cli.shared.common import (
    Bounds,
    Keys,
    OutFile,
    OutFolder,
    Repeated,
    check_folder,
    run_part,
    some_words,
    words_of,
    write_json,
)
from wcsim.cli.shared.consoles import stderr_console, stdout_console
from wcsim.config import RunConfig, resolve
from wcsim.errors import ConfigError

_WORKERS = 2
_HZ = Bounds(SLOWEST_HZ, FASTEST_HZ, 10)
_SET = Keys({"chair.plant": "--plants names the plants"}, ("chair", "imu"))
_MEANS = {
    "norm": "the chair does not meet a standard (EN 12184)",
    "file": "the file contradicts itself, or the simulation does not match it",
    "stick": "motors or grip are too weak for the stick's command with these settings",
    "wcsim": "a limit of wcsim's own, for which its streets and rewards are made",
    "rwd, mwd": "its impacts differ from those of the original chair",
    "trial": "it does not fall off kerbs like the chair in the experiment",
}
_OTHER = "measured with another kind of chair; a difference is not an error"


@dataclass
class _CheckOptions:
    """Test each chair in the manner of ISO 7176: driving, climbing, weight, tipping; compare with expected values."""

    plants: str = "rwd,mwd"
    """Chairs (plants) to test: names or paths of .toml files, separated by commas."""
    hz: Annotated[int, _HZ] = 120
    """Rate of the physics, a multiple of 10."""
    rows: str = ""
    """Only rows whose names start with one of these words, separated by commas."""
    compare_hz: str = ""
    """Physics rates to compare instead, such as 120,240,480."""
    workers: Annotated[int, Bounds(1, 64)] = _WORKERS
    """Processes that share the work."""
    pictures: OutFolder = None
    """Draw each chair into this folder instead."""
    set: Annotated[Repeated, _SET] = ()
    """A setting of [chair] or [imu], such as chair.v_max_mps=1.2."""
    json: OutFile = None
    """Write the result to this file."""


def run(words: list[str]) -> int:
    """Run it; 1 when a row is outside its range, or changes too much with the rate."""
    return run_part(words, "chair", {"check": (_CheckOptions, _check)})


def _check(options: _CheckOptions) -> int:
    plants = some_words("--plants", options.plants)
    if options.pictures is not None:
        return _draw(plants, options.pictures)
    config = resolve(RunConfig(), options.set)
    setups = {plant: _setup(config, plant, options) for plant in plants}
    return _compare(setups, options) if options.compare_hz else _judge(setups, options)


def _setup(config: RunConfig, plant: str, options: _CheckOptions) -> Setup:
    """The chair at the first rate that is asked for; what is left out of its table is said before the work."""
    from wcsim.chair_check.table import too_fast  # loads the engine, which --help must not

    hz = _rates(options.compare_hz)[0] if options.compare_hz else options.hz
    setup = Setup(chair=config.chair.model_copy(update={"plant": plant}), imu=config.imu, hz=hz)
    fast = too_fast(setup, words_of(options.rows))
    if fast:
        print(f"note: {plant} is too slow for {', '.join(fast)}: left out", file=sys.stderr)
    return setup


def _judge(setups: Mapping[str, Setup], options: _CheckOptions) -> int:
    found = {plant: _table(plant, setup, options) for plant, setup in setups.items()}
    for plant, rows in found.items():
        stdout_console().print(_shown(plant, rows))
        for line in _remarks(rows):
            print(line)
    write_json(options.json, {"plants": {plant: {"rows": _plain(rows)} for plant, rows in found.items()}})
    return 1 if any(row.red for rows in found.values() for row in rows) else 0


def _compare(setups: Mapping[str, Setup], options: _CheckOptions) -> int:
    rates = _rates(options.compare_hz)
    found = {
        plant: changes({hz: _table(plant, replace(setup, hz=hz), options) for hz in rates})
        for plant, setup in setups.items()
    }
    for plant, rows in found.items():
        stdout_console().print(_compared(plant, rates, rows))
    plain = {plant: {"rows": [asdict(row) for row in rows]} for plant, rows in found.items()}
    write_json(options.json, {"hz": rates, "plants": plain})
    return 0 if all(row.ok for rows in found.values() for row in rows) else 1


def _draw(plants: Sequence[str], folder: Path) -> int:
    from wcsim.chair_check.plant_picture import draw_plant

    check_folder("--pictures", folder)
    for plant in plants:
        print(draw_plant(plant, folder))
    return 0


def _table(plant: str, setup: Setup, options: _CheckOptions) -> list[Row]:
    from wcsim.chair_check.table import table  # loads the engine, which --help must not

    what = f"{plant} at {setup.hz} Hz"
    with stderr_console().status(what) as status:
        return table(setup, words_of(options.rows), options.workers, lambda name: status.update(f"{what}: {name}"))


def _rates(text: str) -> list[int]:
    try:
        rates = [int(word) for word in some_words("--compare-hz", text)]
    except ValueError:
        raise ConfigError(
            f"--compare-hz {text!r}: expected whole numbers separated by commas, such as 120,240"
        ) from None
    if len(set(rates)) < 2:
        raise ConfigError(f"--compare-hz {text!r}: expected at least two different rates")
    for rate in rates:
        _HZ.check("--compare-hz", rate)
    return rates


def _plain(rows: Sequence[Row]) -> list[dict[str, Any]]:
    return [{key: value for key, value in asdict(row).items() if key != "impact"} for row in rows]


def _shown(plant: str, rows: Sequence[Row]) -> Table:
    judged = [row for row in rows if row.judged]
    out = _frame(f"{plant}: {sum(row.ok for row in judged)} of {len(judged)} rows as expected")
    for heading in ("value", "low", "high"):
        out.add_column(heading, justify="right")
    for heading in ("unit", "bound by", ""):
        out.add_column(heading)
    for row in rows:
        numbers = (f"{number:.4g}" for number in (row.value, row.low, row.high))
        verdict = ("" if row.judged else "not judged") if row.ok else "[bold red]RED[/]" if row.red else "other"
        out.add_row(row.name, *numbers, row.unit, row.bound, verdict)
    return out


def _remarks(rows: Sequence[Row]) -> list[str]:
    """What happened in rows whose value does not say it, and what a row out of its range means, by who bounds it."""
    said = [f"{row.name}: {row.note}" for row in rows if row.note]
    red = dict.fromkeys(row.bound for row in rows if row.red)
    other = dict.fromkeys(row.bound for row in rows if not row.ok and not row.red)
    return [
        *said,
        *(f"RED, bound by {bound}: {_MEANS[bound]}" for bound in red),
        *(f"other, bound by {bound}: {_OTHER}" for bound in other),
    ]


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
