"""`python -m benchmarks crashes`: each crash of a policy with class, place and cause; where chairs lost control."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from rich import box
from rich.progress import Progress
from rich.table import Table

from wcsim.agents.policy_api import BASELINES, UPPER_BOUNDS, VISIBLE_BOUND
from wcsim.agents.runs.policy_file import policy_name
from wcsim.cli.shared.common import (
    MAX_SEED,
    Bounds,
    Keys,
    OutFile,
    OutFolder,
    Repeated,
    check_folder,
    some_words,
    write_json,
)
from wcsim.cli.shared.consoles import stderr_console, stdout_console
from wcsim.cli.shared.run_config import require_user
from wcsim.config import RunConfig, resolve
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import by_name, find_town

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from benchmarks.crashes.drives import CrashDrive
    from benchmarks.crashes.records import Crash, LostControl

MAX_CHAIRS = 64
MAX_STEPS = 10_000_000
LISTED = 60
_PER_STEPS = (8_000, 30_000)


@dataclass
class CrashesOptions:
    """Class, place and cause of every crash of baselines from the same starts; periods of lost control."""

    town: str = "monaco"
    """Towns, separated by commas: each a town's name, its folder, or a .sumocfg file."""
    policy: str = "follow"
    """Baselines, separated by commas; all have the same starts and users."""
    profile: str = "inattentive"
    """User profile; FILE.toml is your own, recorded:FILE replays one."""
    noise: str = "typical"
    """Noise of the cameras: typical or none."""
    delay: int = 2
    """Ticks between an action and its effect on the chair; 2 are 200 ms."""
    steps: int = 8000
    """Steps per policy and town, over all chairs."""
    chairs: int = 4
    """Wheelchairs in the world at the same time."""
    preset: str = "quick"
    """Preset with the settings."""
    set: Repeated = ()
    """Setting as section.key=value; overrides the preset."""
    seed: int = 0
    """Seed of the worlds."""
    out: OutFolder = None
    """Write the result of each policy and town into this folder, as TOWN-POLICY.json, as soon as it is known."""
    json: OutFile = None
    """Write everything to this file."""


def run(options: CrashesOptions) -> int:
    """Run the bench."""
    Bounds(1, MAX_CHAIRS).check("--chairs", options.chairs)
    Bounds(options.chairs, MAX_STEPS).check("--steps", options.steps)
    Bounds(0, MAX_SEED).check("--seed", options.seed)
    Keys({"env.profile": "expected --profile NAME"}).check("--set", options.set)
    if options.out is not None:
        check_folder("--out", options.out / "x")
    names, config = _policies(options.policy), _config(options)
    require_user(options.profile)
    towns = by_name(find_town(name) for name in some_words("--town", options.town))
    drives: list[CrashDrive] = []
    with Progress(console=stderr_console(), transient=True) as bar:
        for town in towns.values():
            for name in names:
                drives.append(_driven(options, config, town.address, name, bar))
                if options.out is not None:
                    write_json(options.out / f"{town.name}-{name}.json", as_json(drives[-1]))
    console = stdout_console()
    console.print(_classes(drives), _control(drives))
    for line in _lines(drives):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    if options.json is not None:
        write_json(options.json, [as_json(drive) for drive in drives])
    return 0


def as_json(drive: CrashDrive) -> dict[str, Any]:
    """One policy in one town: every number of the tables, every crash, stretch and episode."""
    return {
        **asdict(drive),
        "classes": dict(Counter(crash.kind for crash in drive.crashes)),
        "crashes_per_km": _rate(drive, len(drive.crashes)),
        "own_per_km": _rate(drive, sum(crash.fault == "own" for crash in drive.crashes)),
        "lost_share": drive.lost_steps / drive.steps,
        "lost_per_steps": {str(steps): len(drive.lost) * steps / drive.steps for steps in _PER_STEPS},
    }


def _policies(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(some_words("--policy", text)))
    for name in names:
        if policy_name(name).kind != "baseline":
            known = ", ".join((*BASELINES, *UPPER_BOUNDS))
            raise ConfigError(f"--policy {name!r}: expected a baseline, one of: {known}")
    return names


def _config(options: CrashesOptions) -> RunConfig:
    if options.noise not in ("typical", "none"):
        raise ConfigError(f"--noise {options.noise!r}: expected typical or none")
    return resolve(
        options.preset,
        (f"world.action_delay_ticks={options.delay}", f"cameras.0.noise={options.noise}", *options.set),
    )


