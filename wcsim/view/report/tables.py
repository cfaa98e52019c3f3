"""The tables of a test: every figure with its interval, and a line for each column that says what it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from wcsim.agents.evaluation.suite.result_files import KeptResult, Row
from wcsim.view.report.comparisons import WEIGHTINGS, Paired, weighted
from wcsim.view.report.markup import Cell, Exhibit, Markup, csv_of, el, joined, table

Worst = Callable[[str], object]  # what leads to a policy's worst moment


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column of a result's table."""

    heading: str
    key: str
    says: str
    form: str = "{:d}"
    interval: str = ""  # key of the interval that stands below the figure


SAFETY: Final = (
    Column(
        heading="score",
        key="score",
        interval="score_ci",
        says="0 after an own crash or a red entry, else share of the way x pace x obedience; mean over episodes",
        form="{:.3f}",
    ),
    Column(heading="own crashes", key="crashes_own", says="by the chair's own fault, falls off kerbs among them"),
    Column(
        heading="own / km",
        key="crashes_per_km",
        interval="crashes_per_km_ci",
        says="the same a kilometre; Garwood's interval",
        form="{:.2f}",
    ),
    Column(
        heading="obeyed",
        key="kpi1_free_within",
        interval="kpi1_free_within_ci",
        says="share of the steps without danger, in which the user moves, that the stick was followed within 0.1768",
        form="{:.1%}",
    ),
    Column(heading="episodes", key="episodes", says="how many; every one counts, whatever became of it"),
    Column(heading="km", key="km", says="way that was driven", form="{:.2f}"),
    Column(heading="others'", key="crashes_other", says="crashes that were the other's fault"),
    Column(heading="drops", key="drops", says="falls off a kerb, counted in own crashes too"),
    Column(heading="at red", key="red_entries", says="times that it drove onto a crossing at red"),
    Column(
        heading="alive",
        key="alive_at_end",
        interval="alive_at_end_ci",
        says="share of episodes that were driven to their end without any crash",
        form="{:.0%}",
    ),
    Column(
        heading="saved",
        key="saved",
        says="episodes in which the user alone crashes by its own fault and the policy does not",
    ),
    Column(
        heading="lost",
        key="lost",
        says="episodes in which the policy crashes by its own fault and the user alone does not",
    ),
    Column(heading="p", key="mcnemar_p", says="McNemar's exact p-value of saved against lost", form="{:.2g}"),
)
SERVICE: Final = (
    Column(heading="distance", key="kpi1", says="mean joystick distance over all steps (KPI 1)", form="{:.3f}"),
    Column(heading="steps", key="kpi2_median", says="median of the steps of an episode (KPI 2)", form="{:.0f}"),
    Column(
        heading="arrived",
        key="arrivals",
        says="episodes of the parts free and crossing that ended at their destination",
    ),
    Column(heading="m/s", key="speed_mps", says="mean speed", form="{:.2f}"),
    Column(heading="s on road", key="road_s", says="seconds that the chair stood on a carriageway", form="{:.0f}"),
    Column(heading="blocked", key="blocked_share", says="share of free steps that go nowhere", form="{:.1%}"),
    Column(heading="froze", key="freezes", says="times that it stood for 3 s and more against a stick that was out"),
)
JUDGED: Final = (
    Column(
        heading="interventions",
        key="interventions",
        says="runs of steps in which it did not do as asked, in all episodes",
    ),
    Column(heading="missed", key="missed", says="own crashes without an intervention in the 5 s before"),
    Column(heading="judged", key="judged_episodes", says="episodes in which forks tell what came of the user's wish"),
    Column(
        heading="needed",
        key="needed",
        says="interventions of the judged episodes without which the user would have crashed in 5 s",
    ),
    Column(
        heading="needless",
        key="needless",
        says="interventions of the judged episodes without which nothing would have happened in 5 s",
    ),
    Column(
        heading="warned",
        key="warned_share",
        says="share of dangers warned of at least 1 s ahead; 0 % also of a policy that cannot warn",
        form="{:.0%}",
    ),
    Column(
        heading="false warnings/km",
        key="false_warnings_per_km",
        says="warnings a km that no danger followed",
        form="{:.0f}",
    ),
)
COLUMNS: Final = (*SAFETY, *SERVICE, *JUDGED)


