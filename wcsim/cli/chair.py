"""`wcsim chair check | fit`: plants on a test rig as in ISO 7176; a controller fitted to drives."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from rich import box
from rich.table import Column
from tyro.conf import Positional, arg

from wcsim.chair_check.row import (
    FASTEST_HZ,
    SLOWEST_HZ,
    TICK_S,
    RowComparison,
    TrialResult,
    TrialSetup,
    compare_rows,
)
from wcsim.cli.shared.common import (
    AllowedSettingKeys,
    Bounds,
    Flag,
    OutFile,
    OutFolder,
    Repeated,
    WritableFile,
    require_writable_folder,
    run_subcommand,
    split_comma_list,
    split_nonempty_list,
    write_json,
    write_result_atomically,
)
from wcsim.cli.shared.consoles import show_table, stderr_console
from wcsim.config import ChairConfig, RunConfig, parse, resolve
from wcsim.config.plant import PlantFile, find_plant_path, read_plant
from wcsim.core.processes import run_in_process_pool
from wcsim.core.reading import SETTINGS, escape, parse_toml, read_text
from wcsim.errors import ConfigError, check_installed
from wcsim.types import F64

if TYPE_CHECKING:  # loads the engine, which --help must not
    from wcsim.chair_check.drive_fit import DriveLawFit, MotionErrors
    from wcsim.chair_check.stick_drives import RecordedDrive

_WORKERS: Final = 2
_HZ: Final = Bounds(SLOWEST_HZ, FASTEST_HZ, 10)
_SET: Final = AllowedSettingKeys({"chair.plant": "--plants names the plants"}, ("chair", "imu"))
# What a row outside its range means, by the source of its bounds.
_MEANS: Final = {
    "norm": "the chair does not meet a standard (EN 12184)",
    "file": "the file contradicts itself, or the simulation does not match it",
    "stick": "motors or grip are too weak for the stick's command with these settings",
    "wcsim": "a limit of wcsim's own, for which its streets and rewards are made",
    "rwd, mwd": "its impacts differ from those of the original chair",
    "trial": "it does not fall off kerbs like the chair in the experiment",
}
_OTHER: Final = "measured with another kind of chair; a difference is not an error"
_FIT_HZ: Final = 120
# Values of world.action_delay_ticks that are tried, from 0 on.
_DELAYS_TICKS: Final = 4
_CHAIR_SECTION: Final = re.compile(r"(?ms)^\[chair\][^\n]*\n?(.*?)(?=^\[|\Z)")


@dataclass
class _CheckOptions:
    """Test each chair in the manner of ISO 7176: driving, climbing, weight, tipping; compare with expected values."""  # noqa: E501

    plants: str = "rwd,mwd"
    """Chairs (plants) to test: names or paths of .toml files, separated by commas."""
    hz: Annotated[int, _HZ] = 120
    """Rate of the physics, a multiple of 10."""
    rows: str = ""
    """Only rows whose names start with one of these words, separated by commas."""
    compare_hz: str = ""
    """Physics rates to compare instead, such as 120,240,480."""
    compare_rolling: Flag = False
    """Compare a chair in the engine with one that rolls without it where it can (world.rolling)."""
    workers: Annotated[int, Bounds(1, 64)] = _WORKERS
    """Processes that share the work."""
    pictures: OutFolder = None
    """Draw each chair into this folder instead."""
    set: Annotated[Repeated, _SET] = ()
    """A setting of [chair] or [imu], such as chair.v_max_mps=1.2."""
    json: OutFile = None
    """Write the result to this file."""


@dataclass
class _FitOptions:
    """Fit the controller's numbers to recorded drives of a chair; say how well they repeat the drives."""  # noqa: E501

    drives: Annotated[tuple[Path, ...], Positional, arg(metavar="NAME.joy.csv [...]")]
    """Recorded sticks (t_s,axis0,axis1), each beside its NAME.odom.csv (t_s,v_mps,w_radps); .gz may follow."""  # noqa: E501
    hold_out: str = ""
    """Words of file names, whole between _ . and -, separated by commas: a fit leaves out the drives of each."""  # noqa: E501
    base: str = "rwd"
    """Chair (plant) for --plant and --out."""
    plant: Flag = False
    """Drive that chair in PyBullet by the sticks, with the fitted numbers."""
    picture: Annotated[Path | None, arg(metavar="FILE"), WritableFile()] = None
    """Draw the longest drive, measured and simulated: .png or .svg."""
    out: Annotated[Path | None, arg(metavar="FILE.toml"), WritableFile(".toml", new=True)] = None
    """Write that chair with the fitted numbers, for chair.plant."""
    json: OutFile = None
    """Write the result to this file."""


