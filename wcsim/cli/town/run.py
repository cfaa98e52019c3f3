"""`wcsim town run`: a town's traffic, with or without wheelchairs that obey their users."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from wcsim.cli.shared.common import (
    Bounds,
    Flag,
    OutFile,
    OutFolder,
    Repeated,
    TownWord,
    require_writable_folder,
    shorten_lines,
    split_comma_list,
    write_json,
)
from wcsim.cli.shared.consoles import print_note, print_sumo_overrides, show_table, stdout_console
from wcsim.config import RunConfig, resolve
from wcsim.core import seeding
from wcsim.errors import ConfigError
from wcsim.supervisor.rewards import format_crash_summary
from wcsim.towns.checks.cures import PAVED_LATER, Cures
from wcsim.towns.scenario.town import Town, content_hash, find_town
from wcsim.towns.sumo.net import LaneKind, read_net

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.bridge.town_run import CrashFact, TrafficFacts
    from wcsim.towns.scenario.stage import Scenario

MANIFEST: Final = "manifest.json"
MAX_CHAIRS: Final = 64


@dataclass
class TownRunOptions:
    """Run a town's traffic, with or without wheelchairs, and record it."""

    town: TownWord
    """A town's name, its folder, or a .sumocfg file."""
    seconds: Annotated[float, Bounds(0.1, 1e7)] = 600.0
    """Simulated time."""
    seed: int = 0
    """Seed of traffic, users and starts."""
    out: OutFolder = None
    """Run folder; default runs/TOWN-run-SEED."""
    chairs: Annotated[int, Bounds(0, MAX_CHAIRS)] = 1
    """Number of wheelchairs, each obeying its user; with 0 the traffic is that of plain sumo."""
    outputs: str = ""
    """Additional SUMO outputs, separated by commas: fcd, tripinfo, summary, ..."""
    allow_outside: Flag = False
    """Permit a .sumocfg to name files outside of its folder."""
    hook: str = ""
    """Your own step hook as module:Class; it gets the libsumo module, and the wheelchairs around each step."""  # noqa: E501
    preset: str = "quick"
    """Settings to start with: quick, laptop, best, dqn or paper."""
    set: Repeated = ()
    """section.key=value, overrides the preset; may be repeated."""
    verbose: Flag = False
    """Show a table of the SUMO options that are overridden, with reasons."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: TownRunOptions, words: Sequence[str]) -> int:
    """Run, print a summary, and leave the run folder; the command line goes into its manifest."""
    # Without a chair the traffic starts as in plain sumo.
    plain = () if options.chairs else ("world.warmup_s=0",)
    config = resolve(options.preset, plain, options.set)
    town = find_town(options.town, outside=options.allow_outside)
    out = options.out or Path("runs") / f"{town.name}-run-{options.seed}"
    require_writable_folder("--out", out)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ConfigError(f"--out {out} is not empty; choose another folder, or remove it")
    facts = _record(options, town, config, out, ("wcsim", "town", *words))
    show_table((f"town {town.name}", ""), _summary(facts).items())
    for line in _crash_lines(facts.crashed):
        print(line)
    if facts.warnings:
        print(
            f"warnings of SUMO: {facts.warnings}, in {out}/sumo; the first of each kind:",
            *shorten_lines(facts.warned, "kinds"),
            sep="\n",
        )
    if not facts.vehicles:
        print(
            "no vehicles: the demand has none, or none in this time; look for faults: "
            f"wcsim town check {shlex.quote(str(town.sumocfg))}"
        )
    if not facts.persons:
        stdout_console().print(_no_persons(town), soft_wrap=True)
    place = shlex.quote(str(out))
    print(f"run folder: {out}    convert it: wcsim log convert {place} {place}/fcd.xml")
    write_json(
        options.json, {"town": town.name, "seed": options.seed, "run": str(out), **asdict(facts)}
    )
    return 0


def _record(
    options: TownRunOptions, town: Town, config: RunConfig, out: Path, command: tuple[str, ...]
) -> TrafficFacts:
    """Run the traffic into a folder, with a manifest from the first step on."""
    from wcsim.agents.runs.run_folder import make_run_manifest
    from wcsim.bridge.town_run import RecordOrder, record_town
    from wcsim.server.specs import RunInfo

    info = RunInfo(
        seed=options.seed, town=town.name, town_sha256=content_hash(town), command=command
    )
    manifest = {
        **asdict(make_run_manifest(config, info)),
        "kind": "town run",
        "sumo_seed": seeding.derive_seed(options.seed, "sumo"),
        "chairs": options.chairs,
        "seconds": options.seconds,
        "hook": options.hook,
        "config": config.model_dump(mode="json"),
    }
    out.mkdir(parents=True, exist_ok=True)

    def write_start(scenario: Scenario) -> None:
        print_sumo_overrides(
            stdout_console(),
            town.name,
            scenario.overrides,
            scenario.notes,
            verbose=options.verbose,
            in_manifest=True,
        )
        manifest.update(
            overrides=[asdict(row) for row in scenario.overrides],
            notes=list(scenario.notes),
            scenario_sha256=scenario.digest,
            outputs=[str(path.relative_to(out.absolute())) for path in scenario.outputs],
        )
        write_json(out / MANIFEST, manifest)

    def show(done: int, all_ticks: int) -> None:
        # A line for each tenth.
        if done * 10 // all_ticks > (done - 1) * 10 // all_ticks:
            print_note(f"{round(done * config.world.tick_s, 3):g} of {options.seconds:g} s")

    order = RecordOrder(
        seconds=options.seconds,
        seed=options.seed,
        chairs=options.chairs,
        folder=out,
        outputs=split_comma_list(options.outputs),
        hook=options.hook,
    )
    try:
        facts = record_town(town, config, order, write_start, show, print_note)
    except BaseException:
        if (out / MANIFEST).is_file():
            write_json(out / MANIFEST, {**manifest, "status": "interrupted"})
        else:
            # Nothing had started.
            shutil.rmtree(out, ignore_errors=True)
        raise
    write_json(out / MANIFEST, {**manifest, "status": "done", "facts": asdict(facts)})
    return facts


def _summary(facts: TrafficFacts) -> dict[str, str]:
    """The rows of the summary."""

    def with_warmup(number: int, warming: int) -> str:
        return f"{number}, {warming} during warm-up" if warming else str(number)

    rows = {
        "simulated": f"{facts.ticks} ticks, to {facts.end_s:g} s of SUMO's time",
        "vehicles": str(facts.vehicles),
        "persons": str(facts.persons),
        "teleports out of jams": with_warmup(facts.teleports, facts.teleports_warming),
        "collisions within SUMO's traffic": with_warmup(facts.collisions, facts.collisions_warming),
    }
    if facts.episodes:
        rows["road users near a wheelchair"] = (
            f"{facts.mirrored}, at most {facts.mirrored_most} at once"
        )
        rows["wheelchair episodes, crashes"] = f"{facts.episodes}, {facts.crashes}"
    return rows


def _crash_lines(crashed: Sequence[CrashFact]) -> list[str]:
    """Up to five crashes of wheelchairs, each with its time, reason, fault and partner."""
    lines = [
        f"wheelchair {crash.seat}, {crash.time_s:.1f} s: "
        f"{format_crash_summary(crash.reason, crash.fault, crash.told)}"
        for crash in crashed
    ]
    return shorten_lines(lines, "crashes; all of them are in the manifest")


def _no_persons(town: Town) -> str:
    """How to get pedestrians: first of all by pavements, where the net has none."""
    reason = "no pedestrians: the demand has none, or none in this time"
    net = read_net(town.net)
    if net.lanes(LaneKind.WALKINGAREA):
        return f"{reason}; {Cures(town).walkers()}"
    cure = Cures(town).pave()
    # Without a street to pave there will be no copy to continue with.
    later = f"\n{PAVED_LATER}" if "town pave" in cure else ""
    return f"{reason}, and the net has no walking areas; {cure}{later}"
