"""`python -m benchmarks soak`: real processes, killed and stopped at random, and the proof that no step was lost."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.progress import Progress

from wcsim.cli.shared.common import Bounds, OutFile, OutFolder, Repeated, write_json
from wcsim.cli.shared.consoles import stderr_console, stdout_console
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.config import resolve
from wcsim.core.own_folder import create_temporary_folder
from wcsim.errors import ConfigError, InterruptedRunError, WcsimError
from wcsim.towns.scenario.town import Town, find_town

if TYPE_CHECKING:  # loads ZeroMQ, which --help must not
    from benchmarks.soak.growth import LongRun, Slope
    from benchmarks.soak.learners import LearnersFacts
    from benchmarks.soak.planned import FaultOrder
    from benchmarks.soak.soak import SoakFacts

_OF_LEARNERS = ("steps", "kills", "stops", "slow", "twice", "set")
_STEPS, _FAULTS = 10_000, 20  # of learners, where nothing else is said


@dataclass
class SoakOptions:
    """Kill and stop clients, the master and the world at random; then compare ledgers and journal."""

    minutes: float | None = None
    """Duration in minutes. (default: 30; with --networks until --steps are done)"""
    clients: int | None = None
    """Number of clients without a learner, a process each. (default: 3)"""
    networks: str = ""
    """Clients that learn: networks separated by commas, as for `wcsim train-clients`."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Steps of each learner, without --minutes. (default: 10000)"""
    kills: int | None = None
    """Number of kills during the learning; needs --networks. (default: 20)"""
    stops: int | None = None
    """Number of stops during the learning; without --networks a fault comes every few seconds. (default: 20)"""
    slow: int | None = None
    """Updates per step of the last learner, as a multiple of the others'. (default: 1)"""
    twice: bool = False
    """Run the learners twice without faults: both runs must have the same journal hash."""
    set: Repeated = ()
    """Setting of the learners as section.key=value."""
    town: str = ""
    """Where: a town's name, its folder, or a .sumocfg file. (default: monaco; with --networks helsinki)"""
    lease: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Seconds without progress after which a client is dropped. (default: 3; with --networks 10)"""
    seed: int = 0
    """Seed of the faults and of the world."""
    out: OutFolder = None
    """Folder to save the run in; otherwise a temporary one."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: SoakOptions) -> int:
    """Soak, print what was seen, and say by the exit code whether it is as it should be."""
    _check(options)
    town = find_town(options.town or ("helsinki" if options.networks else "monaco"))
    with nullcontext(options.out) if options.out is not None else create_temporary_folder() as folder:
        folder.mkdir(parents=True, exist_ok=True)
        if options.networks:
            try:
                return _of_learners(options, town, folder)
            except InterruptedRunError:  # its own words are those of a training, which goes on
                raise InterruptedRunError(
                    "stopped; an incomplete soak shows nothing: start it again in another --out"
                ) from None
        facts = _run(options, town.address, folder)
    _print(result(facts), faults_of(facts))
    if options.json is not None:
        write_json(options.json, result(facts))
    if facts.outcome.code:
        raise WcsimError(f"the soak ended early: {facts.outcome.message}")
    if facts.outcome.by_signal:
        return ExitCode.STOPPED
    return ExitCode.FAILED if faults_of(facts) else ExitCode.DONE


def _check(options: SoakOptions) -> None:
    """Raises ConfigError."""
    Bounds(0.1, 6000.0).check("--minutes", 30.0 if options.minutes is None else options.minutes)
    Bounds(0.5, 600.0).check("--lease", 3.0 if options.lease is None else options.lease)
    bounds = {"clients": (2, 16), "steps": (10, 10_000_000), "kills": (0, 100_000), "stops": (0, 100_000)}
    for name, (low, high) in {**bounds, "slow": (1, 100)}.items():
        if getattr(options, name) is not None:
            Bounds(low, high).check(f"--{name}", getattr(options, name))
    _check_heard(options)
    kept = options.out
    if kept is not None and kept.exists() and any(kept.iterdir()):
        raise ConfigError(f"--out {kept} is not empty; choose a new folder")


