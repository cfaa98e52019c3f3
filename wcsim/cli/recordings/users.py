"""`wcsim users record | fit`: what a simulated user does is kept in a file, and the model is fitted to such files."""

from __future__ import annotations

import shlex
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich import box
from tyro.conf import Positional, arg

from wcsim.cli.shared.common import (
    Bounds,
    Flag,
    Keys,
    OutFile,
    Repeated,
    TownWord,
    Writes,
    result_file,
    run_part,
    write_json,
)
from wcsim.cli.shared.consoles import show_table
from wcsim.config import resolve
from wcsim.core.constants import RECORDED
from wcsim.core.reading import counted, escaped
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town
from wcsim.users.profiles import (
    UserProfile,
    find_profile,
    profile,
    profile_toml,
    valid_profile_name,
)

if TYPE_CHECKING:  # loads what --help must not
    from wcsim.log.drive import DriveRecording
    from wcsim.users.recordings.fit_user import FittedNumber, UserFit


SMALL_CAMERA = ("cameras.0.width_px=16", "cameras.0.height_px=12")  # nobody looks at the pictures
_TELL_EVERY_S = 60.0


def run(words: list[str]) -> int:
    """Run one of them."""
    record, fit = (_RecordOptions, _record), (_FitOptions, _fit)
    return run_part(words, "users", {"record": record, "fit": fit})


@dataclass
class _RecordOptions:
    """Let a simulated user drive through a town and record the drive."""

    town: TownWord
    """A town's name, its folder, or a .sumocfg file."""
    out: Annotated[Path, arg(metavar="FILE"), Writes(new=True)]
    """New file for the recording."""
    profile: str = "competent"
    """Profile of the simulated user, or FILE.toml. One user is drawn and stays the same after a crash."""
    minutes: Annotated[float, Bounds(0.01, 600.0)] = 10.0
    """Length of the drive in minutes."""
    seed: int = 0
    """Seed of the town, the starts and the user."""
    set: Annotated[Repeated, Keys({"env.profile": "expected --profile NAME"})] = ()
    """section.key=value, overrides preset quick; may be repeated."""
    json: OutFile = None
    """Write the result to this file."""


def _record(options: _RecordOptions) -> int:
    """Drive and record."""
    base = _profile(options.profile)
    config = resolve("quick", (*SMALL_CAMERA, *options.set))
    town = find_town(options.town)

    from wcsim.bridge.user_drives import drawn_user, record_user  # loads the simulators

    user, ticks = (
        drawn_user(base, options.seed),
        max(2, round(60.0 * options.minutes / config.world.tick_s)),
    )

    def show(done: int) -> None:
        if done % round(_TELL_EVERY_S / config.world.tick_s) == 0:
            print(
                f"{done * config.world.tick_s / 60.0:.0f} of {options.minutes:g} minutes",
                file=sys.stderr,
            )

    crashes = record_user(
        options.out, town, config, user, ticks=ticks, seed=options.seed, progress=show
    )
    print(
        f"wrote {options.out}: {ticks} ticks of a {user.name} user in {town.name}, {counted(crashes, 'crash')}"
    )
    told = {
        "town": town.name,
        "seed": options.seed,
        "ticks": ticks,
        "crashes": crashes,
        "user": asdict(user),
    }
    write_json(options.json, told)
    return 0


def _profile(name: str) -> UserProfile:
    if name.startswith(RECORDED):
        raise ConfigError(
            f"--profile {escaped(name, 80)} is a recording; expected a profile, or FILE.toml"
        )
    return find_profile(name)


_ROUNDS = 3  # of making intents by the last fit, and fitting to them


@dataclass
class _FitOptions:
    """Fit the user model to recordings and write a profile.

    Stick tables tell only the hand: lag and wander. They are also compared with the hands of all profiles.
    """

    drives: Annotated[tuple[Path, ...], Positional, arg(metavar="FILE [FILE ...]")]
    """Recorded drives of one person; or, for each person, a stick table (.csv, .csv.gz) or a folder of them."""
    out: Annotated[
        Path, arg(metavar="FILE.toml"), Writes(".toml", new=True)
    ]  # it may be edited by now
    """New profile file, for --profile of test and video, or env.profile."""
    base: str = "competent"
    """Profile that supplies parameters which a drive does not show."""
    without_intents: Flag = False
    """Ignore recorded intents and let the user model derive them from the street, as for a person's drive."""
    json: OutFile = None
    """Write the result to this file."""


