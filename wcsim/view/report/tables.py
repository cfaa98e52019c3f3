"""The tables of a test: every figure with its interval, and a line for each column that explains it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from wcsim.agents.evaluation.suite.result_files import KeptResult, Row
from wcsim.view.report.comparisons import WEIGHTINGS, Paired, weighted
from wcsim.view.report.markup import Cell, Exhibit, Markup, csv_of, el, joined, table

_Worst = Callable[[str], object]  # what leads to a policy's worst moment


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
        says="0 after an own crash or a red light, else share of the route x pace x obedience; mean over episodes",
        form="{:.3f}",
    ),
    Column(heading="own crashes", key="crashes_own", says="crashes and falls by the chair's fault"),
    Column(
        heading="own crashes per km",
        key="crashes_per_km",
        interval="crashes_per_km_ci",
        says="with Garwood's interval",
        form="{:.2f}",
    ),
    Column(
        heading="close to user",
        key="kpi1_free_within",
        interval="kpi1_free_within_ci",
        says="obedience: share of moving steps without danger within 0.1768 of the user's command",
        form="{:.1%}",
    ),
    Column(heading="episodes", key="episodes", says="all count, however they ended"),
    Column(heading="km", key="km", says="distance driven", form="{:.2f}"),
    Column(heading="crashes by others", key="crashes_other", says="crashes by another's fault"),
    Column(heading="falls off kerbs", key="drops", says="also counted as own crashes"),
    Column(heading="red lights", key="red_entries", says="times that the chair entered a crossing at red"),
    Column(
        heading="without a crash",
        key="alive_at_end",
        interval="alive_at_end_ci",
        says="share of episodes that were driven to their end without any crash",
        form="{:.0%}",
    ),
    Column(
        heading="saved",
        key="saved",
        says="episodes with an own crash of the user alone, and none with the policy",
    ),
    Column(
        heading="lost",
        key="lost",
        says="episodes with an own crash with the policy, and none of the user alone",
    ),
    Column(heading="p", key="mcnemar_p", says="McNemar's exact p-value of saved against lost", form="{:.2g}"),
)
SERVICE: Final = (
    Column(
        heading="KPI 1",
        key="kpi1",
        says="mean distance between the driven and the user's stick, over all steps",
        form="{:.3f}",
    ),
    Column(heading="KPI 2", key="kpi2_median", says="steps of an episode, median", form="{:.0f}"),
    Column(
        heading="arrivals",
        key="arrivals",
        says="episodes of the parts free and crossing that reached their destination",
    ),
    Column(heading="speed, m/s", key="speed_mps", says="mean", form="{:.2f}"),
    Column(heading="seconds on road", key="road_s", says="time of standing on a carriageway", form="{:.0f}"),
    Column(
        heading="blocked",
        key="blocked_share",
        says="share of steps without danger that give less than half of the user's push ahead",
        form="{:.1%}",
    ),
    Column(heading="times frozen", key="freezes", says="stood for 3 s or more while the user's stick was out"),
)
_JUDGED: Final = (
    Column(
        heading="interventions",
        key="interventions",
        says="stretches in which the policy did not do what was requested, in all episodes",
    ),
    Column(heading="missed crashes", key="missed", says="own crashes without an intervention in the last 5 s"),
    Column(
        heading="judged episodes",
        key="judged_episodes",
        says="their interventions were judged in copies of the world in which the user drives on alone",
    ),
    Column(
        heading="needed",
        key="needed",
        says="judged interventions without which the user crashes within 5 s",
    ),
    Column(
        heading="unneeded",
        key="needless",
        says="judged interventions without which nothing happens within 5 s",
    ),
    Column(
        heading="warned in time",
        key="warned_share",
        says="share of dangers with a warning at least 1 s ahead; 0 % if the policy cannot warn",
        form="{:.0%}",
    ),
    Column(
        heading="false warnings per km",
        key="false_warnings_per_km",
        says="warnings that no danger follows",
        form="{:.0f}",
    ),
    Column(heading="help", key="helps", says="times that the user asked for help"),
)
COLUMNS: Final = (*SAFETY, *SERVICE, *_JUDGED)


def result_table(result: KeptResult, part: str, worst: _Worst | None = None) -> Exhibit:
    """The table of a part, "" for all parts; `worst` gives what stands below each policy's name."""
    rows = [row for row in (result.rows if part else result.pooled) if row["part"] == part]
    name = f"table-{part or 'all'}"
    safety = _table(rows, SAFETY, f"{name}-safety", worst)
    service = _table(rows, SERVICE, f"{name}-service", None)
    judged = _table(rows, _JUDGED, f"{name}-judged", None)
    keys = [key for column in COLUMNS for key in _keys(column)]
    plain = [[row["policy"], *(cell for column in COLUMNS for cell in _plain(row, column))] for row in rows]
    return Exhibit(
        name=name,
        title=f"Part {part}" if part else "All parts",
        says="Small figures are 95 % intervals.",
        body=joined((safety, service, judged)),
        csv=csv_of(["policy", *keys], plain),
    )


def _table(rows: Sequence[Row], columns: Sequence[Column], name: str, worst: _Worst | None) -> Markup:
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
        title="Scores with other weights",
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
