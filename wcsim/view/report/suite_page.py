"""The page of a test on a suite: its tables and figures, all failures, and what its words mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.core.constants import RECORDED
from wcsim.core.reading import counted
from wcsim.view.report.columns import COLUMNS
from wcsim.view.report.comparisons import compared, verdict, verdicts
from wcsim.view.report.failures import WORST, FailedEpisode, Illustration, Key, where_typed
from wcsim.view.report.figures import figures_of
from wcsim.view.report.pages import Exhibit, page, write_page
from wcsim.view.report.tables import comparison_table, result_table, weights_table

_BEST = 3


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
    pairs, parts = compared(result), result.parts
    shown = {
        "pooled": result_table(result, ""),
        "against": comparison_table(pairs),
        "weights": weights_table(result),
        "failed": _failed(failures),
        "episodes": _episodes(result),
    }
    by_part, figures = [result_table(result, part) for part in parts], figures_of(result, folder)
    text = page(
        "suite.jinja",
        title=f"{result.suite} {result.set}: {counted(len(result.episodes), 'policy', 'policies')}",
        result=result,
        verdict=verdict(result),
        best=sorted(result.pooled, key=lambda row: -(row.score or 0.0))[:_BEST],
        columns=COLUMNS,
        names=list(result.episodes),
        parts=parts,
        users=sorted({e.profile for episodes in result.episodes.values() for e in episodes}),
        recorded=RECORDED,
        pairs=pairs,
        verdicts=verdicts,
        by_part=by_part,
        figures=figures,
        failures=failures,
        pictures=pictures,
        why_none=why_none,
        where_typed=where_typed(result),
        **shown,
    )
    return write_page(out, text, (*shown.values(), *by_part, *figures))


def _failed(failures: Sequence[FailedEpisode]) -> Exhibit:
    columns = ("policy", "block", "seat", "part", "town", "x_m", "y_m", "user", "reason", "whose", "partner")
    rows = [
        [failure.policy, *failure.key, record.part, record.town, *record.end_m, record.profile, failure.reason,
         failure.whose, record.partner, failure.speed_mps, failure.severity, failure.unaided, failure.command]
        for failure in failures
        for record in (failure.record,)
    ]  # fmt: skip
    return Exhibit(
        name="failures",
        title="All failures, worst first",
        says=WORST,
        columns=(*columns, "last_second_mps", "severity", "unaided", "command"),
        rows=rows,
    )


def _episodes(result: TestResult) -> Exhibit:
    """Every episode of every policy, for other tools."""
    plain = [field.name for field in fields(EpisodeRecord) if str(field.type) in ("int", "float", "str", "bool")]
    rows = [
        [name, *(getattr(e, key) for key in plain), *e.end_m, len(e.interventions),
         *(round(value, 6) for value in (*e.score_parts, e.score))]
        for name, episodes in result.episodes.items()
        for e in episodes
    ]  # fmt: skip
    return Exhibit(
        name="episodes",
        title="Every episode",
        says=f"{counted(len(rows), 'row')}: every episode of every policy, with the parts of its score.",
        columns=("policy", *plain, "x_m", "y_m", "interventions", "way_share", "pace", "obeyed", "score"),
        rows=rows,
    )