def _check_heard(options: SoakOptions) -> None:
    """Refuse options that this kind of soak does not hear of. Raises ConfigError."""
    said = [f"--{name}" for name in _OF_LEARNERS if getattr(options, name) != getattr(SoakOptions, name)]
    if said and not options.networks:
        raise ConfigError(f"{', '.join(said)}: only learners use this; add --networks A,B,..., or leave it out")
    if options.networks and options.clients is not None:
        raise ConfigError(f"--clients {options.clients}: --networks sets the clients; leave one of the two out")
    faults = [f"--{name}" for name in ("kills", "stops") if getattr(options, name)]
    if options.twice and faults:
        raise ConfigError(f"{', '.join(faults)}: --twice compares two runs without faults; leave one of the two out")


def _of_learners(options: SoakOptions, town: Town, folder: Path) -> int:
    """The same with learners."""
    from benchmarks.soak.planned import FaultOrder

    struck = FaultOrder(
        kills=_faults(options, options.kills),
        stops=_faults(options, options.stops),
        lease_s=10.0 if options.lease is None else options.lease,
        seed=options.seed,
    )
    every = [_soaked(options, town, folder / f"run-{1 + k}", struck) for k in range(1 + options.twice)]
    results = [learners_result(facts) for facts in every]
    wrong = [key for facts in every for key in learners_faults(facts, struck)]
    if len({facts.journal_hash for facts in every}) > 1:
        wrong.append("journal_hash")
    for each in results:
        _print(each, wrong)
    if options.json is not None:
        write_json(options.json, {"runs": results, "wrong": wrong})
    return ExitCode.FAILED if wrong else ExitCode.DONE


def _faults(options: SoakOptions, asked: int | None) -> int:
    return 0 if options.twice else _FAULTS if asked is None else asked


def _soaked(options: SoakOptions, town: Town, folder: Path, struck: FaultOrder) -> LearnersFacts:
    """One run of the learners, as `wcsim train-clients` would do it."""
    from benchmarks.soak.learners import ENDLESS, SETTINGS, LearnersOrder, slowed, soak_learners
    from wcsim.agents.clients.group_run import ResolvedGroupRun
    from wcsim.cli.shared.run_config import add_town_to_run_info
    from wcsim.cli.training.clients import train_clients
    from wcsim.cli.training.train_clients import TrainClientsOptions, resolve_clients
    from wcsim.server.launch.states import ProcessRestartRules
    from wcsim.server.specs import RunInfo

    order = LearnersOrder(
        folder=folder,
        faults=struck,
        steps=(options.steps or _STEPS) if options.minutes is None else None,
        seconds=60.0 * (options.minutes or 0.0),
    )
    trained = TrainClientsOptions(
        town=town.address,
        preset="dqn",
        clients=options.networks,
        steps=order.steps or ENDLESS,
        set=(*SETTINGS, *options.set),
        lease=struck.lease_s,
        seed=options.seed,
        out=folder,
        json=folder.with_name(f"{folder.name}.json"),
    )
    *clients, last = resolve_clients(trained)
    info = add_town_to_run_info(
        RunInfo(seed=options.seed, command=("python", "-m", "benchmarks", "soak")), town, last.config
    )
    run = ResolvedGroupRun(clients=(*clients, slowed(last, options.slow or 1)), out=folder, info=info)
    told = folder.with_name(f"{folder.name}.json")
    deaths = (
        ProcessRestartRules().deaths + struck.kills + struck.stops
    )  # those that faults cause, which may come in a row
    restarts = ProcessRestartRules(deaths=deaths)
    return soak_learners(order, run, told, lambda watch: train_clients(trained, run, town, watch, restarts))


def learners_result(facts: LearnersFacts) -> dict[str, int | float | str | None]:
    """The keys of a run in the JSON file."""
    from benchmarks.soak.learners import p99

    return {
        "ticks": facts.ticks,
        "kills": facts.kills,
        "stops": facts.stops,
        "lost": facts.missing,
        "doubled": facts.duplicated,
        "journal_hash": facts.journal_hash,
        "recovery_client_p99_s": p99(facts.recovery_s(of_world=False)),
        "recovery_world_p99_s": p99(facts.recovery_s(of_world=True)),
        "unrecovered": facts.kills + facts.stops - len(facts.recovered) - facts.alone,
        "orphans": facts.orphans,
        "leaked_shm": facts.leaked,
        "slowest_over_median": facts.slow_factor,
        **growth_of(facts.memory, facts.disk, facts.bounds),
    }


