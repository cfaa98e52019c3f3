"""`wcsim users record | fit`: a simulated user is recorded; the user model is fitted to drives."""

from __future__ import annotations

import shlex
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from rich import box
from tyro.conf import Positional, arg

from wcsim.cli.shared.common import (
    AllowedSettingKeys,
    Bounds,
    Flag,
    OutFile,
    Parts,
    Repeated,
    TownWord,
    WritableFile,
    run_subcommand,
    write_json,
    write_result_atomically,
)
from wcsim.cli.shared.consoles import show_table
from wcsim.config import resolve
from wcsim.core.constants import RECORDED
from wcsim.core.reading import escape, pluralize
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town
from wcsim.users.profiles import (
    UserProfile,
    find_builtin_profile,
    find_profile,
    profile_name_from_text,
    profile_to_toml,
)

if TYPE_CHECKING:  # loads what --help must not
    from wcsim.log.drive import DriveRecording
    from wcsim.users.recordings.fit_user import FittedParameter, UserFitResult

# The simulated user does not look at the pictures.
SMALL_CAMERA: Final = ("cameras.0.width_px=16", "cameras.0.height_px=12")
_SHOW_EVERY_S: Final = 60.0
# Times that intents are made by the last fit, and a user is fitted to them.
_ROUNDS: Final = 3


def run(words: list[str]) -> int:
    """Run one of them."""
    parts: Parts = {"record": (_RecordOptions, _record), "fit": (_FitOptions, _fit)}
    return run_subcommand(words, "users", parts)


@dataclass
class _RecordOptions:
    """Let a simulated user drive through a town and record the drive."""

    town: TownWord
    """A town's name, its folder, or a .sumocfg file."""
    out: Annotated[Path, arg(metavar="FILE"), WritableFile(new=True)]
    """New file for the recording."""
    profile: str = "competent"
    """Profile of the simulated user, or FILE.toml. One user is drawn and stays the same after a crash."""  # noqa: E501
    minutes: Annotated[float, Bounds(0.01, 600.0)] = 10.0
    """Length of the drive in minutes."""
    seed: int = 0
    """Seed of the town, the starts and the user."""
    set: Annotated[Repeated, AllowedSettingKeys({"env.profile": "expected --profile NAME"})] = ()
    """section.key=value, overrides preset quick; may be repeated."""
    json: OutFile = None
    """Write the result to this file."""


def _record(options: _RecordOptions) -> int:
    """Drive and record."""
    if options.profile.startswith(RECORDED):
        raise ConfigError(
            f"--profile {escape(options.profile, 80)} is a recording; "
            "expected a profile, or FILE.toml"
        )
    base = find_profile(options.profile)
    config = resolve("quick", (*SMALL_CAMERA, *options.set))
    town = find_town(options.town)

    from wcsim.bridge.user_drives import drawn_user, record_user  # loads the simulators

    tick_s = config.world.tick_s
    user = drawn_user(base, options.seed)
    ticks = max(2, round(60.0 * options.minutes / tick_s))

    def show(done: int) -> None:
        if done % round(_SHOW_EVERY_S / tick_s) == 0:
            minutes = f"{done * tick_s / 60.0:.0f} of {options.minutes:g} minutes"
            print(minutes, file=sys.stderr)

    crashes = record_user(
        options.out, town, config, user, ticks=ticks, seed=options.seed, progress=show
    )
    print(
        f"wrote {options.out}: {ticks} ticks of a {user.name} user in {town.name}, "
        f"{pluralize(crashes, 'crash')}"
    )
    write_json(
        options.json,
        {
            "town": town.name,
            "seed": options.seed,
            "ticks": ticks,
            "crashes": crashes,
            "user": asdict(user),
        },
    )
    return 0


@dataclass
class _FitOptions:
    """Fit the user model to recordings and write a profile.

    Stick tables tell only the hand: lag and wander. They are also compared with the hands of all profiles.
    """  # noqa: E501

    drives: Annotated[tuple[Path, ...], Positional, arg(metavar="FILE [FILE ...]")]
    """Recorded drives of one person; or, for each person, a stick table (.csv, .csv.gz) or a folder of them."""  # noqa: E501
    out: Annotated[
        Path, arg(metavar="FILE.toml"), WritableFile(".toml", new=True)
    ]  # it may be edited by now
    """New profile file, for --profile of test and video, or env.profile."""
    base: str = "competent"
    """Profile that supplies parameters which a drive does not show."""
    without_intents: Flag = False
    """Ignore recorded intents and let the user model derive them from the street, as for a person's drive."""  # noqa: E501
    json: OutFile = None
    """Write the result to this file."""


