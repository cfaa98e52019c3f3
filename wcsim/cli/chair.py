"""`wcsim chair check | fit`: plants on the test rig, in the manner of ISO 7176; a controller fitted to drives."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich import box
from rich.table import Column, Table
from tyro.conf import Positional, arg

from wcsim.chair_check.row import FASTEST_HZ, SLOWEST_HZ, TICK_S, Change, Row, Setup, changes
from wcsim.cli.shared.common import (
    Bounds,
    Flag,
    Keys,
    OutFile,
    OutFolder,
    Repeated,
    Writes,
    check_folder,
    result_file,
    run_part,
    some_words,
    words_of,
    write_json,
)
from wcsim.cli.shared.consoles import show_table, stderr_console, stdout_console
from wcsim.config import ChairConfig, RunConfig, parse, resolve
from wcsim.config.plant import PlantFile, plant_path, read_plant
from wcsim.core.processes import run_in_pool
from wcsim.core.reading import SETTINGS, escaped, parse_toml, read_text
from wcsim.errors import ConfigError, check_installed
from wcsim.types import F64

if TYPE_CHECKING:  # loads the engine, which --help must not
    from wcsim.chair_check.drive_fit import DriveFit, MotionErrors
    from wcsim.chair_check.stick_drives import StickDrive

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
    """Run one of them; 1 when a row is outside its range, or changes too much with the rate."""
    return run_part(words, "chair", {"check": (_CheckOptions, _check), "fit": (_FitOptions, _fit)})


def _check(options: _CheckOptions) -> int:
    plants = some_words("--plants", options.plants)
    if options.pictures is not None:
        return _draw(plants, options.pictures)
    setups = {plant: _setup(plant, options) for plant in plants}
    return _compare(setups, options) if options.compare_hz else _judge(setups, options)


def _setup(plant: str, options: _CheckOptions) -> Setup:
    """The chair at the first rate that is asked for; what is left out of its table is said before the work."""
    from wcsim.chair_check.table import too_fast  # loads the engine, which --help must not

    hz = _rates(options.compare_hz)[0] if options.compare_hz else options.hz
    setup = _driving(plant, hz, options.set)
    fast = too_fast(setup, words_of(options.rows))
    if fast:
        print(f"note: {plant} is too slow for {', '.join(fast)}: left out", file=sys.stderr)
    return setup


def _driving(plant: str, hz: int, settings: Sequence[str] = ()) -> Setup:
    """A plant that is driven as its own file says, and as asked for besides."""
    config = resolve(RunConfig(), (f"chair.plant={json.dumps(plant)}", *settings))
    return Setup(chair=config.chair, imu=config.imu, hz=hz)


def _judge(setups: Mapping[str, Setup], options: _CheckOptions) -> int:
    found = {plant: _table(plant, setup, options) for plant, setup in setups.items()}
    for plant, rows in found.items():
        stdout_console().print(_shown(plant, rows))
        for line in _remarks(rows):
            print(line)
    write_json(
        options.json, {"plants": {plant: {"rows": _plain(rows)} for plant, rows in found.items()}}
    )
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
        return table(
            setup,
            words_of(options.rows),
            options.workers,
            lambda name: status.update(f"{what}: {name}"),
        )


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
        verdict = (
            ("" if row.judged else "not judged")
            if row.ok
            else "[bold red]RED[/]"
            if row.red
            else "other"
        )
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
    return Table(
        name,
        title=title,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )


_HZ_OF_FIT = 120
_CHAIR = re.compile(r"(?ms)^\[chair\][^\n]*\n?(.*?)(?=^\[|\Z)")
_LATE_TICKS = 4  # of world.action_delay_ticks that are tried, from 0 on


@dataclass
class _FitOptions:
    """Fit the controller's numbers to recorded drives of a chair; say how well they repeat the drives."""

    drives: Annotated[tuple[Path, ...], Positional, arg(metavar="NAME.joy.csv [...]")]
    """Recorded sticks (t_s,axis0,axis1), each beside its NAME.odom.csv (t_s,v_mps,w_radps); .gz may follow."""
    hold_out: str = ""
    """Words of file names, whole between _ . and -, separated by commas: a fit leaves out the drives of each."""
    base: str = "rwd"
    """Chair (plant) for --plant and --out."""
    plant: Flag = False
    """Drive that chair in PyBullet by the sticks, with the fitted numbers."""
    picture: Annotated[Path | None, arg(metavar="FILE"), Writes()] = None
    """Draw the longest drive, measured and simulated: .png or .svg."""
    out: Annotated[Path | None, arg(metavar="FILE.toml"), Writes(".toml", new=True)] = None
    """Write that chair with the fitted numbers, for chair.plant."""
    json: OutFile = None
    """Write the result to this file."""


