"""Several clients as in the paper: all learn the first phase in one world, the best the second.

`learn.select_by` sets how the best is found: by KPI 1 of the first phase, as in the paper, by a
suite, or by a client's name. The run folder holds the choice (`selection/`), so that a run that was
stopped anywhere resumes from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich import box

from wcsim.agents.clients.group_run import (
    CHOICE,
    KPI1,
    SELECTION,
    ResolvedClient,
    ResolvedGroupRun,
    read_chosen_client_name,
)
from wcsim.agents.networks.names import is_custom_network
from wcsim.agents.runs.metrics import KPI1_STEPS, ROW_STEPS
from wcsim.agents.runs.run_folder import format_resume_command
from wcsim.cli.evaluation.judged_suite import save_test_result
from wcsim.cli.shared.common import resolve_worker_count, write_json
from wcsim.cli.shared.consoles import print_note, show_table, stderr_console
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.cli.training.clients import ClientProcessOptions, train_clients
from wcsim.core.files import lock_run_folder
from wcsim.core.reading import escape, pluralize
from wcsim.errors import ConfigError, InterruptedRunError, PolicyError
from wcsim.server.launch.event_log import EventLogWriter
from wcsim.towns.scenario.town import Town
from wcsim.view.report.learning_curve import kpi1_of

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.agents.evaluation.suite.records import EpisodeRecord
    from wcsim.agents.evaluation.suite.result_files import TestResult
    from wcsim.agents.opening.list_file import HashedSuite


Figures = dict[str, dict[str, float]]
"""What was measured of each client after its first phase, by name, as choice.json has it."""
_HEADS = {
    KPI1: f"KPI 1, last {KPI1_STEPS} steps",
    "score": "score",
    "crashes_own": "own crashes",
    "ms": "ms",  # of a decision
    "late_ms": "ms late",  # over `learn.select_ms`
}


def train_clients_in_phases(
    options: ClientProcessOptions, run: ResolvedGroupRun, town: Town
) -> int:
    """Train clients, their phases together or apart; returns the exit code.

    Raises:
        InterruptedRunError: The user stopped it.
        NothingSavedInterrupt: ... before anything was done.
        WcsimError: Something that was asked for cannot be used.
    """
    ways = {client.config.learn.select_by for client in run.clients}
    if len(ways) > 1:
        names = ", ".join(sorted(map(escape, ways)))
        raise ConfigError(
            f"clients have different learn.select_by ({names}); expected the same for all"
        )
    (by,) = ways
    if not by or len(run.clients) == 1:
        if options.worlds is not None:
            raise ConfigError(
                f"--worlds {options.worlds}: no clients are tested; expected several clients and "
                "--select-by LIST, or leave that out"
            )
        return train_clients(options, run, town)
    suite = _checked(options, run, by)
    chosen = (
        read_chosen_client_name(run.out, [client.name for client in run.clients])
        if run.resume
        else ""
    )
    if not chosen:
        code = train_clients(options, _first_phase(run), town)
        if code != ExitCode.DONE:
            return code
        chosen = _choose(options, run, by, suite)
    return train_clients(options, _second_phase(run, chosen), town)


def _checked(options: ClientProcessOptions, run: ResolvedGroupRun, by: str) -> HashedSuite | None:
    """The suite to choose by; None for another way.

    Raises:
        ConfigError: The choice will not be possible; it is known before the first phase.
    """
    untested = by == KPI1 or by in [client.name for client in run.clients]
    if untested and options.worlds is not None:
        raise ConfigError(
            f"--worlds {options.worlds}: --select-by {by} tests nothing; leave --worlds out"
        )
    least = ROW_STEPS if by == KPI1 else 1
    unled = [client.name for client in run.clients if client.config.learn.phase1_steps < least]
    if unled:
        raise ConfigError(
            f"learn.select_by={by} chooses after the first phase, and that of {unled[0]} has less "
            f"than {least} steps: set learn.phase1_steps"
        )
    if untested:
        return None
    from wcsim.agents.opening.list_file import open_suite_to_choose_by

    return open_suite_to_choose_by(by)


def _first_phase(run: ResolvedGroupRun) -> ResolvedGroupRun:
    """The run as far as all learn."""
    return replace(run, clients=tuple(map(_until_switch, run.clients)), last=False)


def _second_phase(run: ResolvedGroupRun, best: str) -> ResolvedGroupRun:
    """The rest of the run: the best client goes on, the others stay where they are."""
    clients = tuple(
        client if client.name == best else _until_switch(client) for client in run.clients
    )
    return replace(run, clients=clients, resume=True, best=best)


def _until_switch(client: ResolvedClient) -> ResolvedClient:
    learn = client.config.learn
    return replace(client, until=min(learn.phase1_steps, learn.total_steps))


def _choose(
    options: ClientProcessOptions, run: ResolvedGroupRun, by: str, suite: HashedSuite | None
) -> str:
    """Compare what each client learned in its first phase; the best one's name."""
    from wcsim.agents.networks.costs import measure_network_cost  # loads torch

    log = EventLogWriter(run.out)
    log.add("first_phase_done", by=by)
    try:
        with lock_run_folder(run.out):
            if suite is None:
                # KPI 1 of each client's own choice at the end of its first phase.
                figures = {each.name: {KPI1: kpi1_of(run.out / each.name)} for each in run.clients}
            else:
                figures = _tested(options, run, suite, by)
            for client in run.clients:
                eye, learn = client.config.eye, client.config.learn
                try:
                    ms = measure_network_cost(learn.network, eye.height_px, eye.width_px).p50_ms
                except PolicyError:  # a custom one that takes other observations only
                    ms = 0.0
                figures[client.name] |= {"ms": ms, "late_ms": max(0.0, ms - learn.select_ms)}
            best = by if by in figures else _best_of(figures)
            if best != by and figures[best]["late_ms"]:
                print_note("all clients are slower than learn.select_ms: the fastest goes on")
            # The choice is made by all digits; the file is for people.
            figures = {
                name: {key: round(figure, 4) for key, figure in own.items()}
                for name, own in figures.items()
            }
            used = {"list_sha256": suite.sha256} if suite else {}
            # Written last: a run without it compares again, one with it starts the second phase.
            (run.out / SELECTION).mkdir(exist_ok=True)
            write_json(
                run.out / SELECTION / CHOICE, {"by": by, **used, "clients": figures, "best": best}
            )
    except KeyboardInterrupt:
        log.add("comparison_stopped")
        raise InterruptedRunError(
            f"stopped while clients were compared; {run.out} holds the episodes so far; continue "
            f"it: {format_resume_command(run.out)}"
        ) from None
    for name, own in figures.items():
        log.add("compared", who=name, **own)
    log.add("chosen", who=best)
    _show(figures, best)
    return best


