"""The tables of a test: every figure with its interval, and a line for each column that explains it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.agents.evaluation.suite.rows import ResultRow
from wcsim.view.report.columns import COLUMNS, GROUPS, SAFETY, Column
from wcsim.view.report.comparisons import WEIGHTINGS, Paired, weighted
from wcsim.view.report.markup import Cell, Exhibit, Markup, csv_of, el, joined, table

_Worst = Callable[[str], object]  # what leads to a policy's worst moment


def result_table(result: TestResult, part: str, worst: _Worst | None = None) -> Exhibit:
    """The table of a part, "" for all parts; `worst` gives what stands below each policy's name."""
    rows = [row for row in (result.rows if part else result.pooled) if row.part == part]
    name = f"table-{part or 'all'}"
    tables = [
        _table(rows, columns, f"{name}-{what.split()[0]}", worst if columns is SAFETY else None)
        for what, columns in GROUPS.items()
    ]
    keys = [key for column in COLUMNS for key in _keys(column)]
    plain = [[row.policy, *(cell for column in COLUMNS for cell in _plain(row, column))] for row in rows]
    return Exhibit(
        name=name,
        title=f"Part {part}" if part else "All parts",
        says="Small figures are 95 % intervals.",
        body=joined(tables),
        csv=csv_of(["policy", *keys], plain),
    )


def _table(rows: Sequence[ResultRow], columns: Sequence[Column], name: str, worst: _Worst | None) -> Markup:
    headings: list[object] = ["policy", *(el("span", column.heading, title=column.says) for column in columns)]
    lines = []
    for row in rows:
        cells: list[object] = [row.policy, *(_figure(row, column) for column in columns)]
        if worst is not None:
            cells[0] = joined((row.policy, el("br"), el("small", "worst: ", worst(row.policy))))
        lines.append(cells)
    return table(headings, lines, name)


def legend() -> Markup:
    """What each column is."""
    return el("dl", *(joined((el("dt", each.heading), el("dd", each.says))) for each in COLUMNS), class_="legend")


def comparison_table(pairs: Sequence[Paired]) -> Exhibit:
    """Policies against their rivals over the same episodes."""
    counted = ("episodes", "saved", "lost", "p (McNemar)")
    headings = ("policy", "against", "part", *counted, "difference of scores", "different")
    whole = table(headings, [_pair_row(pair) for pair in pairs if not pair.part], "comparison")
    parts = table(headings, [_pair_row(pair) for pair in pairs if pair.part], "comparison-parts")
    columns = ("policy", "rival", "part", "episodes", "saved", "lost", "mcnemar_p", "difference")
    plain = [[*(getattr(pair, name) for name in columns), *(pair.interval or (None, None))] for pair in pairs]
    return Exhibit(
        name="comparison",
        title="Paired comparisons over the same episodes",
        says="saved: only the policy that it is compared with has an own crash; lost: only this policy has one. "
        "Intervals are bootstrapped over the differences of single episodes. Each comparison stands alone: of twenty "
        "between equal policies, about one looks different by chance.",
        body=joined((whole, el("details", el("summary", "The same, part by part"), parts, class_="more"))),
        csv=csv_of((*columns, "low", "high"), plain),
    )


def _pair_row(pair: Paired) -> tuple[object, ...]:
    between = f"{pair.interval[0]:+.3f} to {pair.interval[1]:+.3f}" if pair.interval else "too few episodes"
    return (
        pair.policy,
        pair.rival,
        pair.part or "all",
        pair.episodes,
        pair.saved,
        pair.lost,
        (f"{pair.mcnemar_p:.2g}", pair.mcnemar_p),
        (_with_interval(f"{pair.difference:+.3f}", between), pair.difference),
        "yes" if pair.separated else "no" if pair.interval else "–",
    )


def weights_table(result: TestResult) -> Exhibit:
    """The score and what other weights would say."""
    found = weighted(result)
    headings = ["policy", *(el("span", way.name, title=way.says) for way in WEIGHTINGS)]
    shown = [
        [name, *((_with_interval(f"{mean:.3f}", f"rank {rank}"), mean) for mean, rank in values)]
        for name, values in found.items()
    ]
    columns = ["policy", *(f"{way.name}, {what}" for way in WEIGHTINGS for what in ("mean", "rank"))]
    plain: list[list[Cell]] = [
        [name, *(cell for mean, rank in values for cell in (round(mean, 6), rank))] for name, values in found.items()
    ]
    says = "; ".join(f"{way.name}: {way.says}" for way in WEIGHTINGS)
    return Exhibit(
        name="weights",
        title="Scores with other weights",
        says=f"{says}.",
        body=table(headings, shown, "weights"),
        csv=csv_of(columns, plain),
    )


def _figure(row: ResultRow, column: Column) -> object:
    value = getattr(row, column.key)
    text = _said(column.form, value)
    if column.key == "mcnemar_p" and value == 0:
        return "< 1e-6", value  # a result keeps six digits
    if text is None:
        return "–", None
    bounds = getattr(row, column.interval) if column.interval else None
    if bounds is not None:
        low, high = (_said(column.form, bound) or "–" for bound in bounds)
        return _with_interval(text, f"{low} to {high}"), value
    return text, value


def _said(form: str, value: object) -> str | None:
    """A number in its form; None for what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return form.format(round(value) if form == "{:d}" else value)


def _with_interval(figure: str, below: str) -> Markup:
    return joined((figure, el("small", below)))


def _keys(column: Column) -> list[str]:
    return [column.key, *((f"{column.interval}_low", f"{column.interval}_high") if column.interval else ())]


def _plain(row: ResultRow, column: Column) -> list[Cell]:
    value: Any = getattr(row, column.key)
    if not column.interval:
        return [value]
    bounds = getattr(row, column.interval)
    return [value, *(bounds if bounds is not None else (None, None))]