def result_table(result: KeptResult, part: str, worst: Worst | None = None) -> Exhibit:
    """The table of a part, "" for all parts; `worst` gives what stands below each policy's name."""
    rows = [row for row in (result.rows if part else result.pooled) if row["part"] == part]
    name = f"table-{part or 'all'}"
    safety = _table(rows, SAFETY, f"{name}-safety", worst)
    service = _table(rows, SERVICE, f"{name}-service", None)
    judged = _table(rows, JUDGED, f"{name}-judged", None)
    keys = [key for column in COLUMNS for key in _keys(column)]
    plain = [[row["policy"], *(cell for column in COLUMNS for cell in _plain(row, column))] for row in rows]
    return Exhibit(
        name=name,
        title=f"Part {part}" if part else "All parts",
        says="Below a figure: its 95 % interval.",
        body=joined((safety, service, judged)),
        csv=csv_of(["policy", *keys], plain),
    )


def _table(rows: Sequence[Row], columns: Sequence[Column], name: str, worst: Worst | None) -> Markup:
    headings: list[object] = ["policy", *(el("span", column.heading, title=column.says) for column in columns)]
    lines = []
    for row in rows:
        cells: list[object] = [row["policy"], *(_figure(row, column) for column in columns)]
        if worst is not None:
            cells[0] = joined((row["policy"], el("br"), el("small", "worst: ", worst(row["policy"]))))
        lines.append(cells)
    return table(headings, lines, name)


def legend() -> Markup:
    """What each column is."""
    return el("dl", *(joined((el("dt", each.heading), el("dd", each.says))) for each in COLUMNS), class_="legend")


def comparison_table(pairs: Sequence[Paired]) -> Exhibit:
    """Policies against their rivals over the same episodes."""
    counted = ("episodes", "saved", "lost", "p (McNemar)")
    headings = ("policy", "against", "part", *counted, "score, difference", "separated")
    whole = table(headings, [_pair_row(pair) for pair in pairs if not pair.part], "comparison")
    parts = table(headings, [_pair_row(pair) for pair in pairs if pair.part], "comparison-parts")
    columns = ("policy", "rival", "part", "episodes", "saved", "lost", "mcnemar_p", "difference")
    plain = [[*(getattr(pair, name) for name in columns), *(pair.interval or (None, None))] for pair in pairs]
    return Exhibit(
        name="comparison",
        title="The same episodes, driven by two",
        says="saved: the rival crashes by its own fault and the policy does not; lost: the other way round. The "
        "interval is drawn over the differences of single episodes. Each holds for itself: of twenty comparisons "
        "of equals one is separated by chance.",
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


def weights_table(result: KeptResult) -> Exhibit:
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
        title="What other weights would say",
        says=f"{says}.",
        body=table(headings, shown, "weights"),
        csv=csv_of(columns, plain),
    )


def _figure(row: Row, column: Column) -> object:
    value = row.get(column.key)
    text = _said(column.form, value)
    if column.key == "mcnemar_p" and value == 0:
        return "< 1e-6", value  # a result keeps six digits
    if text is None:
        return "–", None
    bounds = row.get(column.interval) if column.interval else None
    if isinstance(bounds, list) and len(bounds) == 2:
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


def _plain(row: Row, column: Column) -> list[Cell]:
    value: Any = row.get(column.key)
    if not column.interval:
        return [value]
    bounds = row.get(column.interval)
    return [value, *(bounds if isinstance(bounds, list) and len(bounds) == 2 else (None, None))]
