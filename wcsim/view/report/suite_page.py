"""The page of a test, of a suite or demo: tables, figures, failures, and what words mean."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, get_type_hints

from wcsim.agents.evaluation.suite.intervals import FEWEST
from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.agents.evaluation.suite.rows import (
    COLUMNS,
    GROUPS,
    LOOK,
    Column,
    ResultRow,
    filled_columns,
)
from wcsim.agents.policy_api import UNAIDED
from wcsim.core.constants import RECORDED
from wcsim.core.reading import pluralize
from wcsim.view.report.comparisons import Paired, compared, verdict
from wcsim.view.report.failures import FailedEpisode, Illustration, Key, where_typed
from wcsim.view.report.figures import figures_of
from wcsim.view.report.pages import Cell, Exhibit, page, write_page


def _result_table(result: TestResult, part: str) -> Exhibit:
    """The table of a part, "" for all parts."""
    headings = ["policy"]
    for column in COLUMNS:
        bounds = (f"{column.interval}_low", f"{column.interval}_high") if column.interval else ()
        headings += [column.key, *bounds]
    rows = [row for row in (result.rows if part else result.pooled) if row.part == part]
    return Exhibit(
        name=f"table-{part or 'all'}",
        columns=headings,
        rows=[
            [row.policy, *(cell for column in COLUMNS for cell in _plain(row, column))]
            for row in rows
        ],
    )


def _comparison_table(pairs: Sequence[Paired]) -> Exhibit:
    """Policies against their rivals over the same episodes, of all parts and of each."""
    columns = ("policy", "rival", "part", "episodes", "saved", "lost", "mcnemar_p", "difference")
    rows = [
        [*(getattr(pair, name) for name in columns), *(pair.interval or (None, None))]
        for pair in pairs
    ]
    return Exhibit(name="comparison", columns=(*columns, "low", "high"), rows=rows)


def _plain(row: ResultRow, column: Column) -> list[Cell]:
    bounds = (getattr(row, column.interval) or (None, None)) if column.interval else ()
    return [getattr(row, column.key), *bounds]


def write_suite_page(
    result: TestResult,
    folder: Path,
    failures: Sequence[FailedEpisode],
    pictures: Mapping[Key, Illustration],
    why_none: str,
    out: Path,
) -> Path:
    """Write the page of a test and what belongs to it; where the page is.

    Args:
        result: The test.
        folder: Where it lies.
        failures: Those of all policies, worst first.
        pictures: Of some of them.
        why_none: Why there are no pictures at all, or "".
        out: Where the page goes.

    Raises:
        DiskFullError: It cannot be written.
    """
    pairs, figures = compared(result), figures_of(result, folder)
    tables = {part: _result_table(result, part) for part in ("", *result.parts)}
    shown = {
        "against": _comparison_table(pairs),
        "failed": _failed(failures),
        "episodes": _episodes(result),
    }
    text = page(
        "suite.jinja",
        title=f"{result.suite} {result.set}: "
        f"{pluralize(len(result.episodes), 'policy', 'policies')}",
        result=result,
        verdict=verdict(result),
        groups={
            question: filled_columns(columns, result.pooled) for question, columns in GROUPS.items()
        },
        users=sorted({e.profile for episodes in result.episodes.values() for e in episodes}),
        recorded=RECORDED,
        pairs=pairs,
        fewest=FEWEST,
        tables=tables,
        figures=figures,
        failures=failures,
        pictures=pictures,
        why_none=why_none,
        where_typed=where_typed(result),
        **shown,
    )
    return write_page(out, text, (*tables.values(), *shown.values(), *figures))


def _failed(failures: Sequence[FailedEpisode]) -> Exhibit:
    columns = (
        "policy",
        "block",
        "seat",
        "part",
        "town",
        "x_m",
        "y_m",
        "user",
        "reason",
        "whose",
        "partner",
    )
    rows = [
        [failure.policy, *failure.key, record.part, record.town, *record.end_m, record.profile,
         failure.reason, failure.whose, record.partner, failure.speed_mps, failure.severity,
         failure.unaided, failure.command]
        for failure in failures
        for record in (failure.record,)
    ]  # fmt: skip
    speed = ("last_second_mps", "severity", "unaided", "command")
    return Exhibit(name="failures", columns=(*columns, *speed), rows=rows)


def _episodes(result: TestResult) -> Exhibit:
    """Every episode of every policy, for other tools."""
    plain = [
        name
        for name, kind in get_type_hints(EpisodeRecord).items()
        if kind in (int, float, str, bool)
    ]
    rows = [
        [name, *(getattr(e, key) for key in plain), *e.end_m, len(e.interventions),
         None if e.score is None else round(e.score, 6)]
        for name, episodes in result.episodes.items()
        for e in episodes
    ]  # fmt: skip
    return Exhibit(
        name="episodes",
        columns=("policy", *plain, "x_m", "y_m", "interventions", "score"),
        rows=rows,
    )


DEMO_PAGE: Final = "demo.html"
_CALLED: Final = {UNAIDED: "the user alone", "zero": "standing still"}


def write_demo_page(folder: Path, result: TestResult, **shown: object) -> Path:
    """Write the page; where it is.

    Args:
        folder: Where it goes.
        result: Of the demo's test.
        shown: How the network `learned` in a sentence; the film (`film_webm`), what it says
            (`film_says`), and the block and seat that it shows (`key`); the families of scenes that
            are in the training too (`trained`); `commands` to go on with, each with what it does.

    Raises:
        DiskFullError: It cannot be written.
    """
    rows = [
        replace(row, policy=_CALLED.get(row.policy, f"with {row.policy}")) for row in result.pooled
    ]
    said = {
        "result": result,
        "rows": rows,
        "verdict": verdict(result),
        "look": filled_columns(LOOK[:-1], rows),
    }
    text = page("demo.jinja", title="wcsim demo", **said, **shown)
    return write_page(folder, text, (), DEMO_PAGE)
