"""`wcsim train --clients A,B,...`: several networks learn at once in one world, each in a process of its own."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from wcsim.agents.clients.clients_folder import (
    ClientsFolder,
    create_clients_folder,
    open_clients_folder,
    rewrite_client_configs,
)
from wcsim.agents.clients.group_run import Client, GroupRun, WorldTerms, client_plan, world_order
from wcsim.agents.clients.paid_times import PaidTimes, PaidTimesLog
from wcsim.agents.networks.names import NETWORK_NAMES, client_name
from wcsim.agents.runs.run_folder import MANIFEST, Status, extend, make_manifest, open_run
from wcsim.cli.shared.common import check_folder, in_bounds, some_words, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.cli.shared.exit_codes import Exit, NothingKept
from wcsim.cli.shared.overrides import print_overrides
from wcsim.cli.shared.run_config import (
    how_it_learns,
    how_to_test,
    in_town,
    learns_in_rounds,
    require_user,
    resolve_config,
)
from wcsim.cli.training.report import TickRate, print_crossings, print_report, report_of
from wcsim.cli.training.resume import Typed, require_own_classes, require_same, require_same_config, steps_of, town_of
from wcsim.cli.training.train import Options
from wcsim.config import RunConfig
from wcsim.core.files import locked
from wcsim.errors import ConfigError, DiskFullError, InterruptedRunError, JournalError, PolicyError, WcsimError
from wcsim.log.parts import part_files
from wcsim.log.torn import told_torn
from wcsim.log.writer import JOURNAL, LogWriter
from wcsim.server.launch.launcher import Launcher
from wcsim.server.launch.states import ClientState, LaunchOutcome, LaunchRules, LaunchState, RestartRules
from wcsim.server.launch.stop_signals import StopSignals
from wcsim.server.ledger import LedgerWriter
from wcsim.server.protocol.limits import require_files
from wcsim.server.transport.world_folder import workplace
from wcsim.towns.scenario.town import Town
from wcsim.view.live_table import LiveTable

MOST_CLIENTS = 64
ALL_DONE = LaunchOutcome(code=0, message="", stopped=False, clients=(), elapsed_s=0.0)
_NETWORK = re.compile(r"[A-Za-z_][\w.-]*(:[A-Za-z_]\w*)?")
_TAKEN = ("world", "logs", "ledgers", "configs", "journal", "selection", "report")  # names in a run folder


def train_clients(
    options: Options,
    run: GroupRun,
    town: Town,
    watch: Callable[[LaunchState], bool] = lambda state: False,
    restarts: RestartRules | None = None,
) -> int:
    """Train them all; returns the exit code: FAILED when a client was given up, or the world.

    Args:
        options: What was typed.
        run: The clients, and where their run goes.
        town: The town.
        watch: Told how things are a few times a second; the run is stopped, as by SIGTERM, when it says True.
        restarts: When a process that dies is given up, for a run whose processes somebody kills on purpose.

    Raises:
        InterruptedRunError: The user stopped it.
        NothingKept: ... before anything was done.
        WcsimError: Something that was asked for cannot be used.
    """
    in_bounds("--lease", options.lease, 1.0, 86_400.0)
    check_folder("--out", run.out)
    require_files(len(run.clients))
    with StopSignals() as signals, ExitStack() as held:
        folder = held.enter_context(_opened(run))
        place = held.enter_context(workplace())
        left = tuple(client for client in run.clients if not folder.done(client.name, client.steps))
        plans = [client_plan(run, folder, place, client) for client in left]
        terms = WorldTerms(expected=len(left), lease_s=options.lease, recovery=options.recovery)
        order = world_order(run, town.address, folder, place, terms)
        rate, paid = TickRate(), PaidTimesLog(folder.path)
        held.callback(paid.save)
        with LiveTable() as table:

            def show(state: LaunchState) -> None:
                paid.add(state)
                paid.save_each(state.elapsed_s)
                if rate.add(state):
                    note = how_it_learns(run.clients[0].config)
                    notes, told = () if run.resume else (note,), run.info.overrides
                    print_overrides(table.console, town.name, told, notes, verbose=options.verbose, kept=True)
                table.show(state)
                if watch(state) and not state.stopping:
                    launcher.stop()

            again = RestartRules() if restarts is None else restarts
            rules = LaunchRules(client_lease_s=max(30.0, options.lease), client=again, world=again)
            launcher = Launcher(order, plans, folder.path, place, rules, show, signals=signals)
            outcome = launcher.run() if left else ALL_DONE
        code = _told(run, folder, options.json, outcome, (rate, paid.times))
    if signals.count and not run.last:  # one that came when nothing ran any more, and what is to follow has not begun
        raise InterruptedRunError(f"stopped; {run.out} holds the training so far; continue with --resume")
    return code


def resolved(options: Options) -> tuple[Client, ...]:
    """The clients with their names, seats and configurations.

    Raises:
        ConfigError: A name or an option cannot be used, or they do not fit into one world.
    """
    networks = some_words("--clients", options.clients or "")
    if len(networks) > MOST_CLIENTS:
        raise ConfigError(f"--clients: {len(networks)} clients; expected at most {MOST_CLIENTS}")
    names = client_names(networks)
    files = _files(options.config_for, names)
    clients: list[Client] = []
    for seat, (name, network) in enumerate(zip(names, networks, strict=True)):
        config = resolve_config(options, network, files.get(name))
        require_user(config.env.profile)
        if learns_in_rounds(config):
            raise ConfigError(
                f"client {name}: a danger network (learn.head=danger) learns in rounds, without clients; "
                "expected --preset dqn or paper, which use Q-learning"
            )
        clients.append(Client(name=name, seat=seat, config=config))
    worlds = {client.config.world_digest(): client.name for client in clients}
    if len(worlds) > 1:
        raise ConfigError(
            f"clients {' and '.join(worlds.values())} ask for different worlds; expected the same world, chair, "
            "camera, IMU and reward for all: only [learn] and the observation in [env] may differ (--config-for)"
        )
    return tuple(clients)


def client_names(networks: Sequence[str]) -> tuple[str, ...]:
    """A name for each client: its network's, numbered where it comes again.

    >>> client_names(("fig6", "own_file:OwnNet", "fig6"))
    ('fig6', 'OwnNet', 'fig6-2')

    Raises:
        ConfigError: A network cannot be named so.
    """
    used, names = set(_TAKEN), []
    for network in networks:
        if not _NETWORK.fullmatch(network):
            raise ConfigError(f"--clients: {network[:80]!r} is neither the name of a network nor module:Class")
        if ":" not in network and network not in NETWORK_NAMES:
            known = ", ".join(NETWORK_NAMES)
            raise ConfigError(f"--clients: unknown network {network!r}; expected {known}, or module:Class")
        base = client_name(network)
        name = next(n for n in (base, *(f"{base}-{k}" for k in range(2, 2 * MOST_CLIENTS + 9))) if n not in used)
        used.add(name)
        names.append(name)
    return tuple(names)


def _files(config_for: Sequence[str], names: Sequence[str]) -> dict[str, Path]:
    files = {}
    for text in config_for:
        name, equals, path = text.partition("=")
        if not equals or name not in names:
            raise ConfigError(f"--config-for {text!r}: expected NAME=FILE with a NAME of {', '.join(names)}")
        files[name] = Path(path)
    return files


def resumed_group(options: Options, out: Path, typed: Typed) -> tuple[GroupRun, Town]:
    """What a run goes on with, by what its folder says.

    Raises:
        PolicyError: It is no such run, or an option says otherwise.
        ConfigError: An option cannot be used.
        TownError: Its town is not there.
    """
    folder, named = open_clients_folder(out), options.clients or ""
    manifest = folder.manifest
    if named and client_names(some_words("--clients", named)) != folder.clients:
        raise PolicyError(
            f"--clients {named}: {out} was made with other clients ({', '.join(folder.clients)}); "
            "resume with the same ones, or leave that option out"
        )
    require_same(out, manifest, typed)
    networks = [folder.client_config(name).learn.network for name in folder.clients]
    require_own_classes(out, manifest, networks, typed, named.split(","))
    town = town_of(out, manifest, typed)
    own = _files(options.config_for, folder.clients)
    clients = []
    for seat, name in enumerate(folder.clients):
        config = folder.client_config(name)
        steps = steps_of(out, config, typed)
        require_same_config(out, config, typed, [own[name]] if name in own else [])
        longer = config.model_copy(update={"learn": config.learn.model_copy(update={"total_steps": steps})})
        clients.append(Client(name=name, seat=seat, config=longer))
    info = in_town(manifest.info, town, clients[0].config)
    return GroupRun(clients=tuple(clients), out=out, info=info, resume=True), town


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
                _lengthen(folder.path / client.name, client.ordered)
            rewrite_client_configs(folder, configs)
            yield folder.with_status("running", folder.manifest.steps)
        return
    wanted = make_manifest(world, run.info, [config.learn.network for config in configs.values()])
    made = not run.out.exists()
    if made:
        run.out.mkdir(parents=True)
    with locked(run.out):
        try:
            folder = create_clients_folder(run.out, world, wanted, configs)
        except WcsimError:
            if made:
                shutil.rmtree(run.out, ignore_errors=True)
            raise
        try:
            yield folder
        except (WcsimError, NothingKept) as error:
            if not isinstance(error, DiskFullError) and folder.fruitless():
                shutil.rmtree(folder.path, ignore_errors=True)
            raise


def _lengthen(run: Path, config: RunConfig) -> None:
    """Let a client's own run be as long as its configuration says, where there is one."""
    steps, fade = config.learn.total_steps, config.learn.learning_rate_fade
    if not (run / MANIFEST).is_file():
        return
    learn = open_run(run).config.learn
    if (learn.total_steps, learn.learning_rate_fade) != (steps, fade):
        extend(run, steps, fade)


