"""Trains several networks at once in one world, in a process each, and reports their run."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from rich import box

from wcsim.agents.clients.group_run import (
    GroupRunFolder,
    ResolvedClient,
    ResolvedGroupRun,
    create_group_run_folder,
    make_client_plan,
    make_world_spec,
    open_group_run_folder,
)
from wcsim.agents.clients.paid_times import GroupRunTimes, GroupRunTimesFile
from wcsim.agents.opening.learner_registry import Q_LEARNING
from wcsim.agents.runs.run_folder import (
    MANIFEST,
    Status,
    extend_run_steps,
    format_resume_command,
    make_run_manifest,
    open_run,
)
from wcsim.cli.shared.common import Lease, Worlds, require_writable_folder, write_json
from wcsim.cli.shared.consoles import print_sumo_overrides, show_table, stdout_console, warn
from wcsim.cli.shared.exit_codes import ExitCode, NothingSavedInterrupt
from wcsim.cli.shared.run_config import format_test_command
from wcsim.cli.shared.training import print_kpi1_limit_steps
from wcsim.cli.shared.training_options import OutputOptions
from wcsim.core.files import lock_run_folder
from wcsim.core.own_folder import create_runtime_folder
from wcsim.core.processes import StopSignalCounter
from wcsim.errors import ConfigError, DiskFullError, InterruptedRunError, JournalError, WcsimError
from wcsim.log.reader import hash_log, iter_journal_inputs, list_log_parts
from wcsim.log.writer import JOURNAL, LogWriter, format_truncation_warning
from wcsim.server.launch.launcher import ProcessLauncher
from wcsim.server.launch.states import (
    ClientProcessState,
    LauncherTimeouts,
    LaunchProcessStates,
    LaunchResult,
    ProcessRestartRules,
)
from wcsim.server.ledger import LedgerAuditResult, audit_ledgers, iter_ledger_frames
from wcsim.server.protocol.limits import ensure_open_file_limit
from wcsim.server.specs import make_world_launch_plan
from wcsim.towns.scenario.town import Town
from wcsim.view.live_table import LiveTable

LEASE_S: Final = 120.0

# Clients whose run is done when nothing is left to launch.
ALL_DONE: Final = LaunchResult(code=0, message="", stopped=False, clients=())


@dataclass(kw_only=True)
class ClientProcessOptions(OutputOptions):
    """How the processes of several clients are run."""

    worlds: Worlds = None
    """Worker processes that compare clients by a suite or list. None: one per core, at most 4."""
    lease: Lease = LEASE_S
    """Seconds without progress after which a client is restarted."""


def train_clients(
    options: ClientProcessOptions,
    run: ResolvedGroupRun,
    town: Town,
    watch: Callable[[LaunchProcessStates], bool] = lambda state: False,
    restarts: ProcessRestartRules | None = None,
) -> int:
    """Train all clients; returns the exit code: FAILED when a client or the world was given up.

    Args:
        options: How the processes are run.
        run: The clients, and their run folder.
        town: The town.
        watch: Called with the state a few times a second; True stops the run, as SIGTERM does.
        restarts: When a process that dies is given up; for runs whose processes are killed on
            purpose.

    Raises:
        InterruptedRunError: The user stopped it.
        NothingSavedInterrupt: ... before anything was done.
        WcsimError: A setting, the folder or the world cannot be used.
    """
    require_writable_folder("--out", run.out)
    ensure_open_file_limit(len(run.clients))
    with StopSignalCounter() as signals, ExitStack() as stack:
        # 1. Open the run folder, and plan a process for the world and for each client.
        folder = stack.enter_context(_opened(run))
        place = stack.enter_context(create_runtime_folder())
        left = [client for client in run.clients if not folder.done(client.name, client.steps)]
        plans = tuple(make_client_plan(run, folder, place, client) for client in left)
        order = make_world_spec(run, town.address, folder, place, len(left), options.lease)
        world = make_world_launch_plan(order, place, folder.log("world"))
        rate = _TickRate()
        paid = GroupRunTimesFile(folder.path)
        stack.callback(paid.save)

        # 2. Launch them, and show their state until all are done.
        with LiveTable() as table:

            def show(state: LaunchProcessStates) -> None:
                paid.add(state)
                paid.save_each(state.elapsed_s)
                if rate.add(state):
                    note = Q_LEARNING.describe(run.clients[0].config)
                    print_sumo_overrides(
                        table.console,
                        town.name,
                        run.info.overrides,
                        () if run.resume else (note,),
                        verbose=options.verbose,
                        in_manifest=True,
                    )
                table.show(state)
                if watch(state) and not state.stopping:
                    launcher.stop()

            again = ProcessRestartRules() if restarts is None else restarts
            rules = LauncherTimeouts(
                client_lease_s=max(30.0, options.lease), client=again, world=again
            )
            launcher = ProcessLauncher(world, plans, folder.path, rules, show, signals=signals)
            outcome = launcher.run() if left else ALL_DONE

        # 3. Write the status, and report.
        code = _finish(run, folder, options.json, outcome, (rate, paid.times))

    # A signal may arrive when nothing runs any more; without it the next phase would start.
    if signals.count and not run.last:
        raise InterruptedRunError(
            f"stopped; {run.out} holds the training so far: {format_resume_command(run.out)}"
        )
    return code


@contextmanager
def _opened(run: ResolvedGroupRun) -> Iterator[GroupRunFolder]:
    """The run folder, new or to resume, locked; a new one in which nothing was done is removed.

    `remove_run_without_results` does so for a run of one network.
    """
    configs = {client.name: client.config for client in run.clients}
    if run.resume:
        with lock_run_folder(run.out):
            folder = open_group_run_folder(run.out)
            _cut_truncated(folder)
            for client in run.clients:
                _lengthen(folder.path / client.name, client)
            folder.rewrite(configs)
            yield folder.with_status("running", folder.manifest.steps)
        return
    world = run.clients[0].config
    manifest = make_run_manifest(world, run.info, [each.learn.network for each in configs.values()])
    made = not run.out.exists()
    if made:
        run.out.mkdir(parents=True)
    with lock_run_folder(run.out):
        created: GroupRunFolder | None = None
        try:
            created = create_group_run_folder(run.out, world, manifest, configs)
            yield created
        except (WcsimError, NothingSavedInterrupt) as error:
            if created is None:
                remove = made
            else:
                # After a full disk wcsim resume goes on.
                remove = not isinstance(error, DiskFullError) and created.fruitless()
            if remove:
                shutil.rmtree(run.out, ignore_errors=True)
            raise


def _cut_truncated(folder: GroupRunFolder) -> None:
    """Cut off records that were truncated when a process died, and warn of each cut.

    Raises:
        JournalError: A log is damaged elsewhere.
    """
    path = folder.path / JOURNAL
    ledgers = [file for file in map(folder.ledger, folder.clients) if file.is_file()]
    if not list_log_parts(path) and any(True for file in ledgers for _ in iter_ledger_frames(file)):
        raise JournalError(
            f"{path}: is missing, but the ledgers contain ticks; restore it, or start a new run"
        )
    for log in ([path] if path.exists() else []) + ledgers:
        with LogWriter.append_to(log) as writer:
            if writer.cut_bytes:
                warn(format_truncation_warning(log, writer.cut_bytes))


def _lengthen(run: Path, client: ResolvedClient) -> None:
    """Let a client's own run folder, where there is one, be as long as the client learns now."""
    if not (run / MANIFEST).is_file():
        return
    learn = open_run(run).config.learn
    # A rate that fades does so in the last part alone.
    fade = client.config.learn.learning_rate_fade if client.until is None else 0.0
    if (learn.total_steps, learn.learning_rate_fade) != (client.steps, fade):
        extend_run_steps(run, client.steps, fade)


