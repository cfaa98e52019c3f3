"""The page that a demo ends with: what was driven, the film, the table, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.matrix import TestResult
from wcsim.core.files import write_bytes
from wcsim.view.report.markup import Markup, Section, data_uri, el, joined, page, table

DEMO_PAGE: Final = "demo.html"
_COLUMNS: Final = (
    ("crashes_own", "own crashes", "{:d}"),
    ("crashes_other", "crashes by others", "{:d}"),
    ("km", "km", "{:.2f}"),
    ("kpi1_mean", "KPI 1: distance to the user's stick", "{:.3f}"),
    ("kpi1_within", "close to user: steps within 0.18", "{:.0%}"),
    ("kpi2_mean_steps", "KPI 2: steps of an episode", "{:.0f}"),
    ("routes_completed", "routes done", "{:d}"),
    ("crossings", "crossings", "{:d}"),
    ("red_entries", "red lights", "{:d}"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoShown:
    """What there is to show; files are beside the page."""

    learned: str  # how the network learned, in a sentence
    results: Sequence[TestResult]
    film: str  # name of the file
    film_says: str
    still_png: bytes
    commands: Sequence[tuple[str, str]]  # to go on with, each with what it does


def write_demo_page(folder: Path, what: DemoShown) -> Path:
    """Write the page; where it is. Raises DiskFullError."""
    still = el("img", src=data_uri("image/png", what.still_png), alt=what.film_says, width="100%")
    film = joined((el("p", el("a", still, href=what.film)), el("p", what.film_says, class_="says")))
    tables = joined(joined((el("h3", _title(result)), _table(result))) for result in what.results)
    told = "No single column decides: a chair that stands still never crashes, and never arrives."
    steps = el("ul", *(el("li", el("code", command), f" {does}") for command, does in what.commands))
    sections = (
        Section(name="film", title="The film", body=film),
        Section(name="test", title="The test", body=joined((tables, el("p", told, class_="says")))),
        Section(name="next", title="Next", body=steps),
    )
    path = folder / DEMO_PAGE
    write_bytes(path, page("wcsim demo", el("p", what.learned), sections).encode())
    return path


def _title(result: TestResult) -> str:
    return f"{result.town}, {result.profile} user, seed {result.seed}"


def _table(result: TestResult) -> Markup:
    rows = []
    for row in result.rows:
        values = [(getattr(row, key), form) for key, _, form in _COLUMNS]
        rows.append([row.policy, *("-" if value is None else form.format(value) for value, form in values)])
    return table(["policy", *(heading for _, heading, _ in _COLUMNS)], rows)