def _tested(
    options: ClientProcessOptions, run: ResolvedGroupRun, suite: HashedSuite, name: str
) -> Figures:
    from wcsim.agents.evaluation.suite.run import SuiteOrder, run_suite
    from wcsim.agents.opening.named_policy import describe_rule_differences
    from wcsim.agents.policy_api import UNAIDED

    order = SuiteOrder(
        suite=suite, out=run.out / SELECTION, jobs=resolve_worker_count(options.worlds), forks=0
    )
    console = stderr_console()
    console.print(
        f"first phase done; comparing clients on {suite.file.suite} {suite.file.set}: "
        f"{pluralize(suite.episodes, 'episode')} each"
    )

    # The own code that each policy needs; all that need none share their processes.
    networks = {UNAIDED: ""}
    for client in run.clients:
        network = client.config.learn.network
        networks[_policy_of(run.out, client.name)] = network if is_custom_network(network) else ""
    for line in describe_rule_differences(networks, order.preset, suite.file.settings):
        console.print(line)
    found: dict[str, tuple[EpisodeRecord, ...]] = {}
    for network in dict.fromkeys(networks.values()):
        policies = [policy for policy, its in networks.items() if its == network]
        found |= run_suite(
            replace(order, network=network),
            policies,
            lambda policy, done, of: print_note(f"{policy}: {done} of {of} blocks"),
        )
    records = {policy: found[policy] for policy in networks}
    return _figures_of(
        save_test_result(order, name, records), run.out, [client.name for client in run.clients]
    )


def _policy_of(run: Path, client: str) -> str:
    """What a client's policy of the first phase is called."""
    return f"{run / client}:phase1"


def _figures_of(result: TestResult, run: Path, clients: Sequence[str]) -> Figures:
    """What a result says of the clients, in their order."""
    rows = {row.policy: row for row in result.pooled}
    return {
        name: {"score": row.score or 0.0, "crashes_own": row.crashes_own}
        for name in clients
        for row in (rows[_policy_of(run, name)],)
    }


def _best_of(figures: Figures) -> str:
    """The client of the lowest KPI 1, or of the highest score, then the fewest own crashes.

    Of equal ones it is the first. One that decides too slowly comes after all others, the slower
    the later.

    >>> crashes = {"a": 2, "b": 1, "c": 1}
    >>> _best_of({name: {"score": 0.5, "crashes_own": own} for name, own in crashes.items()})
    'b'
    """
    order = {"late_ms": 1.0, KPI1: 1.0, "score": -1.0, "crashes_own": 1.0}
    return min(
        figures, key=lambda name: [order[key] * figures[name].get(key, 0.0) for key in order]
    )


def _show(figures: Figures, best: str) -> None:
    rows = (
        (name, *(f"{figure:.4g}" for figure in own.values()),
         "learns the second phase" if name == best else "stops after the first phase")
        for name, own in figures.items()
    )  # fmt: skip
    headings = ("client", *(_HEADS[key] for key in figures[best]), "")
    show_table(headings, rows, box=box.SIMPLE_HEAD, pad_edge=False)