def _finish(
    run: ResolvedGroupRun,
    folder: GroupRunFolder,
    json: Path | None,
    outcome: LaunchResult,
    measured: tuple[_TickRate, GroupRunTimes],
) -> int:
    """Write how the run ended, and report it; returns the exit code.

    Raises:
        InterruptedRunError: It was stopped.
        NothingSavedInterrupt: ... before anything was done.
        ConfigError: A client or the world could not use a setting.
    """
    if outcome.stopped and folder.fruitless() and not run.resume:
        raise NothingSavedInterrupt("stopped before anything was learned; nothing is saved")
    # Of clients that were not launched the folder alone knows the steps.
    reported = {each.name: each.status.step for each in outcome.clients if each.status is not None}
    steps = sum(max(reported.get(name, 0), folder.steps(name)) for name in folder.clients)
    folder = _with_status(run, folder, steps)
    if outcome.code == ExitCode.REFUSED:
        raise ConfigError(outcome.message)
    report = _report_of(folder, run.info.seed, *measured)
    _print_report(report, measured[1])
    for part in folder.truncated_parts():
        warn(f"{part}: a truncated end was cut off earlier")
    write_json(json, report)
    if outcome.stopped:
        raise InterruptedRunError(_stop_message(folder.path, outcome.clients))
    if outcome.code:
        unsaved = [
            f"; client {each.name} {each.unsaved}" for each in outcome.clients if each.unsaved
        ]
        again = f"{folder.path} is kept; continue it: {format_resume_command(folder.path)}"
        warn(f"{outcome.message}{''.join(unsaved)}; {again}")
        return ExitCode.FAILED
    print_kpi1_limit_steps(folder.path)
    if run.last:
        best = folder.path / (run.best or folder.clients[0])
        test = format_test_command(best, "", (run.info.town, *run.info.more_towns))
        print(f"run folder: {folder.path}    test one: {test}")
    return ExitCode.DONE


def _with_status(run: ResolvedGroupRun, folder: GroupRunFolder, steps: int) -> GroupRunFolder:
    """Write whether the run is done, where there is room."""
    done = all(folder.done(client.name, client.steps) for client in run.clients)
    status: Status = "done" if done and run.last else "interrupted"
    try:
        return folder.with_status(status, steps)
    except DiskFullError as error:  # the work is there all the same
        warn(str(error))
        return folder


