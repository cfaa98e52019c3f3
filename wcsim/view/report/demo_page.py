"""The page that a demo ends with: what was driven, the film, the table, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.core.files import write_bytes
from wcsim.view.report.markup import Section, data_uri, el, joined, page, shown
from wcsim.view.report.tables import result_table

DEMO_PAGE: Final = "demo.html"


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoShown:
    """What there is to show; files are beside the page."""

    learned: str  # how the network learned, in a sentence
    result: TestResult
    film: str  # name of the file
    film_says: str
    still_png: bytes
    commands: Sequence[tuple[str, str]]  # to go on with, each with what it does


def write_demo_page(folder: Path, what: DemoShown) -> Path:
    """Write the page; where it is. Raises DiskFullError."""
    still = el("img", src=data_uri("image/png", what.still_png), alt=what.film_says, width="100%")
    film = joined((el("p", el("a", still, href=what.film)), el("p", what.film_says, class_="says")))
    parts = dict.fromkeys(row.part for row in what.result.rows)
    tables = joined(shown(result_table(what.result, part)) for part in parts)
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
