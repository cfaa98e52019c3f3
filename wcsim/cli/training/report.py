"""What comes of a run: where each client came to follow its user, and the proof that no tick was lost or doubled."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from wcsim.agents.clients.group_run import ClientsFolder
from wcsim.agents.clients.paid_times import PaidTimes
from wcsim.errors import PolicyError, WcsimError
from wcsim.log.parts import part_files
from wcsim.log.reader import iter_inputs, log_digest
from wcsim.log.records import SeenFrame
from wcsim.log.writer import JOURNAL
from wcsim.server.launch.states import LaunchState
from wcsim.server.ledger import Audit, audits, iter_ledger, ledger_facts
from wcsim.view.report.learning_curve import crossing, read_training


class TickRate:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientReport:
    """The steps of one client, counted in its ledger and compared with the journal."""

    name: str
    first_tick: int  # of its first frame, -1 when it never had one
    last_tick: int
    ticks: int
    missing: int  # steps that the world did with its action and that it never saw
    duplicated: int  # steps that it saw twice, or that the world never did


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientsReport:
    """How a run ended."""

    run: str
    town: str
    seed: int
    status: str
    clients: tuple[ClientReport, ...]
    ticks: int  # of the world
    journal_hash: str  # equal for equal runs
    ticks_per_s: float
    waits: PaidTimes  # what sharing the world cost each client


def report_of(folder: ClientsFolder, seed: int, rate: TickRate, waits: PaidTimes) -> ClientsReport:
    """Compare ledgers and journal. Raises WcsimError when one cannot be read."""
    path = folder.path / JOURNAL
    journal = path if part_files(path) else None
    ledgers = [(seat, _entries(folder.ledger(name))) for seat, name in enumerate(folder.clients)]
    ticks, against = audits(() if journal is None else iter_inputs(journal), ledgers)
    return ClientsReport(
        run=str(folder.path),
        town=", ".join((folder.manifest.town, *folder.manifest.more_towns)),
        seed=seed,
        status=folder.manifest.status,
        clients=tuple(
            _client(name, folder.ledger(name), journal, one) for name, one in zip(folder.clients, against, strict=True)
        ),
        ticks=ticks,
        journal_hash="" if journal is None else log_digest(path),
        ticks_per_s=rate.ticks_per_s,
        waits=waits,
    )


def _entries(ledger: Path) -> Iterable[SeenFrame]:
    return iter_ledger(ledger) if ledger.is_file() else ()


def _client(name: str, ledger: Path, journal: Path | None, against: Audit) -> ClientReport:
    facts = ledger_facts(_entries(ledger))
    if journal is None and facts.first_tick >= 0:
        raise WcsimError(f"{ledger}: has frames of a world without a journal; restore {JOURNAL} next to its folder")
    return ClientReport(
        name=name,
        first_tick=facts.first_tick,
        last_tick=facts.last_tick,
        ticks=facts.ticks,
        missing=max(facts.missing, against.lost),
        duplicated=facts.doubled + against.phantom,
    )


def print_report(console: Console, report: ClientsReport) -> None:
    """The report as a table."""
    table = Table(
        "client", "first tick", "last tick", "ticks", "missing", "duplicated", box=box.SIMPLE_HEAD, pad_edge=False
    )
    for client in report.clients:
        table.add_row(*(str(value) for value in asdict(client).values()))
    console.print(table)
    if len(report.waits.clients) > 1:
        console.print(_paid(report.waits))
    console.print(
        f"{report.ticks} world ticks, {report.ticks_per_s:.1f} per second; journal hash {report.journal_hash}",
        markup=False,
        soft_wrap=True,
    )


def _paid(waits: PaidTimes) -> Table:
    """What each client paid, and for whom it waited most; the page of `wcsim report` has all pairs."""
    table = Table("client", "acting s", "learning s", "waiting s", "mostly for", box=box.SIMPLE_HEAD, pad_edge=False)
    for name, paid in waits.clients.items():
        waited = waits.waited_s.get(name, {})
        whom = max(waited, key=lambda other: waited[other], default="")
        most = f"{whom} ({waited[whom]:.1f})" if whom and waited[whom] > 0.0 else "-"
        table.add_row(name, *(f"{part_s:.1f}" for part_s in (paid.acting_s, paid.learning_s, paid.waiting_s)), most)
    return table


def print_crossings(run: Path) -> None:
    """Where KPI 1 of each client of a run came below its limit; a log that cannot be read is no reason to fail."""
    try:
        steps = read_training([run]).steps
    except PolicyError as error:
        print(f"wcsim: {error}", file=sys.stderr)
        return
    for name, rows in steps.items():
        if rows:
            print(f"{name}: {crossing(rows).told()}")
