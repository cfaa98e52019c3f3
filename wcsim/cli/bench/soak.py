"""`wcsim bench soak`: real processes, killed and stopped at random, and the proof that no step was lost."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.console import Console
from rich.progress import Progress

from wcsim.cli.shared.common import OutFile, OutFolder, in_bounds, write_json
from wcsim.cli.shared.exit_codes import Exit
from wcsim.config import load_run_config
from wcsim.errors import ConfigError, WcsimError
from wcsim.towns.scenario.town import find_town

if TYPE_CHECKING:  # loads ZeroMQ, which --help must not
    from wcsim.bench.soak.soak import SoakFacts

_CLIENT_BAR_S, _WORLD_BAR_S = 5.0, 30.0


@dataclass
class SoakOptions:
    """Kill and stop clients, master and world at random; then compare ledgers and journal."""

    minutes: float = 30.0
    """How long."""
    clients: int = 3
    """How many, each without a learner, in a process of its own."""
    town: str = "monaco"
    """Town to run in."""
    recovery: Literal["new_epoch", "replay"] = "new_epoch"
    """What a restarted world does: begin a new epoch, or compute the old one again."""
    lease: float = 3.0
    """Seconds without progress after which a client is given up."""
    seed: int = 0
    """Of the faults, and of the world."""
    out: OutFolder = None
    """Run folder to keep; a temporary one otherwise."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: SoakOptions) -> int:
    """Soak, print what was seen, and say by the exit code whether it is as it should be."""
    in_bounds("--minutes", options.minutes, 0.1, 6000.0)
    in_bounds("--clients", options.clients, 2, 16)
    in_bounds("--lease", options.lease, 0.5, 600.0)
    kept = options.out
    if kept is not None and kept.exists() and any(kept.iterdir()):
        raise ConfigError(f"--out {kept} is not empty; choose a new folder")
    town = find_town(options.town)
    folder = kept if kept is not None else Path(tempfile.mkdtemp(prefix="wcsim-soak-"))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        facts = _run(options, town.address, folder)
    finally:
        if kept is None:
            shutil.rmtree(folder, ignore_errors=True)
    _print(facts)
    if options.json is not None:
        write_json(options.json, result(facts))
    if facts.outcome.code:
        raise WcsimError(f"the soak ended early: {facts.outcome.message}")
    if facts.outcome.by_signal:
        return Exit.STOPPED
    return Exit.FAILED if faults_of(facts) else Exit.DONE


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
        "rss_slope_mb_per_h": facts.rss_slope_mb_per_h,
    }


def faults_of(facts: SoakFacts) -> list[str]:
    """What is not as it should be."""
    found = result(facts)
    wrong = [key for key in ("lost", "doubled", "phantom", "orphans", "leaked_shm", "unrecovered") if found[key]]
    slow = (
        ("recovery_client_p99_s", _CLIENT_BAR_S),
        ("recovery_world_p99_s", _WORLD_BAR_S),
        ("recovery_overlap_p99_s", _WORLD_BAR_S),  # any of them may be the world's
    )
    return wrong + [key for key, bar_s in slow if (found[key] or 0.0) > bar_s]


def _run(options: SoakOptions, town: str, folder: Path) -> SoakFacts:
    from wcsim.bench.soak.soak import SoakOrder, soak

    order = SoakOrder(
        town=town,
        config=load_run_config("quick"),
        seconds=60.0 * options.minutes,
        folder=folder,
        clients=options.clients,
        seed=options.seed,
        lease_s=options.lease,
        recovery=options.recovery,
    )
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("soaking", total=order.seconds)
        return soak(order, lambda done_s: bar.update(task, completed=done_s))


def _print(facts: SoakFacts) -> None:
    console = Console(highlight=False)
    for key, value in result(facts).items():
        console.print(f"{key:<24}{'-' if value is None else f'{value:.4g}' if isinstance(value, float) else value}")
    wrong = faults_of(facts)
    console.print("all as it should be" if not wrong else f"not as it should be: {', '.join(wrong)}")


def _p99(values_s: tuple[float, ...]) -> float | None:
    import numpy as np  # --help does without

    return float(np.percentile(values_s, 99)) if values_s else None
