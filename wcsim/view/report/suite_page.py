"""The page of a test, on a suite or at the end of a demo: tables, figures, failures, and what its words mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.agents.evaluation.suite.rows import ResultRow
from wcsim.core.constants import RECORDED
from wcsim.core.files import write_bytes
from wcsim.core.reading import counted
from wcsim.view.report.columns import COLUMNS, GROUPS, Column
from wcsim.view.report.comparisons import WEIGHTINGS, Paired, compared, verdict, verdicts, weighted
from wcsim.view.report.failures import WORST, FailedEpisode, Illustration, Key, where_typed
from wcsim.view.report.figures import figures_of
from wcsim.view.report.pages import Cell, Exhibit, Figure, ShownTable, page, write_page


def _result_table(result: TestResult, part: str) -> Exhibit:
    """The table of a part, "" for all parts."""
    rows = [row for row in (result.rows if part else result.pooled) if row.part == part]
    name = f"table-{part or 'all'}"
    tables = [
        ShownTable(
            name=f"{name}-{what.split()[0]}",
            headings=["policy", *columns],
            rows=[[row.policy, *(_figure(row, column) for column in columns)] for row in rows],
        )
        for what, columns in GROUPS.items()
    ]
    return Exhibit(
        name=name,
        title=f"Part {part}" if part else "All parts",
        says="Small figures are 95 % intervals.",
        columns=["policy", *(key for column in COLUMNS for key in _keys(column))],
        rows=[[row.policy, *(cell for column in COLUMNS for cell in _plain(row, column))] for row in rows],
        tables=tables,
    )


def comparison_table(pairs: Sequence[Paired]) -> Exhibit:
    """Policies against their rivals over the same episodes: those of all parts, and part by part."""
    counts = ("episodes", "saved", "lost")
    headings = ("policy", "against", "part", *counts, "p (McNemar)", "difference of scores", "different")
    columns = ("policy", "rival", "part", *counts, "mcnemar_p", "difference")
    return Exhibit(
        name="comparison",
        title="Paired comparisons over the same episodes",
        says="saved: only the policy that it is compared with has an own crash; lost: only this policy has one. "
        "Intervals are bootstrapped over the differences of single episodes. Each comparison stands alone: of twenty "
        "between equal policies, about one looks different by chance.",
        columns=(*columns, "low", "high"),
        rows=[[*(getattr(pair, name) for name in columns), *(pair.interval or (None, None))] for pair in pairs],
        tables=[
            ShownTable(name=name, headings=headings, rows=[_pair_row(pair) for pair in pairs if bool(pair.part) is by])
            for name, by in (("comparison", False), ("comparison-parts", True))
        ],
    )


def _pair_row(pair: Paired) -> tuple[Cell | Figure, ...]:
    between = f"{pair.interval[0]:+.3f} to {pair.interval[1]:+.3f}" if pair.interval else "too few episodes"
    return (
        pair.policy,
        pair.rival,
        pair.part or "all",
        pair.episodes,
        pair.saved,
        pair.lost,
        Figure(f"{pair.mcnemar_p:.2g}", pair.mcnemar_p),
        Figure(f"{pair.difference:+.3f}", pair.difference, between),
        "yes" if pair.separated else "no" if pair.interval else None,
    )


def _weights_table(result: TestResult) -> Exhibit:
    """The score and what other weights would say."""
    found = weighted(result)
    shown: list[list[Cell | Figure]] = [
        [name, *(Figure(f"{mean:.3f}", mean, f"rank {rank}") for mean, rank in values)]
        for name, values in found.items()
    ]
    return Exhibit(
        name="weights",
        title="Scores with other weights",
        says=f"{'; '.join(f'{way.heading}: {way.says}' for way in WEIGHTINGS)}.",
        columns=["policy", *(f"{way.heading}, {what}" for way in WEIGHTINGS for what in ("mean", "rank"))],
        rows=[
            [name, *(cell for mean, rank in values for cell in (round(mean, 6), rank))]
            for name, values in found.items()
        ],
        tables=[ShownTable(name="weights", headings=["policy", *WEIGHTINGS], rows=shown)],
    )


def _figure(row: ResultRow, column: Column) -> Figure:
    value = column.value(row)
    if value is None:
        return Figure("–", None)
    if column.key == "mcnemar_p" and value == 0:
        return Figure("< 1e-6", value)  # a result keeps six digits
    bounds = getattr(row, column.interval) if column.interval else None
    below = " to ".join(map(column.form.format, bounds)) if bounds is not None else ""
    return Figure(column.form.format(value), value, below)


def _keys(column: Column) -> list[str]:
    return [column.key, *((f"{column.interval}_low", f"{column.interval}_high") if column.interval else ())]


def _plain(row: ResultRow, column: Column) -> list[Cell]:
    bounds = (getattr(row, column.interval) or (None, None)) if column.interval else ()
    return [getattr(row, column.key), *bounds]


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
        "pooled": _result_table(result, ""),
        "against": comparison_table(pairs),
        "weights": _weights_table(result),
        "failed": _failed(failures),
        "episodes": _episodes(result),
    }
    by_part, figures = [_result_table(result, part) for part in parts], figures_of(result, folder)
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


DEMO_PAGE: Final = "demo.html"


def write_demo_page(folder: Path, result: TestResult, **shown: object) -> Path:
    """Write the page; where it is.

    Args:
        folder: Where it goes, beside the film.
        result: Of the demo's test.
        shown: How the network `learned` in a sentence, the `film`'s name and what it says (`film_says`), a picture of
            it (`still_png`), and `commands` to go on with, each with what it does.

    Raises:
        DiskFullError: It cannot be written.
    """
    tables = [_result_table(result, part) for part in result.parts]
    path = folder / DEMO_PAGE
    write_bytes(path, page("demo.jinja", title="wcsim demo", tables=tables, **shown).encode())
    return path