def _fit(options: _FitOptions) -> int:
    """Fit, compare, print, write."""
    if not options.drives:
        raise ConfigError("chair fit got no file; expected recorded drives, such as walk.joy.csv")
    if options.picture is not None:
        if options.picture.suffix not in (".png", ".svg"):
            raise ConfigError(
                f"--picture {escaped(options.picture)}: expected a name that ends in .png or .svg"
            )
        check_installed("--picture needs matplotlib", "report", "matplotlib")
    read_plant(options.base)
    chair = _driving(options.base, _HZ_OF_FIT).chair
    from wcsim.chair_check.drive_fit import DELAY_S, fit_drives, later, law_motion, motion_errors
    from wcsim.chair_check.stick_drives import read_stick_drives

    drives = read_stick_drives(options.drives)
    left_out = _errors_left_out(drives, options.hold_out)
    with stderr_console().status("fitting"):
        fit = fit_drives(drives)
    was, made = {**dict(chair), DELAY_S: 0.0}, {"law": law_motion(drives, fit.values)}
    errors = {
        "all, fitted": motion_errors(drives, made["law"]),
        f"all, as {options.base} is set": motion_errors(drives, law_motion(drives, was)),
        **left_out,
    }
    rounded = {name: float(f"{value:.4g}") for name, value in fit.values.items() if name != DELAY_S}
    own = chair.model_copy(update=rounded | {"profile": "custom"})
    ridden = _ridden(drives, own) if options.plant else []
    for ticks in range(_LATE_TICKS) if ridden else ():
        late = [later(motion, ticks * TICK_S) for motion in ridden]
        errors[f"{options.base}, {ticks} ticks late"] = motion_errors(drives, late)
    if ridden:
        made[f"{options.base} in PyBullet"] = [
            later(motion, fit.values[DELAY_S]) for motion in ridden
        ]
    _print_fit(fit, was, errors)
    if options.picture is not None:
        _draw_fit(options.picture, drives, made)
    if options.out is not None:
        told = f"fitted to {len(drives)} drives; from stick to wheels {fit.values[DELAY_S]:.2f} s"
        _write_plant(options.out, own, rounded, told)
    numbers = {name: [value, *fit.intervals.get(name, ())] for name, value in fit.values.items()}
    write_json(
        options.json,
        {"numbers": numbers, "errors": {name: asdict(item) for name, item in errors.items()}},
    )
    return 0


