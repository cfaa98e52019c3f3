"""Several networks learn at once in one world, each in a process of its own; and what came of it, told at the end."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich import box

from wcsim.agents.clients.group_run import (
    Client,
    ClientsFolder,
    GroupRun,
    client_plan,
    create_clients_folder,
    open_clients_folder,
    world_order,
)
from wcsim.agents.clients.paid_times import PaidTimes, PaidTimesLog
from wcsim.agents.opening.learner_registry import Q_LEARNING
from wcsim.agents.runs.run_folder import (
    MANIFEST,
    Status,
    extend,
    how_to_resume,
    make_manifest,
    open_run,
)
from wcsim.cli.shared.common import Lease, Worlds, check_folder, write_json
from wcsim.cli.shared.consoles import print_overrides, show_table, stdout_console, warn
from wcsim.cli.shared.exit_codes import Exit, NothingKept
from wcsim.cli.shared.run_config import how_to_test
from wcsim.cli.shared.training import OutputOptions, print_crossings
from wcsim.core.files import locked
from wcsim.core.own_folder import workplace
from wcsim.core.processes import StopSignals
from wcsim.errors import (
    ConfigError,
    DiskFullError,
    InterruptedRunError,
    JournalError,
    WcsimError,
)
from wcsim.log.reader import iter_inputs, log_digest, part_files
from wcsim.log.writer import JOURNAL, LogWriter, told_torn
from wcsim.server.launch.launcher import Launcher
from wcsim.server.launch.states import (
    ClientState,
    LaunchOutcome,
    LaunchRules,
    LaunchState,
    RestartRules,
)
from wcsim.server.ledger import Audit, audit, iter_ledger
from wcsim.server.protocol.limits import require_files
from wcsim.server.specs import world_plan
from wcsim.towns.scenario.town import Town
from wcsim.view.live_table import LiveTable


class _TickRate:
    """Ticks a second over a run, restarts of the world included, loading at the beginning left out."""

    def __init__(self) -> None:
        self._ticks = 0  # in all
        self._last = 0  # of this life of the world
        self._begun_s = self._ended_s = -1.0
        self._at_begin = 0

    def add(self, state: LaunchState) -> bool:
        """Take in how things are; True when the world has just begun to tick."""
        now = 0 if state.world is None else state.world.ticks
        self._ticks += now - self._last if now >= self._last else now
        self._last = now
        if self._ticks == 0:
            return False
        first = self._begun_s < 0.0
        if first:
            self._begun_s, self._at_begin = state.elapsed_s, self._ticks
        if not state.stopping:
            self._ended_s = state.elapsed_s
        return first

    @property
    def ticks_per_s(self) -> float:
        """The mean; 0 when it is not known."""
        spent_s = self._ended_s - self._begun_s
        return (self._ticks - self._at_begin) / spent_s if spent_s > 0.0 else 0.0


def _report_of(
    folder: ClientsFolder, seed: int, rate: _TickRate, waits: PaidTimes
) -> dict[str, Any]:
    """How a run ended, as `--json` has it: ledgers are compared with the journal, whose hash is equal for equal runs.

    Raises:
        WcsimError: One cannot be read.
    """
    path = folder.path / JOURNAL
    journal = path if part_files(path) else None
    ledgers = [folder.ledger(name) for name in folder.clients]
    entries = [iter_ledger(ledger) if ledger.is_file() else () for ledger in ledgers]
    whole, against = audit(
        () if journal is None else iter_inputs(journal), list(enumerate(entries))
    )
    rows = [_steps_of(ledger, journal, one) for ledger, one in zip(ledgers, against, strict=True)]
    return {
        "run": str(folder.path),
        "town": ", ".join((folder.manifest.town, *folder.manifest.more_towns)),
        "seed": seed,
        "status": folder.manifest.status,
        "clients": [{"name": name, **row} for name, row in zip(folder.clients, rows, strict=True)],
        "ticks": whole.ticks,
        "journal_hash": "" if journal is None else log_digest(path),
        "ticks_per_s": rate.ticks_per_s,
        "waits": asdict(waits),
    }


def _steps_of(ledger: Path, journal: Path | None, against: Audit) -> dict[str, int]:
    """The steps of one client, counted in its ledger and compared with the journal.

    Missing are those that the world did with its action and that it never saw. Doubled ones it saw twice, or the world
    never did.
    """
    if journal is None and against.first_tick >= 0:
        raise WcsimError(
            f"{ledger}: has frames of a world without a journal; restore {JOURNAL} next to its folder"
        )
    return {
        "first_tick": against.first_tick,  # -1 when it never had a frame
        "last_tick": against.last_tick,
        "ticks": against.steps,
        "missing": max(against.missing, against.lost),
        "duplicated": against.doubled + against.phantom,
    }


def _print_report(report: Mapping[str, Any], waits: PaidTimes) -> None:
    """The report as a table."""
    headings = ("client", "first tick", "last tick", "ticks", "missing", "duplicated")
    rows = (map(str, client.values()) for client in report["clients"])
    show_table(headings, rows, box=box.SIMPLE_HEAD, pad_edge=False)
    if len(waits.clients) > 1:
        paid = ("client", "acting s", "learning s", "waiting s", "mostly for")
        show_table(paid, _paid(waits), box=box.SIMPLE_HEAD, pad_edge=False)
    stdout_console().print(
        f"{report['ticks']} world ticks, {report['ticks_per_s']:.1f} per second; journal hash {report['journal_hash']}",
        soft_wrap=True,
    )


def _paid(waits: PaidTimes) -> Iterator[tuple[str, ...]]:
    """What each client paid, and for whom it waited most; the page of `wcsim report` has all pairs."""
    for name, paid in waits.clients.items():
        waited = waits.waited_s.get(name, {})
        whom = max(waited, key=lambda other: waited[other], default="")
        most = f"{whom} ({waited[whom]:.1f})" if whom and waited[whom] > 0.0 else "-"
        yield (
            name,
            *(f"{part_s:.1f}" for part_s in (paid.acting_s, paid.learning_s, paid.waiting_s)),
            most,
        )


LEASE_S = 120.0
ALL_DONE = LaunchOutcome(code=0, message="", stopped=False, clients=())


@dataclass(kw_only=True)
class GroupOptions(OutputOptions):
    """How the processes of several clients are run."""

    worlds: Worlds = None
    """Worker processes that compare clients by a suite or list. None: one per core, at most 4."""
    lease: Lease = LEASE_S
    """Seconds without progress after which a client is restarted."""


def train_clients(
    options: GroupOptions,
    run: GroupRun,
    town: Town,
    watch: Callable[[LaunchState], bool] = lambda state: False,
    restarts: RestartRules | None = None,
) -> int:
    """Train them all; returns the exit code: FAILED when a client was given up, or the world.

    Args:
        options: How it is run.
        run: The clients, and where their run goes.
        town: The town.
        watch: Told how things are a few times a second; the run is stopped, as by SIGTERM, when it says True.
        restarts: When a process that dies is given up, for a run whose processes somebody kills on purpose.

    Raises:
        InterruptedRunError: The user stopped it.
        NothingKept: ... before anything was done.
        WcsimError: Something that was asked for cannot be used.
    """
    check_folder("--out", run.out)
    require_files(len(run.clients))
    with StopSignals() as signals, ExitStack() as held:
        folder = held.enter_context(_opened(run))
        place = held.enter_context(workplace())
        left = tuple(client for client in run.clients if not folder.done(client.name, client.steps))
        plans = [client_plan(run, folder, place, client) for client in left]
        order = world_order(run, town.address, folder, place, len(left), options.lease)
        world = world_plan(order, place, folder.log("world"))
        rate, paid = _TickRate(), PaidTimesLog(folder.path)
        held.callback(paid.save)
        with LiveTable() as table:

            def show(state: LaunchState) -> None:
                paid.add(state)
                paid.save_each(state.elapsed_s)
                if rate.add(state):
                    note = Q_LEARNING.describe(run.clients[0].config)
                    notes, told = () if run.resume else (note,), run.info.overrides
                    print_overrides(
                        table.console, town.name, told, notes, verbose=options.verbose, kept=True
                    )
                table.show(state)
                if watch(state) and not state.stopping:
                    launcher.stop()

            again = RestartRules() if restarts is None else restarts
            rules = LaunchRules(client_lease_s=max(30.0, options.lease), client=again, world=again)
            launcher = Launcher(world, plans, folder.path, rules, show, signals=signals)
            outcome = launcher.run() if left else ALL_DONE
        code = _told(run, folder, options.json, outcome, (rate, paid.times))
    if (
        signals.count and not run.last
    ):  # one that came when nothing ran any more, and what is to follow has not begun
        raise InterruptedRunError(
            f"stopped; {run.out} holds the training so far: {how_to_resume(run.out)}"
        )
    return code


@contextmanager
def _opened(run: GroupRun) -> Iterator[ClientsFolder]:
    """The run folder, new or gone on with, for this process alone; a new one is removed when nothing came of it."""
    configs = {client.name: client.config for client in run.clients}
    world = run.clients[0].config
    if run.resume:
        with locked(run.out):
            folder = open_clients_folder(run.out)
            _mend(folder)
            for client in run.clients:
                _lengthen(folder.path / client.name, client)
            folder.rewrite(configs)
            yield folder.with_status("running", folder.manifest.steps)
        return
    wanted = make_manifest(world, run.info, [config.learn.network for config in configs.values()])
    made = not run.out.exists()
    if made:
        run.out.mkdir(parents=True)
    with locked(run.out):
        begun: ClientsFolder | None = None
        try:
            yield (begun := create_clients_folder(run.out, world, wanted, configs))
        except (WcsimError, NothingKept) as error:
            if (
                made
                if begun is None
                else not isinstance(error, DiskFullError) and begun.fruitless()
            ):
                shutil.rmtree(run.out, ignore_errors=True)
            raise


def _lengthen(run: Path, client: Client) -> None:
    """Let a client's own run folder, where there is one, be as long as the client learns now."""
    if not (run / MANIFEST).is_file():
        return
    learn = open_run(run).config.learn
    # A rate that fades does so in the last part alone.
    fade = client.config.learn.learning_rate_fade if client.until is None else 0.0
    if (learn.total_steps, learn.learning_rate_fade) != (client.steps, fade):
        extend(run, client.steps, fade)


