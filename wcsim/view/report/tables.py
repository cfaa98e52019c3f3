"""The tables of a test: every figure with its interval."""

from __future__ import annotations

from collections.abc import Sequence

from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.agents.evaluation.suite.rows import ResultRow
from wcsim.view.report.columns import COLUMNS, GROUPS, Column
from wcsim.view.report.comparisons import WEIGHTINGS, Paired, weighted
from wcsim.view.report.pages import Cell, Exhibit, Figure, ShownTable


def result_table(result: TestResult, part: str) -> Exhibit:
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


def weights_table(result: TestResult) -> Exhibit:
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