def _mend(folder: ClientsFolder) -> None:
    """Cut off what was torn when a process died, and say so. Raises JournalError when something else is damaged."""
    path = folder.path / JOURNAL
    ledgers = [file for file in map(folder.ledger, folder.clients) if file.is_file()]
    if not part_files(path) and any(file.stat().st_size for file in ledgers):
        raise JournalError(f"{path}: is missing, but the ledgers contain ticks; restore it, or start a new run")
    if path.exists():
        with LogWriter.append_to(path) as journal:
            _say_torn(path, journal.cut_bytes)
    for path in ledgers:
        with LedgerWriter(path) as ledger:
            _say_torn(path, ledger.cut_bytes)


def _say_torn(path: Path, cut_bytes: int) -> None:
    if cut_bytes:
        print(f"wcsim: {told_torn(path, cut_bytes)}", file=sys.stderr)


def _told(
    run: GroupRun, folder: ClientsFolder, json: Path | None, outcome: LaunchOutcome, seen: tuple[TickRate, PaidTimes]
) -> int:
    """Write down how it ended and say so; returns the exit code.

    Raises:
        InterruptedRunError: It was stopped.
        NothingKept: ... before anything was done.
        ConfigError: A client or the world could not use what was asked for.
    """
    if folder.fruitless() and not run.resume:
        _nothing_came(outcome)
    told = {client.name: client.status.step for client in outcome.clients if client.status is not None}
    steps = sum(max(told.get(name, 0), folder.steps(name)) for name in folder.clients)  # not all were launched
    folder = _with_status(run, folder, steps)
    if outcome.code == Exit.REFUSED:
        raise ConfigError(outcome.message)
    report = report_of(folder, run.info.seed, *seen)
    print_report(stdout_console(), report)
    for kept in folder.truncated_parts():
        print(f"wcsim: {kept}: a truncated end was cut off earlier", file=sys.stderr)
    if json is not None:
        write_json(json, report.as_json())
    if outcome.stopped:
        raise InterruptedRunError(_told_stop(folder.path, outcome.clients))
    if outcome.code:
        lost = "".join(f"; client {each.name} {each.unsaved}" for each in outcome.clients if each.unsaved)
        print(f"wcsim: {outcome.message}{lost}; {folder.path} is kept; --resume continues it", file=sys.stderr)
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
        return f"stopped; {path} holds the training so far; continue with --resume"
    return (
        f"stopped, but {'; '.join(lost)}: the training since its last checkpoint is lost; {path} holds the rest; "
        "continue with --resume"
    )


def _with_status(run: GroupRun, folder: ClientsFolder, steps: int) -> ClientsFolder:
    """Write down whether the run is done, where there is room."""
    done = all(folder.done(client.name, client.steps) for client in run.clients)
    status: Status = "done" if done and run.last else "interrupted"
    try:
        return folder.with_status(status, steps)
    except DiskFullError as error:  # the work is there all the same
        print(f"wcsim: {error}", file=sys.stderr)
        return folder


def _nothing_came(outcome: LaunchOutcome) -> None:
    """Raise what a run is told of that ended before anything was learned; go on when it failed otherwise."""
    if outcome.stopped:
        raise NothingKept("stopped before anything was learned; nothing is saved")
    if outcome.code == Exit.REFUSED:
        raise ConfigError(outcome.message)