def _mend(folder: ClientsFolder) -> None:
    """Cut off what was torn when a process died, and say so. Raises JournalError when something else is damaged."""
    path = folder.path / JOURNAL
    ledgers = [file for file in map(folder.ledger, folder.clients) if file.is_file()]
    if not part_files(path) and any(True for file in ledgers for _ in iter_ledger(file)):
        raise JournalError(
            f"{path}: is missing, but the ledgers contain ticks; restore it, or start a new run"
        )
    for log in ([path] if path.exists() else []) + ledgers:
        with LogWriter.append_to(log) as writer:
            if writer.cut_bytes:
                warn(told_torn(log, writer.cut_bytes))


def _told(
    run: GroupRun,
    folder: ClientsFolder,
    json: Path | None,
    outcome: LaunchOutcome,
    seen: tuple[_TickRate, PaidTimes],
) -> int:
    """Write down how it ended and say so; returns the exit code.

    Raises:
        InterruptedRunError: It was stopped.
        NothingKept: ... before anything was done.
        ConfigError: A client or the world could not use what was asked for.
    """
    if outcome.stopped and folder.fruitless() and not run.resume:
        raise NothingKept("stopped before anything was learned; nothing is saved")
    told = {
        client.name: client.status.step for client in outcome.clients if client.status is not None
    }
    steps = sum(
        max(told.get(name, 0), folder.steps(name)) for name in folder.clients
    )  # not all were launched
    folder = _with_status(run, folder, steps)
    if outcome.code == Exit.REFUSED:
        raise ConfigError(outcome.message)
    report = _report_of(folder, run.info.seed, *seen)
    _print_report(report, seen[1])
    for kept in folder.truncated_parts():
        warn(f"{kept}: a truncated end was cut off earlier")
    write_json(json, report)
    if outcome.stopped:
        raise InterruptedRunError(_told_stop(folder.path, outcome.clients))
    if outcome.code:
        lost = "".join(
            f"; client {each.name} {each.unsaved}" for each in outcome.clients if each.unsaved
        )
        again = f"{folder.path} is kept; continue it: {how_to_resume(folder.path)}"
        warn(f"{outcome.message}{lost}; {again}")
        return Exit.FAILED
    print_crossings(folder.path)
    if run.last:
        tested = folder.path / (run.best or folder.clients[0])
        trained_in = (run.info.town, *run.info.more_towns)
        print(f"run folder: {folder.path}    test one: {how_to_test(tested, '', trained_in)}")
    return Exit.DONE


def _told_stop(path: Path, clients: Sequence[ClientState]) -> str:
    """What a run leaves that was stopped, by all of its clients or by some."""
    given_up = {client.name: client.reason for client in clients if client.standing == "given up"}
    why = {client.name: client.unsaved for client in clients} | given_up
    lost = [f"client {name} {told}" for name, told in why.items() if told]
    if not lost:
        return f"stopped; {path} holds the training so far; continue it: {how_to_resume(path)}"
    return (
        f"stopped, but {'; '.join(lost)}: the training since its last checkpoint is lost; {path} holds the rest; "
        f"continue it: {how_to_resume(path)}"
    )


def _with_status(run: GroupRun, folder: ClientsFolder, steps: int) -> ClientsFolder:
    """Write down whether the run is done, where there is room."""
    done = all(folder.done(client.name, client.steps) for client in run.clients)
    status: Status = "done" if done and run.last else "interrupted"
    try:
        return folder.with_status(status, steps)
    except DiskFullError as error:  # the work is there all the same
        warn(str(error))
        return folder