def _fit(options: _FitOptions) -> int:
    """Fit, print, write."""
    base = find_builtin_profile(options.base)
    if not options.drives:
        raise ConfigError("users fit got no file; expected one or more recordings")
    fit = _fit_drives(options, base)
    fit = replace(fit, profile=replace(fit.profile, name=profile_name_from_text(options.out.stem)))
    from wcsim.users.recordings.fit_user import is_certain_estimate

    head = (
        f"fitted to {fit.seconds:.0f} s of driving; "
        f"values without an interval are those of {base.name}\n"
    )
    intervals: dict[str, list[str]] = {}
    for name, item in fit.estimates.items():
        # A profile holds gains and biases of both axes under one key.
        key = name.partition("_")[0] if name.startswith(("gain", "bias")) else name
        intervals.setdefault(key, []).append(f"{item.low:.4g} to {item.high:.4g}")
    notes = {key: "95 %: " + ", ".join(parts) for key, parts in intervals.items()}
    text = profile_to_toml(fit.profile, notes, head + "\n".join(fit.warnings))
    with write_result_atomically(options.out) as part:
        part.write_text(text, encoding="utf-8")
    _print_fit(fit)
    print(
        f"wrote {options.out}; try it: wcsim test --profile {shlex.quote(str(options.out))} "
        "--only --episodes 1 --max-steps 600"
    )
    estimates = {
        name: asdict(item) | {"told": is_certain_estimate(name, item)}
        for name, item in fit.estimates.items()
    }
    write_json(options.json, asdict(fit) | {"estimates": estimates})
    return 0


def _fit_drives(options: _FitOptions, base: UserProfile) -> UserFitResult:
    """The user behind drives, or the hand behind stick tables."""
    if any(path.is_dir() or ".csv" in path.suffixes for path in options.drives):
        if base.discrete:
            raise ConfigError(
                f"--base {base.name} drives by switches, whose hand has no lag; expected one with "
                "a stick"
            )
        if options.without_intents:
            raise ConfigError(
                "--without-intents is for recorded drives; expected none: stick tables have no "
                "intents"
            )
        from wcsim.users.recordings.fit_sticks import fit_user_to_sticks, read_recorded_sticks

        return fit_user_to_sticks(
            {escape(path): read_recorded_sticks(path) for path in options.drives}, base
        )
    from wcsim.log.drive import read_drive

    drives = [read_drive(path) for path in options.drives]
    # Kernels are loaded after what may be refused.
    from wcsim.users.recordings.fit_user import fit_user_to_drives

    known = all(drive.knows_intents for drive in drives) and not options.without_intents
    return fit_user_to_drives(drives, base) if known else _fit_without_intents(drives, base)


def _fit_without_intents(drives: list[DriveRecording], base: UserProfile) -> UserFitResult:
    """The user behind drives without intents: each fit's delays give the intents of the next."""
    from wcsim.bridge.replay.replayed import town_of_drive
    from wcsim.bridge.user_drives import seen_drive, with_shadow
    from wcsim.users.recordings.fit_user import fit_user_to_drives
    from wcsim.users.recordings.hand_series import require_analogue_stick

    for drive in drives:
        require_analogue_stick(drive.name, drive.by_driver)
        town_of_drive(drive.header)
    print("replaying the drives, to see the street as their driver did", file=sys.stderr)
    seen = [seen_drive(drive) for drive in drives if drive.ticks]
    user = base
    for number in range(1, _ROUNDS + 1):
        fit = fit_user_to_drives(
            [with_shadow(item, user) for item in seen], base, true_intents=False
        )
        user = fit.profile
        print(f"fit {number} of {_ROUNDS}", file=sys.stderr)
    return fit


def _print_fit(fit: UserFitResult) -> None:
    from wcsim.users.recordings.fit_user import is_certain_estimate

    rows = []
    for name, item in fit.estimates.items():
        numbers = (f"{number:.3g}" for number in (item.value, item.low, item.high))
        rows.append(
            (name, *numbers, "" if is_certain_estimate(name, item) else "uncertain by over 15 %")
        )
    show_table(("parameter", "fitted", "95 % from", "to", ""), rows, box=box.SIMPLE_HEAD)
    for line in fit.warnings:
        print(f"note: {line}", file=sys.stderr)
    if fit.habits:
        names = fit.habits["people"]
        habits = (
            (user, *(_hundredfold(row.get(name)) for name in names))
            for user, row in fit.habits.items()
        )
        headings = ["in\nhundredths", *(name.replace("_", "\n") for name in names)]
        show_table(headings, habits, box=None, padding=(0, 1, 0, 0))


def _hundredfold(item: FittedParameter | None) -> str:
    if item is None:
        return "-"
    return "\n".join(f"{100.0 * number:.1f}" for number in (item.value, item.low, item.high))