def run(words: list[str]) -> int:
    """Run one of them; 1 when a row is outside its range, or changes too much with the rate."""
    return run_subcommand(
        words, "chair", {"check": (_CheckOptions, _check), "fit": (_FitOptions, _fit)}
    )


def _check(options: _CheckOptions) -> int:
    plants = split_nonempty_list("--plants", options.plants)
    if options.pictures is not None:
        from wcsim.chair_check.plant_picture import write_plant_picture

        require_writable_folder("--pictures", options.pictures)
        for plant in plants:
            print(write_plant_picture(plant, options.pictures))
        return 0
    from wcsim.chair_check.table import (
        list_too_fast_trials,  # loads the engine, which --help must not
    )

    setups = {}
    for plant in plants:
        hz = _rates(options.compare_hz)[0] if options.compare_hz else options.hz
        setups[plant] = _setup(plant, hz, options.set)
        # Before the work: what its table will leave out.
        fast = list_too_fast_trials(setups[plant], split_comma_list(options.rows))
        if fast:
            print(f"note: {plant} is too slow for {', '.join(fast)}: left out", file=sys.stderr)
    if options.compare_hz or options.compare_rolling:
        return _compare(setups, options)
    return _judge(setups, options)


def _setup(plant: str, hz: int, settings: Sequence[str] = ()) -> TrialSetup:
    """A plant with the settings of its own file, changed by `settings`."""
    config = resolve(RunConfig(), (f"chair.plant={json.dumps(plant)}", *settings))
    return TrialSetup(chair=config.chair, imu=config.imu, hz=hz)


def _judge(setups: Mapping[str, TrialSetup], options: _CheckOptions) -> int:
    """Measure all rows of each plant and print them against their ranges."""
    found = {plant: _measure(plant, setup, options) for plant, setup in setups.items()}
    plain: dict[str, Any] = {}
    for plant, rows in found.items():
        _show_judged(plant, rows)
        for row in rows:
            if row.note:
                print(f"{row.name}: {row.note}")
        for bound in dict.fromkeys(row.bound for row in rows if row.red):
            print(f"RED, bound by {bound}: {_MEANS[bound]}")
        for bound in dict.fromkeys(row.bound for row in rows if not row.ok and not row.red):
            print(f"other, bound by {bound}: {_OTHER}")
        plain_rows = [asdict(row) for row in rows]
        for row_json in plain_rows:
            del row_json["impact"]
        plain[plant] = {"rows": plain_rows}
    write_json(options.json, {"plants": plain})
    return 1 if any(row.red for rows in found.values() for row in rows) else 0


def _compare(setups: Mapping[str, TrialSetup], options: _CheckOptions) -> int:
    """Measure all rows of each plant several times and print how they change."""
    rates = _rates(options.compare_hz) if options.compare_hz else [options.hz]
    columns: dict[str, dict[str, Any]] = {f"{hz} Hz": {"hz": hz} for hz in rates}
    if options.compare_rolling:
        columns["rolling"] = {"hz": rates[0], "rolling": True}
    found = {
        plant: compare_rows(
            [_measure(plant, replace(setup, **changed), options) for changed in columns.values()]
        )
        for plant, setup in setups.items()
    }
    for plant, rows in found.items():
        _show_compared(plant, [*columns, "change"], rows)
    plain = {plant: {"rows": [asdict(row) for row in rows]} for plant, rows in found.items()}
    write_json(options.json, {"hz": rates, "plants": plain})
    return 0 if all(row.ok for rows in found.values() for row in rows) else 1


def _measure(plant: str, setup: TrialSetup, options: _CheckOptions) -> list[TrialResult]:
    from wcsim.chair_check.table import run_plant_trials  # loads the engine, which --help must not

    what = f"{plant} at {setup.hz} Hz"
    with stderr_console().status(what) as status:
        return run_plant_trials(
            setup,
            split_comma_list(options.rows),
            options.workers,
            lambda name: status.update(f"{what}: {name}"),
        )


def _rates(text: str) -> list[int]:
    try:
        rates = [int(word) for word in split_nonempty_list("--compare-hz", text)]
    except ValueError:
        raise ConfigError(
            f"--compare-hz {text!r}: expected whole numbers separated by commas, such as 120,240"
        ) from None
    if len(set(rates)) < 2:
        raise ConfigError(f"--compare-hz {text!r}: expected at least two different rates")
    for rate in rates:
        _HZ.check("--compare-hz", rate)
    return rates


