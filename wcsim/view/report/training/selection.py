"""Who was chosen after the first phase, and by what, where clients learned their phases apart (`learn.select_by`)."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Final

from wcsim.agents.clients.clients_folder import SELECTION, read_choice
from wcsim.agents.evaluation.suite.result_files import RESULT, read_result
from wcsim.core.reading import is_file
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
    return [_section(run, number) for number, run in enumerate(runs) if is_file(run / SELECTION / RESULT)]


def _section(run: Path, number: int) -> tuple[Section, Exhibit]:
    result = read_result(run / SELECTION)
    names = {row["policy"]: Path(row["policy"].removesuffix(":phase1")).name for row in result.pooled}
    best = read_choice(run, list(names.values()))
    rows: list[list[Cell]] = [
        [name := names[row["policy"]], *(_cell(row.get(k)) for k, _ in _SHOWN), "second phase" if name == best else ""]
        for row in result.pooled
    ]
    headings = ("client", *(heading for _, heading in _SHOWN), "learned on")
    exhibit = Exhibit(
        name="selection" if number == 0 else f"selection-{number + 1}",
        title=f"{run.resolve().name}: {result.suite} {result.set}",
        says=f"Each client after its first phase, tested on {result.set}; follow is the user alone. The client with "
        f"the highest score continues. Details: wcsim report {shlex.quote(str(run / SELECTION))}",
        body=table(headings, [["–" if cell is None else cell for cell in row] for row in rows]),
        csv=csv_of(headings, rows),
    )
    return Section(name=exhibit.name, title="Which client learns the second phase", body=shown(exhibit)), exhibit


def _cell(value: object) -> Cell:
    if isinstance(value, list):
        return " to ".join(f"{bound:.3f}" for bound in value)
    return value if isinstance(value, int | float | str) else None