def _errors_left_out(drives: Sequence[StickDrive], words: str) -> dict[str, MotionErrors]:
    """Errors on the drives in whose names each word is, by the fit to the rest; and all of them together.

    Raises ConfigError where a word, whole between `_`, `.` and `-`, is in no name, or in all.
    """
    from wcsim.chair_check.drive_fit import fit_drives, law_motion, motion_errors

    parts, found = {}, {}
    for word in words_of(words):
        whole = re.compile(rf"(^|[_.-]){re.escape(word)}($|[_.-])")
        parts[word] = [whole.search(drive.name) is not None for drive in drives]
        if not 0 < sum(parts[word]) < len(drives):
            told = f"--hold-out {word!r} is a word of {sum(parts[word])} of {len(drives)} names"
            raise ConfigError(f"{told}; expected some, not all")
    driven: list[StickDrive] = []
    moved: list[F64] = []
    for word, out in parts.items():
        left, rest = [*compress(drives, out)], [*compress(drives, [not gone for gone in out])]
        with stderr_console().status(f"fitting without {word}"):
            motions = law_motion(left, fit_drives(rest, draws=0).values)
        found[f"{word}, left out"] = motion_errors(left, motions)
        driven, moved = [*driven, *left], [*moved, *motions]
    return {**found, "each left out": motion_errors(driven, moved)} if parts else {}


def _ridden(drives: Sequence[StickDrive], chair: ChairConfig) -> list[F64]:
    """What the whole chair does in PyBullet, of each drive."""
    from wcsim.chair_check.drive_fit import plant_motion

    with stderr_console().status(f"driving {chair.plant} in PyBullet"):
        found = dict(
            run_in_pool(
                partial(plant_motion, setup=Setup(chair=chair, hz=_HZ_OF_FIT)), drives, _WORKERS
            )
        )
    return [found[place] for place in range(len(drives))]


def _print_fit(fit: DriveFit, was: Mapping[str, float], errors: Mapping[str, MotionErrors]) -> None:
    numbers = []
    for name, value in fit.values.items():
        span = [f"{number:.4g}" for number in fit.intervals.get(name, ())] or ["-", "-"]
        numbers.append((name, f"{value:.4g}", *span, f"{was[name]:.4g}"))
    show_table(("number", "fitted", "95 % from", "to", "without"), numbers, box=box.SIMPLE_HEAD)
    rows = []
    for name, item in errors.items():
        shares = (f"{share:.1%}" for share in (item.speed_explained, item.turn_explained))
        rows.append((name, f"{item.speed_rms_mps:.3f}", f"{item.turn_rms_radps:.3f}", *shares))
    show_table(
        ("drives", "m/s rms", "rad/s rms", "speed explained", "turn"), rows, box=box.SIMPLE_HEAD
    )


def _draw_fit(path: Path, drives: Sequence[StickDrive], made: Mapping[str, Sequence[F64]]) -> None:
    """The longest drive."""
    from wcsim.chair_check.stick_drives import STEP_S
    from wcsim.view.report.figures import motion_chart  # loads matplotlib

    place = max(range(len(drives)), key=lambda k: len(drives[k].motion))
    shown = {name: motions[place] for name, motions in made.items()}
    with result_file(path) as part:
        motion_chart(part, path.suffix[1:], drives[place].name, STEP_S, drives[place].motion, shown)


def _write_plant(path: Path, own: ChairConfig, numbers: Mapping[str, float], head: str) -> None:
    """The plant's file with these numbers in its [chair]. Raises ConfigError where they are beyond its limits."""
    from wcsim.physics.wheelchair.plant import plant_spec  # loads the engine, which --help must not

    plant_spec(own)
    text = read_text(plant_path(own.plant), SETTINGS)
    table = _CHAIR.search(text)
    begin, end = table.span() if table else (len(text), len(text))
    kept = re.sub(
        rf"(?m)^[ \t]*({'|'.join(numbers)}|profile)[ \t]*=.*\n?", "", table[1] if table else ""
    )
    lines = [
        text[:begin].rstrip(),
        "",
        f"[chair] # {head}",
        *(f"{name} = {value:g}" for name, value in numbers.items()),
    ]
    made, where = (
        "\n".join([*lines, kept + text[end:]]).rstrip() + "\n",
        f"{escaped(own.plant)} with a new [chair]",
    )
    parse(PlantFile, parse_toml(made, where, SETTINGS), where)
    with result_file(path) as part:
        part.write_text(made, encoding="utf-8")
    print(f"wrote {path}; drive it: --set chair.plant={path}")
