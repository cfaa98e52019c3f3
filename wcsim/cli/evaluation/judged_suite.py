"""`wcsim test --suite`: policies judged on a fixed list of episodes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console

from wcsim.agents.policy_api import BASELINES, UPPER_BOUNDS
from wcsim.cli.evaluation.play import play_episode
from wcsim.cli.evaluation.result_tables import show_result, show_sensitivity
from wcsim.cli.shared.common import (
    OutFile,
    OutFolder,
    Repeated,
    check_folder,
    in_bounds,
    json_text,
    machines_of,
    parse,
    result_file,
    said_of,
    write_json,
)
from wcsim.cli.shared.consoles import stderr_console, stdout_console
from wcsim.cli.shared.exit_codes import Exit
from wcsim.cli.shared.run_config import require_unset
from wcsim.core.reading import counted
from wcsim.errors import ConfigError, InterruptedRunError
from wcsim.server.workers.crew import WorkerNow
from wcsim.server.workers.machines import Machines

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.agents.evaluation.suite.list_file import Suite
    from wcsim.agents.evaluation.suite.records import EpisodeRecord
    from wcsim.agents.evaluation.suite.run import SuiteOrder

_TOLD_EVERY_S = 20.0
_KEPT = "kept/*.json"  # blocks that are done
_LISTED = {
    "env.profile": "each episode of a list has its own user; choose it with --town and --profile, no --suite",
    "env.max_steps": "each episode of a list has its own step limit; set it with --town and --max-steps, no --suite",
}


@dataclass
class SuiteOptions:
    """Test policies on a fixed list of routes, crossings, hazards and tight places."""

    policies: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[POLICY ...]")] = ()
    """Run folders, policy folders, module:Class, or baselines. All baselines are added unless --only."""
    suite: str = ""
    """The list: one that comes with wcsim (dev, validation, v1), or a file of --make-suite."""
    jobs: int = 1
    """Parallel processes; the result is the same for any number."""
    cluster: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = ""
    """HOST:PORT of a Ray cluster whose nodes drive, or `local`; the result is the same (docs/cluster.md)."""
    out: OutFolder = None
    """Folder for the result and for finished blocks. (default: runs/suite-SET)"""
    resume: bool = False
    """Continue in a folder that holds finished blocks of this test."""
    only: bool = False
    """Drive only these policies and the user alone, no other baselines."""
    clean: bool = False
    """Turn off camera noise and delay; IMU and odometry keep their errors."""
    sensitivity: bool = False
    """Drive these policies and the user alone without disturbances, and with each alone: which changes the score?"""
    forks: int | None = None
    """Episodes whose interventions are judged: the user drives on alone in a copy. (default: as in the list)"""
    preset: str = "quick"
    """Settings of policies that have none. Its rules for street, chair and crashes apply to all policies."""
    set: Repeated = ()
    """section.key=value, over the settings of the list; the result names it."""
    network: str = ""
    """Your own network as module:Class, for runs that were trained with it."""
    play: Annotated[str, tyro.conf.arg(metavar="BLOCK.SEAT")] = ""
    """Drive this episode of one policy again, film its last 10 s into --out, and print what happened."""
    json: OutFile = None
    """Also write the result to this file."""


def run_suites(words: list[str]) -> int:
    """Judge policies on a list; a table for each part and one for all."""
    options = parse(SuiteOptions, words, "test")
    machines_of(options.cluster, options.jobs, "--jobs")
    require_unset(options.set, _LISTED)
    in_bounds("--forks", 0 if options.forks is None else options.forks, 0, 1_000_000)
    _require_heard(options)
    from wcsim.agents.evaluation.suite.list_file import open_suite

    suite = open_suite(options.suite)
    out = options.out or Path("runs") / f"suite-{suite.file.set}"
    check_folder("--out", out / "x")
    if options.play:
        return play_episode(_order(options, suite, out), options.policies, options.play)
    if (out / "kept").exists() and not options.resume:
        raise ConfigError(
            f"--out {out}: it holds blocks of an earlier test; continue them with --resume, or choose another folder"
        )
    from wcsim.agents.evaluation.suite.list_rules import told_of_rules
    from wcsim.agents.evaluation.suite.run import UNAIDED, require_usable

    added = () if options.only or options.sensitivity else (*BASELINES, *UPPER_BOUNDS)
    names = tuple(dict.fromkeys((UNAIDED, *options.policies, *added)))
    told = stderr_console()
    order = replace(_order(options, suite, out), machines=_machines(options, told), look=_look(options, told))
    listed = f"{suite.file.suite} {suite.file.set}, list {suite.sha256[:12]}"
    told.print(f"{listed}: {counted(suite.episodes, 'episode')} a policy", markup=False)
    for line in told_of_rules(names, order.preset, (*suite.file.settings, *order.settings)):
        told.print(line, markup=False)
    require_usable(order, options.policies)

    def say(text: str) -> None:
        told.print(text, style="dim", markup=False)

    before = set() if options.resume else set(out.rglob(_KEPT))  # of another test in the same folder
    try:
        return (_disturb if options.sensitivity else _judge)(order, options, names, say)
    except KeyboardInterrupt:
        if not set(out.rglob(_KEPT)) - before:
            raise
        raise InterruptedRunError(f"stopped; finished blocks are saved in {out}; continue with --resume") from None


def _require_heard(options: SuiteOptions) -> None:
    """Refuse options that would not be heard of beside others. Raises ConfigError."""
    asked = {"--forks": options.forks is not None, "--sensitivity": options.sensitivity, "--json": bool(options.json)}
    deaf = (("--play", bool(options.play), tuple(asked)), ("--sensitivity", options.sensitivity, ("--forks",)))
    for option, is_asked, others in deaf:
        found = ", ".join(other for other in others if asked[other])
        if is_asked and found:
            raise ConfigError(f"{option} ignores {found}; use one without the other")


def _judge(order: SuiteOrder, options: SuiteOptions, names: Sequence[str], say: Callable[[str], None]) -> int:
    """Drive the list with each policy; how the command ends."""
    from wcsim.agents.evaluation.suite.records import undriven
    from wcsim.agents.evaluation.suite.result_files import read_result
    from wcsim.agents.evaluation.suite.run import run_suite
    from wcsim.view.report.comparisons import verdict

    records = run_suite(order, names, lambda name, done, of: say(f"{name}: {done} of {of} blocks"))
    result = keep_result(order, options.suite, records)
    without = [line for name, found in records.items() for line in undriven(name, found)]
    show_result(stdout_console(), result, order.settings, without, verdict(read_result(order.out)))
    if options.json is not None:
        write_json(options.json, result)
    return _exit_of(result["pooled"])


def _disturb(order: SuiteOrder, options: SuiteOptions, names: Sequence[str], say: Callable[[str], None]) -> int:
    """Drive the list with each disturbance alone; how the command ends."""
    from wcsim.agents.evaluation.suite.sensitivity import sensitivity

    file = order.suite.file
    moved = sensitivity(order, names, say)
    write_json(order.out / "sensitivity.json", moved)
    show_sensitivity(stdout_console(), f"{file.suite} {file.set}", moved)
    if options.json is not None:
        write_json(options.json, {"suite": file.suite, "set": file.set, "rows": moved})
    return _exit_of(moved)


def _exit_of(rows: Iterable[Mapping[str, Any]]) -> Exit:
    """A policy that came to the end of no episode has no result, whatever its row says."""
    from wcsim.agents.evaluation.suite.rows import undone

    return Exit.FAILED if any(undone(row) == int(row["episodes"]) > 0 for row in rows) else Exit.DONE


def _machines(options: SuiteOptions, told: Console) -> Machines:
    machines = machines_of(options.cluster, options.jobs, "--jobs")
    return replace(machines, say=lambda text: told.print(text, markup=False, style="dim"))


def _look(options: SuiteOptions, told: Console) -> Callable[[tuple[WorkerNow, ...]], object]:
    """Says now and then who drives what, where that is another machine."""
    said_s = time.monotonic()

    def look(workers: tuple[WorkerNow, ...]) -> None:
        nonlocal said_s
        if options.cluster and time.monotonic() - said_s > _TOLD_EVERY_S:
            said_s = time.monotonic()
            told.print(said_of(workers), markup=False, style="dim")

    return look


def _order(options: SuiteOptions, suite: Suite, out: Path) -> SuiteOrder:
    from wcsim.agents.evaluation.suite.run import SuiteOrder
    from wcsim.agents.evaluation.suite.sensitivity import CLEAN

    return SuiteOrder(
        suite=suite,
        out=out,
        jobs=options.jobs,
        preset=options.preset,
        settings=(*(CLEAN if options.clean and not options.sensitivity else ()), *options.set),  # that is clean anyway
        network=options.network,
        forks=suite.file.forks if options.forks is None else options.forks,
    )


def keep_result(order: SuiteOrder, name: str, records: Mapping[str, Sequence[EpisodeRecord]]) -> dict[str, Any]:
    """Write what a test leaves in its folder; the result.

    Args:
        order: What was driven.
        name: The list, as it was asked for.
        records: Of the user alone and of the policies.

    Raises:
        DiskFullError: There is no room.
    """
    from wcsim.agents.evaluation.suite.result_files import ASKED, EPISODES, RESULT
    from wcsim.agents.evaluation.suite.rows import pooled_rows, result_of
    from wcsim.agents.evaluation.suite.run import UNAIDED

    rows, pooled = [], []
    for policy, found in records.items():
        parts, whole = pooled_rows(policy, found, records[UNAIDED])
        rows += parts
        pooled.append(whole)
    suite = order.suite
    result = {**result_of(suite.file, suite.sha256, rows, pooled), "changed": list(order.settings)}
    episodes = {policy: [record.to_json() for record in found] for policy, found in records.items()}
    asked = {"suite": name, "preset": order.preset, "network": order.network, "out": str(order.out)}

    with ExitStack() as held:  # all of it first: a full disk leaves what an earlier test wrote as it was
        for file, said in ((RESULT, result), (EPISODES, episodes), (ASKED, asked)):
            part = held.enter_context(result_file(order.out / file))
            part.write_text(json_text(order.out / file, said), encoding="utf-8")
    return result
