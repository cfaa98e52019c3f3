"""The page that a demo ends with: what was driven, the film, the table, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.core.files import write_bytes
from wcsim.view.report.pages import page
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
    tables = [result_table(what.result, part) for part in what.result.parts]
    path = folder / DEMO_PAGE
    write_bytes(path, page("demo.jinja", title="wcsim demo", demo=what, tables=tables).encode())
    return path