def learners_faults(facts: LearnersFacts, struck: FaultOrder) -> list[str]:
    """What is not as it should be."""
    found = learners_result(facts)
    wrong = [key for key in ("lost", "doubled", "unrecovered", "orphans", "leaked_shm") if found[key]]
    wrong += [key for key, planned in (("kills", struck.kills), ("stops", struck.stops)) if found[key] != planned]
    return wrong + (["exit code"] if facts.code else [])


def result(facts: SoakFacts) -> dict[str, int | float | None]:
    """The keys of the JSON file."""
    return {
        "ticks": facts.audit.ticks,
        "kills": sum(fault.what == "kill" for fault in facts.faults),
        "stops": sum(fault.what != "kill" for fault in facts.faults),
        "lost": facts.audit.lost,
        "doubled": facts.audit.doubled,
        "phantom": facts.audit.phantom,
        "recovery_client_p99_s": _p99(facts.times.client_s),
        "recovery_world_p99_s": _p99(facts.times.world_s),
        "recovery_overlap_p99_s": _p99(facts.times.overlap_s),
        "overlapping": len(facts.times.overlap_s),
        "rejoin_p99_s": _p99(facts.times.rejoin_s),
        "alone": sum(not fault.others for fault in facts.faults),
        "unrecovered": sum(bool(fault.others) for fault in facts.faults)
        - sum(map(len, (facts.times.client_s, facts.times.world_s, facts.times.overlap_s))),
        "orphans": facts.orphans,
        "leaked_shm": facts.leaked,
        **growth_of(facts.memory, facts.disk, facts.bounds),
    }


def growth_of(memory: dict[str, Slope], disk: Slope, bounds: LongRun) -> dict[str, int | float | None]:
    """Slopes with their 95 % bounds, and what follows for 600 hours; None for a bound that too few samples give."""
    from benchmarks.soak.growth import Slope  # --help does without

    clients = [slope for who, slope in memory.items() if who not in ("world", "launcher")]
    fastest = max(clients, key=lambda slope: slope.upper_per_h, default=Slope())
    grown = {"world": memory.get("world", Slope()), "client": fastest}
    told: dict[str, float] = {}
    for who, slope in (*grown.items(), ("disk", disk)):
        told |= {f"{who}_mb_per_h": slope.per_h, f"{who}_mb_per_h_95": slope.upper_per_h}
    told |= {"memory_600h_gb": bounds.memory_gb, "disk_600h_gb": bounds.disk_gb, "recovery_600h_s": bounds.recovery_s}
    return {key: value if math.isfinite(value) else None for key, value in told.items()}


def faults_of(facts: SoakFacts) -> list[str]:
    """What is not as it should be."""
    found = result(facts)
    wrong = [key for key in ("lost", "doubled", "phantom", "orphans", "leaked_shm", "unrecovered") if found[key]]
    slow = (
        ("recovery_client_p99_s", facts.bars.client_s),
        ("recovery_world_p99_s", facts.bars.world_s),
        ("recovery_overlap_p99_s", facts.bars.overlap_s),
    )
    return wrong + [key for key, bar_s in slow if (found[key] or 0.0) > bar_s]


def _run(options: SoakOptions, town: str, folder: Path) -> SoakFacts:
    from benchmarks.soak.soak import SoakOrder, soak

    order = SoakOrder(
        town=town,
        config=resolve("quick"),
        seconds=60.0 * (30.0 if options.minutes is None else options.minutes),
        folder=folder,
        clients=options.clients or 3,
        seed=options.seed,
        lease_s=3.0 if options.lease is None else options.lease,
    )
    with Progress(console=stderr_console(), transient=True) as bar:
        task = bar.add_task("soaking", total=order.seconds)
        return soak(order, lambda done_s: bar.update(task, completed=done_s))


def _print(told: Mapping[str, int | float | str | None], wrong: Sequence[str]) -> None:
    console = stdout_console()
    for key, value in told.items():
        console.print(f"{key:<24}{'-' if value is None else f'{value:.4g}' if isinstance(value, float) else value}")
    console.print("passed" if not wrong else f"failed: {', '.join(wrong)}")


def _p99(values_s: tuple[float, ...]) -> float | None:
    import numpy as np  # --help does without

    return float(np.percentile(values_s, 99)) if values_s else None