def _stop_message(path: Path, clients: Sequence[ClientProcessState]) -> str:
    """The message of a run that was stopped by its user: what it holds, and what is lost."""
    reasons = {client.name: client.unsaved for client in clients}
    for client in clients:
        if client.standing == "given up":
            reasons[client.name] = client.reason
    lost = [f"client {name} {reason}" for name, reason in reasons.items() if reason]
    if not lost:
        return (
            f"stopped; {path} holds the training so far; continue it: {format_resume_command(path)}"
        )
    return (
        f"stopped, but {'; '.join(lost)}: the training since its last checkpoint is lost; {path} "
        f"holds the rest; continue it: {format_resume_command(path)}"
    )


class _TickRate:
    """Ticks a second over a run, with restarts of the world, and without the first loading."""

    def __init__(self) -> None:
        self._ticks = 0  # in all
        self._last = 0  # of the present world
        self._started_s = -1.0
        self._ended_s = -1.0
        self._at_start = 0

    def add(self, state: LaunchProcessStates) -> bool:
        """Add a state; True when the world has just started to tick."""
        now = 0 if state.world is None else state.world.ticks
        # A restarted world counts from zero.
        self._ticks += now - self._last if now >= self._last else now
        self._last = now
        if self._ticks == 0:
            return False
        first = self._started_s < 0.0
        if first:
            self._started_s = state.elapsed_s
            self._at_start = self._ticks
        if not state.stopping:
            self._ended_s = state.elapsed_s
        return first

    @property
    def ticks_per_s(self) -> float:
        """The mean; 0 when it is not known."""
        spent_s = self._ended_s - self._started_s
        return (self._ticks - self._at_start) / spent_s if spent_s > 0.0 else 0.0


def _report_of(
    folder: GroupRunFolder, seed: int, rate: _TickRate, waits: GroupRunTimes
) -> dict[str, Any]:
    """The report of a run, as `--json` has it.

    Ledgers are compared with the journal, whose hash is equal for equal runs.

    Raises:
        WcsimError: A log cannot be read.
    """
    path = folder.path / JOURNAL
    journal = path if list_log_parts(path) else None
    ledgers = [folder.ledger(name) for name in folder.clients]
    entries = [iter_ledger_frames(ledger) if ledger.is_file() else () for ledger in ledgers]
    inputs = () if journal is None else iter_journal_inputs(journal)
    whole, audits = audit_ledgers(inputs, list(enumerate(entries)))
    rows = [_steps_of(ledger, journal, one) for ledger, one in zip(ledgers, audits, strict=True)]
    return {
        "run": str(folder.path),
        "town": ", ".join((folder.manifest.town, *folder.manifest.more_towns)),
        "seed": seed,
        "status": folder.manifest.status,
        "clients": [{"name": name, **row} for name, row in zip(folder.clients, rows, strict=True)],
        "ticks": whole.ticks,
        "journal_hash": "" if journal is None else hash_log(path),
        "ticks_per_s": rate.ticks_per_s,
        "waits": asdict(waits),
    }


def _steps_of(ledger: Path, journal: Path | None, counts: LedgerAuditResult) -> dict[str, int]:
    """The steps of one client, counted in its ledger and compared with the journal.

    Missing are steps that the world did with its action and that it never saw. Doubled are steps
    that it saw twice, or that the world never did.
    """
    if journal is None and counts.first_tick >= 0:
        raise WcsimError(
            f"{ledger}: has frames of a world without a journal; restore {JOURNAL} next to its "
            "folder"
        )
    return {
        "first_tick": counts.first_tick,  # -1 when it never had a frame
        "last_tick": counts.last_tick,
        "ticks": counts.steps,
        "missing": max(counts.missing, counts.lost),
        "duplicated": counts.doubled + counts.phantom,
    }


def _print_report(report: Mapping[str, Any], waits: GroupRunTimes) -> None:
    """Print the report as tables."""
    headings = ("client", "first tick", "last tick", "ticks", "missing", "duplicated")
    rows = (map(str, client.values()) for client in report["clients"])
    show_table(headings, rows, box=box.SIMPLE_HEAD, pad_edge=False)
    if len(waits.clients) > 1:
        paid_rows = []
        for name, paid in waits.clients.items():
            waited_s = waits.waited_s.get(name, {})
            longest = max(waited_s, key=lambda other: waited_s[other], default="")
            most = "-"
            if longest and waited_s[longest] > 0.0:
                most = f"{longest} ({waited_s[longest]:.1f})"
            parts_s = (paid.acting_s, paid.learning_s, paid.waiting_s)
            paid_rows.append((name, *(f"{part_s:.1f}" for part_s in parts_s), most))
        paid_for = ("client", "acting s", "learning s", "waiting s", "mostly for")
        show_table(paid_for, paid_rows, box=box.SIMPLE_HEAD, pad_edge=False)
    stdout_console().print(
        f"{report['ticks']} world ticks, {report['ticks_per_s']:.1f} per second; "
        f"journal hash {report['journal_hash']}",
        soft_wrap=True,
    )