def _driven(options: CrashesOptions, config: RunConfig, town: str, policy: str, bar: Progress) -> CrashDrive:
    from benchmarks.crashes.drives import CrashOrder, drive_crashes
    from wcsim.agents.policies.baselines import baseline
    from wcsim.agents.policy_api import sense_settings, senses_of
    from wcsim.core.seeding import derive

    found = find_town(town)
    ticks = -(-options.steps // options.chairs)
    task = bar.add_task(f"{found.name}, {policy}", total=ticks * options.chairs)
    drivers = [baseline(policy, config, derive(options.seed, "driver", seat)) for seat in range(options.chairs)]
    config = resolve(config, sense_settings(config, senses_of(drivers[0])))

    visible = policy == VISIBLE_BOUND
    order = CrashOrder(policy=policy, profile=options.profile, ticks=ticks, seed=options.seed, visible=visible)
    return drive_crashes(order, found, config, drivers, lambda done: bar.update(task, completed=done))


def _rate(drive: CrashDrive, events: int) -> tuple[float, float, float] | None:
    from benchmarks.crashes.drives import Rate

    return Rate(events=events, km=drive.km).per_km


def _classes(drives: Sequence[CrashDrive]) -> Table:
    """Crashes by class, a column for each policy and town."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("crashes", overflow="fold")
    for drive in drives:
        table.add_column(f"{drive.policy}\n{drive.town}", justify="right")
    counts = [Counter(crash.kind for crash in drive.crashes) for drive in drives]
    for kind in sorted({kind for count in counts for kind in count}):
        table.add_row(kind, *(str(count[kind]) for count in counts))
    table.add_section()
    columns = [_cells(drive) for drive in drives]
    for row in columns[0]:
        table.add_row(row, *(column[row] for column in columns))
    return table


def _cells(drive: CrashDrive) -> dict[str, str]:
    """What the table says of one drive below the classes: row -> cell."""
    crashes, own = drive.crashes, sum(crash.fault == "own" for crash in drive.crashes)
    return {
        "all": str(len(crashes)),
        "own fault": str(own),
        "kilometres": f"{drive.km:.2f}",
        "all per km": _per_km(drive, len(crashes)),
        "own per km": _per_km(drive, own),
        "after a fall": str(sum(crash.after_fall for crash in crashes)),
        "in the camera picture": _share([crash.in_picture for crash in crashes]),
        "user looked away": _share([_away(crash) for crash in crashes]),
        "had a safe action 1 s before": _share([crash.safe_before for crash in crashes]),
        "falls off kerbs": str(drive.falls),
    }


def _control(drives: Sequence[CrashDrive]) -> Table:
    """Lost control of each policy and town."""
    heads = ("lost control", "steps", "periods", *(f"in {steps:,}" for steps in _PER_STEPS), "of steps")
    table = Table(*heads, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for drive in drives:
        scaled = (f"{len(drive.lost) * steps / drive.steps:.1f}" for steps in _PER_STEPS)
        share = f"{drive.lost_steps / drive.steps:.2%}"
        table.add_row(f"{drive.policy}, {drive.town}", f"{drive.steps:,}", str(len(drive.lost)), *scaled, share)
    return table


def _lines(drives: Sequence[CrashDrive]) -> Iterator[str]:
    """Every crash and every stretch of lost control on a line, up to LISTED of each."""
    crashes = [(drive, crash) for drive in drives for crash in drive.crashes]
    lost = [(drive, item) for drive in drives for item in drive.lost]
    yield from (_crash_line(drive, crash) for drive, crash in crashes[:LISTED])
    if len(crashes) > LISTED:
        yield f"and {len(crashes) - LISTED} more crashes: --json FILE has all of them"
    yield from (_lost_line(drive, item) for drive, item in lost[:LISTED])
    if len(lost) > LISTED:
        yield f"and {len(lost) - LISTED} more periods: --json FILE has all of them"


def _crash_line(drive: CrashDrive, crash: Crash) -> str:
    seen = {True: "in the picture", False: "not in the picture", None: "picture unknown"}[crash.in_picture]
    safe = {True: "had a safe action 1 s before", False: "had no safe action 1 s before", None: "too short"}[
        crash.safe_before
    ]
    away = "attention unknown" if crash.away_share is None else f"looked away for {crash.away_share:.0%}"
    fall = "" if crash.fell_s is None else f", fell {crash.fell_s:.1f} s before"
    what = " ".join(word for word in (crash.kind, f"({crash.thing})" if crash.thing else "") if word)
    return (
        f"{drive.town} {drive.policy} seat {crash.seat} episode {crash.episode} tick {crash.tick} {_at(crash)}: "
        f"{what}, {crash.reason}, {crash.fault}, {crash.speed_mps:.2f} m/s, {seen}, {away}, {safe}{fall}"
    )


def _lost_line(drive: CrashDrive, item: LostControl) -> str:
    how = " and ".join(word for word, is_so in (("turned", item.turned), ("rolled on", item.rolled)) if is_so)
    return (
        f"{drive.town} {drive.policy} seat {item.seat} episode {item.episode} tick {item.tick} {_at(item)}: {how} "
        f"for {item.seconds:.1f} s, {item.speed_mps:.2f} m/s, {item.turn_radps:.2f} rad/s, "
        f"roll {item.roll_deg:.1f} pitch {item.pitch_deg:.1f} deg"
    )


def _at(item: Crash | LostControl) -> str:
    return f"({item.p_W_m[0]:.1f}, {item.p_W_m[1]:.1f}) {item.way}".rstrip()


def _per_km(drive: CrashDrive, events: int) -> str:
    rate = _rate(drive, events)
    return "-" if rate is None else f"{rate[0]:.1f} ({rate[1]:.1f}-{rate[2]:.1f})"


def _away(crash: Crash) -> bool | None:
    return None if crash.away_share is None else crash.away_share > 0.0


def _share(answers: Sequence[bool | None]) -> str:
    """How many of the known answers are yes."""
    known = [answer for answer in answers if answer is not None]
    return f"{sum(known)} of {len(known)}" if known else "-"
