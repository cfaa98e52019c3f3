"""What several clients add to the page of a training: which one learned the second phase, and who waited for whom."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from wcsim.agents.clients.group_run import CHOICE, KPI1, SELECTION, read_choice
from wcsim.agents.clients.paid_times import PaidTimes, read_paid_times
from wcsim.agents.evaluation.suite.result_files import RESULT, read_result
from wcsim.agents.runs.metrics import KPI1_STEPS
from wcsim.agents.runs.run_folder import read_json
from wcsim.core.reading import is_file
from wcsim.errors import PolicyError
from wcsim.view.report.learning_curve import Training
from wcsim.view.report.pages import Cell, Exhibit, Section

_SHOWN: Final = (
    *(("score", "score"), ("score_ci", "95 %"), ("crashes_own", "own crashes"), ("crashes_per_km", "per km")),
    *(("kpi1", "KPI 1"), ("kpi1_free_within", "obeyed"), ("kpi2_median", "KPI 2, median"), ("arrivals", "arrivals")),
)
HEADINGS = (
    "client",
    "acting s",
    "learning s",
    "waiting for the world s",
    "for others and messages s",
    "of both learning s",
    "idle s",
)


def client_sections(training: Training) -> list[Section]:
    """Sections for runs that compared their clients (`learn.select_by`), then for runs whose clients shared a world.

    Raises:
        PolicyError, ConfigError: What a run saved of that is damaged.
    """
    runs = [Path(name) for name in training.manifests]
    times = [(number, run, read_paid_times(run)) for number, run in enumerate(runs)]
    return [
        *(_selection(run, number) for number, run in enumerate(runs) if is_file(run / SELECTION / CHOICE)),
        *(_waiting(run, number, found) for number, run, found in times if found is not None),
    ]


def _selection(run: Path, number: int) -> Section:
    exhibit = _tested(run, number) if is_file(run / SELECTION / RESULT) else _compared(run, number)
    return Section(name=exhibit.name, title="Which client learns the second phase", exhibits=(exhibit,))


def _compared(run: Path, number: int) -> Exhibit:
    """The clients by KPI 1."""
    choice = read_json(run / SELECTION, CHOICE)
    try:
        figures = {str(name): float(of[KPI1]) for name, of in choice["clients"].items()}
    except (KeyError, TypeError, ValueError, AttributeError):
        raise PolicyError(f"{run / SELECTION / CHOICE}: is damaged; expected KPI 1 of each client") from None
    best, by = read_choice(run, list(figures)), choice.get("by")
    rows: list[list[Cell]] = [[name, kpi1, "second phase" if name == best else ""] for name, kpi1 in figures.items()]
    why = "The client with the lowest one continues" if by == KPI1 else f"The user chose {best}"
    return _exhibit(
        run,
        number,
        "KPI 1 of the first phase",
        f"KPI 1 of the client's own choice, over the last {KPI1_STEPS} steps of its first phase. {why}.",
        ("client", "KPI 1", "learned on"),
        rows,
    )


def _tested(run: Path, number: int) -> Exhibit:
    result = read_result(run / SELECTION)
    names = {row.policy: Path(row.policy.removesuffix(":phase1")).name for row in result.pooled}
    best = read_choice(run, list(names.values()))
    rows: list[list[Cell]] = [
        [
            name := names[row.policy],
            *(_cell(getattr(row, k)) for k, _ in _SHOWN),
            "second phase" if name == best else "",
        ]
        for row in result.pooled
    ]
    headings = ("client", *(heading for _, heading in _SHOWN), "learned on")
    says = (
        f"Each client after its first phase, tested on {result.set}; follow is the user alone. The client with "
        f"the highest score continues. Details: wcsim report {shlex.quote(str(run / SELECTION))}"
    )
    return _exhibit(run, number, f"{result.suite} {result.set}", says, headings, rows)


def _exhibit(
    run: Path, number: int, by: str, says: str, headings: Sequence[str], rows: Sequence[Sequence[Cell]]
) -> Exhibit:
    return Exhibit(
        name="selection" if number == 0 else f"selection-{number + 1}",
        title=f"{run.resolve().name}: {by}",
        says=says,
        columns=headings,
        rows=rows,
    )


def _cell(value: object) -> Cell:
    if isinstance(value, tuple):
        return " to ".join(f"{bound:.3f}" for bound in value)
    return value if isinstance(value, int | float | str) else None


def _waiting_rows(times: PaidTimes) -> tuple[tuple[str, ...], list[list[Cell]]]:
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


def _waiting(run: Path, number: int, times: PaidTimes) -> Section:
    headings, rows = _waiting_rows(times)
    exhibit = Exhibit(
        name="waiting" if number == 0 else f"waiting-{number + 1}",
        title=f"{run.resolve().name}: waiting between clients",
        says="Seconds of each client, restarts included. A client waits for the world's own work, or for other clients "
        "and messages. It may learn meanwhile; the rest is idle time. Learning costs nothing while another client is "
        "waited for. The last columns: how long a client that had acted waited for each of the others; time for which "
        "several were late is divided among them. These columns leave out the world's work and messages.",
        columns=headings,
        rows=rows,
    )
    return Section(name=exhibit.name, title="Who waits for whom", exhibits=(exhibit,))
