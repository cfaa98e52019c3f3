"""Who waited for whom in a run of several clients, and what each of them paid for sharing its world."""

from __future__ import annotations

from pathlib import Path

from wcsim.agents.clients.paid_times import PaidTimes, read_paid_times
from wcsim.view.report.markup import Cell, Exhibit, csv_of, table
from wcsim.view.report.page import Section, shown
from wcsim.view.report.training.learning_curve import Training

HEADINGS = (
    "client",
    "acting s",
    "learning s",
    "waiting for the world s",
    "for others and messages s",
    "of both learning s",
    "idle s",
)


def waitings(training: Training) -> list[tuple[Section, Exhibit]]:
    """A section for each run whose clients shared a world. Raises PolicyError when what it kept is damaged."""
    found = [(Path(name), read_paid_times(Path(name))) for name in training.manifests]
    return [_section(run, number, times) for number, (run, times) in enumerate(found) if times is not None]


def waiting_rows(times: PaidTimes) -> tuple[tuple[str, ...], list[list[Cell]]]:
    """The headings, and a row for each client: what it paid, and for whom it waited."""
    names = list(times.clients)
    rows: list[list[Cell]] = []
    for name, shares in times.clients.items():
        waited = times.waited_s.get(name, {})
        waits = (shares.world_s, shares.others_s, shares.overlap_s, shares.waiting_s)
        paid = (shares.acting_s, shares.learning_s, *waits)
        held = [None if whom == name else round(waited.get(whom, 0.0), 1) for whom in names]
        rows.append([name, *(round(part_s, 1) for part_s in paid), *held])
    return (*HEADINGS, *(f"for {name} s" for name in names)), rows


def _section(run: Path, number: int, times: PaidTimes) -> tuple[Section, Exhibit]:
    headings, rows = waiting_rows(times)
    exhibit = Exhibit(
        name="waiting" if number == 0 else f"waiting-{number + 1}",
        title=f"{run.resolve().name}: waiting between clients",
        says="Seconds of each client, restarts included. A client waits for the world's own work, or for other clients "
        "and messages. It may learn meanwhile; the rest is idle time. Learning costs nothing while another client is "
        "waited for. The last columns: how long a client that had acted waited for each of the others; time for which "
        "several were late is divided among them. These columns leave out the world's work and messages.",
        body=table(headings, [["–" if cell is None else cell for cell in row] for row in rows]),
        csv=csv_of(headings, rows),
    )
    return Section(name=exhibit.name, title="Who waits for whom", body=shown(exhibit)), exhibit