def _fit(options: _FitOptions) -> int:
    """Fit, print, write."""
    base = profile(options.base)
    if not options.drives:
        raise ConfigError("users fit got no file; expected one or more recordings")
    fit = _fitted(options, base)
    fit = replace(fit, profile=replace(fit.profile, name=valid_profile_name(options.out.stem)))
    from wcsim.users.recordings.fit_user import is_certain

    head = f"fitted to {fit.seconds:.0f} s of driving; values without an interval are those of {base.name}\n"
    text = profile_toml(fit.profile, _notes(fit), head + "\n".join(fit.warnings))
    with result_file(options.out) as part:
        part.write_text(text, encoding="utf-8")
    _print(fit)
    minute = (
        f"wcsim test --profile {shlex.quote(str(options.out))} --only --episodes 1 --max-steps 600"
    )
    print(f"wrote {options.out}; try it: {minute}")
    told = {
        name: asdict(item) | {"told": is_certain(name, item)} for name, item in fit.estimates.items()
    }
    write_json(options.json, asdict(fit) | {"estimates": told})
    return 0


def _fitted(options: _FitOptions, base: UserProfile) -> UserFit:
    """The user behind drives, or the hand behind stick tables; kernels load after what may be refused."""
    if any(path.is_dir() or ".csv" in path.suffixes for path in options.drives):
        if base.discrete:
            raise ConfigError(
                f"--base {base.name} drives by switches, whose hand has no lag; expected one with a stick"
            )
        if options.without_intents:
            raise ConfigError(
                "--without-intents is for recorded drives; expected none: stick tables have no intents"
            )
        from wcsim.users.recordings.fit_sticks import fit_sticks, read_sticks

        return fit_sticks({escaped(path): read_sticks(path) for path in options.drives}, base)
    from wcsim.log.drive import read_drive

    drives = [read_drive(path) for path in options.drives]
    from wcsim.users.recordings.fit_user import fit_user

    known = all(drive.knows_intents for drive in drives) and not options.without_intents
    return fit_user(drives, base) if known else _reconstructed(drives, base)


def _reconstructed(drives: list[DriveRecording], base: UserProfile) -> UserFit:
    """The same for drives that do not say what was wanted: the last fit's delays make the next one's intents."""
    from wcsim.bridge.replay.replayed import town_of_drive
    from wcsim.bridge.user_drives import seen_drive, with_shadow
    from wcsim.users.recordings.fit_user import fit_user
    from wcsim.users.recordings.hand_series import check_stick

    for drive in drives:
        check_stick(drive.name, drive.by_driver)
        town_of_drive(drive.header)
    print("replaying the drives, to see the street as their driver did", file=sys.stderr)
    seen = [seen_drive(drive) for drive in drives if drive.ticks]
    user = base
    for number in range(1, _ROUNDS + 1):
        fit = fit_user([with_shadow(item, user) for item in seen], base, true_intents=False)
        user = fit.profile
        print(f"fit {number} of {_ROUNDS}", file=sys.stderr)
    return fit


def _notes(fit: UserFit) -> dict[str, str]:
    """Intervals by the profile's keys."""
    told: dict[str, list[str]] = {}
    for name, item in fit.estimates.items():
        key = name.partition("_")[0] if name.startswith(("gain", "bias")) else name
        told.setdefault(key, []).append(f"{item.low:.4g} to {item.high:.4g}")
    return {key: "95 %: " + ", ".join(parts) for key, parts in told.items()}


def _print(fit: UserFit) -> None:
    from wcsim.users.recordings.fit_user import is_certain

    rows = (
        (name, *(f"{bound:.3g}" for bound in (item.value, item.low, item.high)),
         "" if is_certain(name, item) else "uncertain by over 15 %")
        for name, item in fit.estimates.items()
    )  # fmt: skip
    show_table(("parameter", "fitted", "95 % from", "to", ""), rows, box=box.SIMPLE_HEAD)
    for line in fit.warnings:
        print(f"note: {line}", file=sys.stderr)
    if fit.habits:
        names = fit.habits["people"]
        habits = (
            (who, *(_hundredfold(row.get(name)) for name in names))
            for who, row in fit.habits.items()
        )
        headings = ["in\nhundredths", *(name.replace("_", "\n") for name in names)]
        show_table(headings, habits, box=None, padding=(0, 1, 0, 0))


def _hundredfold(item: FittedNumber | None) -> str:
    return "\n".join(f"{100.0 * x:.1f}" for x in (item.value, item.low, item.high)) if item else "-"