def _show_compared(plant: str, headings: Sequence[str], rows: Sequence[RowComparison]) -> None:
    lines = []
    for row in rows:
        values = (f"{value:.4g}" for value in row.values)
        lines.append((row.name, *values, f"{row.change:.1%}", "" if row.ok else "RED"))
    title = f"{plant}: {sum(row.ok for row in rows)} of {len(rows)} rows change little"
    _show_rows(title, headings, ("",), lines)


def _show_judged(plant: str, rows: Sequence[TrialResult]) -> None:
    judged = [row for row in rows if row.judged]
    lines = []
    for row in rows:
        verdict = "other"
        if row.red:
            verdict = "RED"
        elif row.ok:
            verdict = "" if row.judged else "not judged"
        numbers = (f"{number:.4g}" for number in (row.value, row.low, row.high))
        lines.append((row.name, *numbers, row.unit, row.bound, verdict))
    title = f"{plant}: {sum(row.ok for row in judged)} of {len(judged)} rows as expected"
    _show_rows(title, ("value", "low", "high"), ("unit", "bound by", ""), lines)


def _show_rows(
    title: str, numbers: Sequence[str], texts: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    """Print rows with their names: columns of numbers, then columns of texts."""
    right = (Column(heading, justify="right") for heading in numbers)
    show_table(
        (Column("row", overflow="fold"), *right, *texts),
        rows,
        title=title,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )


def _fit(options: _FitOptions) -> int:
    """Fit, compare, print, write."""
    # 1. Refuse what cannot be used, before the engine is loaded.
    if not options.drives:
        raise ConfigError("chair fit got no file; expected recorded drives, such as walk.joy.csv")
    if options.picture is not None:
        if options.picture.suffix not in (".png", ".svg"):
            raise ConfigError(
                f"--picture {escape(options.picture)}: expected a name that ends in .png or .svg"
            )
        check_installed("--picture needs matplotlib", "report", "matplotlib")
    read_plant(options.base)
    chair = _setup(options.base, _FIT_HZ).chair
    from wcsim.chair_check.drive_fit import (
        DELAY_S,
        compute_motion_errors,
        delay_motion,
        fit_drive_law,
        simulate_drive_law,
    )
    from wcsim.chair_check.stick_drives import read_recorded_drives

    # 2. Fit; then compare the drives with the law as fitted, as set, and fitted to other drives.
    drives = read_recorded_drives(options.drives)
    left_out = _left_out_errors(drives, options.hold_out)
    with stderr_console().status("fitting"):
        fit = fit_drive_law(drives)
    as_set = {**dict(chair), DELAY_S: 0.0}
    motions = {"law": simulate_drive_law(drives, fit.values)}
    errors = {
        "all, fitted": compute_motion_errors(drives, motions["law"]),
        f"all, as {options.base} is set": compute_motion_errors(
            drives, simulate_drive_law(drives, as_set)
        ),
        **left_out,
    }
    # 3. The whole chair in PyBullet with the fitted numbers, which obeys some ticks late.
    rounded = {name: float(f"{value:.4g}") for name, value in fit.values.items() if name != DELAY_S}
    fitted = chair.model_copy(update=rounded | {"profile": "custom"})
    if options.plant:
        driven = _drive_plant(drives, fitted)
        for ticks in range(_DELAYS_TICKS):
            late = [delay_motion(motion, ticks * TICK_S) for motion in driven]
            errors[f"{options.base}, {ticks} ticks late"] = compute_motion_errors(drives, late)
        motions[f"{options.base} in PyBullet"] = [
            delay_motion(motion, fit.values[DELAY_S]) for motion in driven
        ]
    # 4. Print, draw, write.
    _print_fit(fit, as_set, errors)
    if options.picture is not None:
        _draw_longest(options.picture, drives, motions)
    if options.out is not None:
        note = f"fitted to {len(drives)} drives; from stick to wheels {fit.values[DELAY_S]:.2f} s"
        _write_plant(options.out, fitted, rounded, note)
    numbers = {name: [value, *fit.intervals.get(name, ())] for name, value in fit.values.items()}
    write_json(
        options.json,
        {"numbers": numbers, "errors": {name: asdict(item) for name, item in errors.items()}},
    )
    return 0


def _left_out_errors(drives: Sequence[RecordedDrive], words: str) -> dict[str, MotionErrors]:
    """Errors on the drives of each word, by a fit to the rest; then on all of these together.

    Raises:
        ConfigError: A word, whole between `_`, `.` and `-`, is in no name, or in all.
    """
    from wcsim.chair_check.drive_fit import compute_motion_errors, fit_drive_law, simulate_drive_law

    # All words are checked before the first fit.
    chosen: dict[str, list[bool]] = {}
    for word in split_comma_list(words):
        whole = re.compile(rf"(^|[_.-]){re.escape(word)}($|[_.-])")
        chosen[word] = [whole.search(drive.name) is not None for drive in drives]
        count = sum(chosen[word])
        if not 0 < count < len(drives):
            raise ConfigError(
                f"--hold-out {word!r} is a word of {count} of {len(drives)} names; "
                "expected some, not all"
            )
    errors: dict[str, MotionErrors] = {}
    all_left: list[RecordedDrive] = []
    all_motions: list[F64] = []
    for word, is_left_out in chosen.items():
        left = [*compress(drives, is_left_out)]
        rest = [*compress(drives, [not out for out in is_left_out])]
        with stderr_console().status(f"fitting without {word}"):
            motions = simulate_drive_law(left, fit_drive_law(rest, draws=0).values)
        errors[f"{word}, left out"] = compute_motion_errors(left, motions)
        all_left += left
        all_motions += motions
    if chosen:
        errors["each left out"] = compute_motion_errors(all_left, all_motions)
    return errors


def _drive_plant(drives: Sequence[RecordedDrive], chair: ChairConfig) -> list[F64]:
    """The motion of the whole chair in PyBullet, for each drive."""
    from wcsim.chair_check.drive_fit import simulate_plant_motion

    work = partial(simulate_plant_motion, setup=TrialSetup(chair=chair, hz=_FIT_HZ))
    with stderr_console().status(f"driving {chair.plant} in PyBullet"):
        found = dict(run_in_process_pool(work, drives, _WORKERS))
    return [found[place] for place in range(len(drives))]


def _print_fit(
    fit: DriveLawFit, as_set: Mapping[str, float], errors: Mapping[str, MotionErrors]
) -> None:
    numbers = []
    for name, value in fit.values.items():
        span = [f"{number:.4g}" for number in fit.intervals.get(name, ())] or ["-", "-"]
        numbers.append((name, f"{value:.4g}", *span, f"{as_set[name]:.4g}"))
    show_table(("number", "fitted", "95 % from", "to", "without"), numbers, box=box.SIMPLE_HEAD)
    rows = []
    for name, item in errors.items():
        shares = (f"{share:.1%}" for share in (item.speed_explained, item.turn_explained))
        rows.append((name, f"{item.speed_rms_mps:.3f}", f"{item.turn_rms_radps:.3f}", *shares))
    headings = ("drives", "m/s rms", "rad/s rms", "speed explained", "turn")
    show_table(headings, rows, box=box.SIMPLE_HEAD)


def _draw_longest(
    path: Path, drives: Sequence[RecordedDrive], motions: Mapping[str, Sequence[F64]]
) -> None:
    """Draw the longest drive, as measured and as simulated."""
    from wcsim.chair_check.stick_drives import STEP_S
    from wcsim.view.report.figures import motion_chart  # loads matplotlib

    place = max(range(len(drives)), key=lambda index: len(drives[index].motion))
    drive = drives[place]
    shown = {name: each[place] for name, each in motions.items()}
    with write_result_atomically(path) as part:
        motion_chart(part, path.suffix[1:], drive.name, STEP_S, drive.motion, shown)


def _write_plant(path: Path, own: ChairConfig, numbers: Mapping[str, float], note: str) -> None:
    """Write the plant's file with these numbers in its [chair].

    Raises:
        ConfigError: They are beyond its limits.
    """
    from wcsim.physics.wheelchair.plant import plant_spec  # loads the engine, which --help must not

    plant_spec(own)
    text = read_text(find_plant_path(own.plant), SETTINGS)
    section = _CHAIR_SECTION.search(text)
    start, end = section.span() if section else (len(text), len(text))
    # Its other numbers stay, with their comments.
    replaced = rf"(?m)^[ \t]*({'|'.join(numbers)}|profile)[ \t]*=.*\n?"
    others = re.sub(replaced, "", section[1] if section else "")
    lines = [
        text[:start].rstrip(),
        "",
        f"[chair] # {note}",
        *(f"{name} = {value:g}" for name, value in numbers.items()),
        others + text[end:],
    ]
    made = "\n".join(lines).rstrip() + "\n"
    where = f"{escape(own.plant)} with a new [chair]"
    parse(PlantFile, parse_toml(made, where, SETTINGS), where)
    with write_result_atomically(path) as part:
        part.write_text(made, encoding="utf-8")
    print(f"wrote {path}; drive it: --set chair.plant={path}")
