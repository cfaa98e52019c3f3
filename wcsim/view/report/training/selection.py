"""Who was chosen after the first phase, and by what, where clients learned their phases apart (`learn.select_by`)."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from wcsim.agents.clients.clients_folder import CHOICE, KPI1, SELECTION, read_choice
from wcsim.agents.evaluation.suite.result_files import RESULT, read_result
from wcsim.agents.learning.metrics import KPI1_STEPS
from wcsim.agents.runs.run_folder import read_json
from wcsim.core.reading import is_file
from wcsim.errors import PolicyError
from wcsim.view.report.markup import Cell, Exhibit, csv_of, table
from wcsim.view.report.page import Section, shown
from wcsim.view.report.training.learning_curve import Training

_SHOWN: Final = (
    *(("score", "score"), ("score_ci", "95 %"), ("crashes_own", "own crashes"), ("crashes_per_km", "per km")),
    *(("kpi1", "KPI 1"), ("kpi1_free_within", "obeyed"), ("kpi2_median", "KPI 2, median"), ("arrivals", "arrivals")),
)


def selections(training: Training) -> list[tuple[Section, Exhibit]]:
    """A section for each run that has compared its clients.

    Raises:
        PolicyError, ConfigError: What it kept of that is damaged.
    """
    runs = [Path(name) for name in training.manifests]
    return [_section(run, number) for number, run in enumerate(runs) if is_file(run / SELECTION / CHOICE)]


def _section(run: Path, number: int) -> tuple[Section, Exhibit]:
    exhibit = _tested(run, number) if is_file(run / SELECTION / RESULT) else _compared(run, number)
    return Section(name=exhibit.name, title="Which client learns the second phase", body=shown(exhibit)), exhibit


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
    names = {row["policy"]: Path(row["policy"].removesuffix(":phase1")).name for row in result.pooled}
    best = read_choice(run, list(names.values()))
    rows: list[list[Cell]] = [
        [name := names[row["policy"]], *(_cell(row.get(k)) for k, _ in _SHOWN), "second phase" if name == best else ""]
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
        body=table(headings, [["–" if cell is None else cell for cell in row] for row in rows]),
        csv=csv_of(headings, rows),
    )


def _cell(value: object) -> Cell:
    if isinstance(value, list):
        return " to ".join(f"{bound:.3f}" for bound in value)
    return value if isinstance(value, int | float | str) else None
