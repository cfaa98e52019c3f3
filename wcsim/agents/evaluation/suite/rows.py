"""The figures of a test: what each is, how it is summed over episodes, and how tables show it.

A figure is one entry of `ResultRow`, whose place there is its place in result.json. What an
episode's record does not hold yet is measured in `supervisor/kpi.py` or `drive.py`, under a new
field of the record.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Final

from wcsim.agents.evaluation.suite.intervals import (
    Interval,
    bootstrapped,
    mcnemar,
    wilson,
)
from wcsim.agents.evaluation.suite.records import (
    CRASHED,
    FINISHED,
    NEEDED,
    NEEDLESS,
    NOT_REACHED,
    ON_THE_WAY,
    POLICY_FAILED,
    REFUSED,
    STATUSES,
    EpisodeRecord,
    both_counted,
    saved_and_lost,
)
from wcsim.supervisor.kpi import DROP

# ruff: noqa: RUF009 - a call of `_figure` declares a field

# The questions that the columns of a page answer.
_GLANCE: Final = "At a glance"  # the first, which consoles show, too
_FAULT: Final = "Whose fault were the crashes?"
_OBEDIENCE: Final = "Does it do what is asked?"
_ARRIVAL: Final = "Does one get there?"
_ALARMS: Final = "Does it step in and warn when it should?"
_QUESTIONS: Final = (_GLANCE, _FAULT, _OBEDIENCE, _ARRIVAL, _ALARMS)

# What a policy may cost where nothing happens: the bar of a list of ways.
_MOST_LATE: Final = 0.05  # of the drives: arrivals of the user alone, less the policy's
_SLOWEST: Final = 0.8
_MOST_UNNEEDED: Final = 1.0  # interventions a drive
_DIGITS: Final = 6
_FAR_ENOUGH_KM: Final = 0.05  # below this a rate per kilometre says nothing

Episodes = Sequence[EpisodeRecord]
Measured = float | None  # None where nothing was measured
Range = Interval | None  # 95 %


@dataclass(frozen=True, slots=True)
class Column:
    """A figure as tables show it."""

    key: str  # of `ResultRow`
    question: str
    heading: str
    description: str
    form: str = "{:d}"
    range_form: str = ""  # of its two ends; "" for that of the figure
    counted_in: str = ""  # key of a number: where that is 0 there is no figure
    after: str = ""  # key of the column before it; "" for the order of the row

    @property
    def interval(self) -> str:
        """Key of its range; "" where there is none."""
        key = f"{self.key}_ci"
        return key if key in _FIGURES else ""

    def value(self, row: ResultRow) -> Any:
        """The figure of a row; None where nothing was measured."""
        return getattr(row, self.key) if getattr(row, self.counted_in or "policy") else None

    def texts(self, row: ResultRow) -> tuple[str, str]:
        """The figure of a row and its 95 % range in words, "" for each that is not known."""
        value = self.value(row)
        if value is None:
            return "", ""
        if self.key == "mcnemar_p" and value == 0:
            return "< 1e-6", ""  # a result holds six digits
        bounds = getattr(row, self.interval) if self.interval else None
        ends = " to ".join((self.range_form or self.form).format(end) for end in bounds or ())
        return self.form.format(value, row=row), ends


class _Drives:
    """The episodes of a row, and those of them that a figure may be about."""

    def __init__(self, records: Episodes, unaided: Episodes) -> None:
        self.all = records
        known = len(unaided) == len(records)
        self.saved_lost = saved_and_lost(records, unaided) if known else None
        # Where nobody drove alone there are no pairs.
        self.unaided = unaided if known else [replace(each, status=NOT_REACHED) for each in records]
        self.counted = [each for each in records if each.counts]
        self.crashed = [each for each in self.counted if each.status == CRASHED]
        self.own = sum(each.own for each in self.crashed)
        self.directed = [each for each in self.counted if each.part in ON_THE_WAY]  # to an end
        self.arrived = sum(each.status == FINISHED for each in self.directed)
        self.judged = [each for each in self.counted if each.judged]
        self.km = _total(self.counted, "m") / 1000.0
        self.scores = [score for each in self.counted if (score := each.score) is not None]


_Sum = Callable[[_Drives], Any]


def _figure(total: _Sum, question: str = "", words: str = "", *form: str, **look: str) -> Any:
    """A field of a row.

    Args:
        total: How it is summed.
        question: The group of columns that shows it; "" for a figure that stands in files alone.
        words: Its heading and, after a colon, what it says.
        form: Form of a `Column`.
        look: The other parts of a `Column`.
    """
    column = question and (question, *words.split(": ", 1), *form)
    return field(metadata={"total": total, "column": column, "look": look})


def _count(name: str) -> _Sum:
    return lambda d: sum(getattr(each, name) for each in d.counted)


def _total(records: Episodes, name: str) -> float:
    return math.fsum(getattr(each, name) for each in records)


def _share(part: float, of: float) -> Measured:
    return part / of if of else None


def _ratio(above: str, below: str) -> _Sum:
    return lambda d: _share(_total(d.counted, above), _total(d.counted, below))


def _per_km(count: float, km: float) -> Measured:
    return count / km if km >= _FAR_ENOUGH_KM else None


def _followed_range(d: _Drives) -> Range:
    shares = [_share(each.within, each.steps) or 0.0 for each in d.counted]
    return bootstrapped(shares, [float(each.steps) for each in d.counted])


def _pace(pairs: Sequence[tuple[EpisodeRecord, EpisodeRecord]]) -> Measured:
    shares = [
        user.time_s / own.time_s
        for own, user in pairs
        if own.status == user.status == FINISHED and own.time_s
    ]
    return _share(math.fsum(shares), len(shares))


def _harm(d: _Drives) -> str | None:
    """What is worse than with the user alone, on ways; see `_MOST_LATE`."""
    pairs = [pair for pair in both_counted(d.all, d.unaided) if pair[0].part in ON_THE_WAY]
    if not pairs:
        return None
    saved, lost = saved_and_lost(*zip(*pairs, strict=True))
    late = sum((user.status == FINISHED) - (own.status == FINISHED) for own, user in pairs)
    judged = sum(own.judged for own, _ in pairs)
    needless = sum(item.verdict == NEEDLESS for own, _ in pairs for item in own.interventions)
    worse = {
        "crashes": lost > saved,
        "arrivals": late > _MOST_LATE * len(pairs),
        "pace": (_pace(pairs) or 1.0) < _SLOWEST,
        "meddling": needless > _MOST_UNNEEDED * judged,
    }
    return ", ".join(name for name, is_worse in worse.items() if is_worse) or "none"


def _jerkiness(d: _Drives) -> Measured:
    # From step to step; that of a crash is left out.
    changes = sum(max(0, each.steps - 1 - (each.status == CRASHED)) for each in d.counted)
    mean = _share(_total(d.counted, "accel_sq_sum"), changes)
    return None if mean is None else math.sqrt(mean)


def _interventions(d: _Drives, verdict: str) -> list[int]:
    """How many interventions of each judged episode have a verdict."""
    return [sum(item.verdict == verdict for item in each.interventions) for each in d.judged]


def _unneeded_range(d: _Drives) -> Range:
    mean = bootstrapped(_interventions(d, NEEDLESS))
    return mean and (mean[0] * len(d.judged), mean[1] * len(d.judged))


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultRow:
    """A policy on one part of a list, or on all of it.

    A figure is None where nothing was measured; a name with `_ci` is a 95 % interval.
    """

    policy: str
    part: str  # "" for all
    episodes: int = _figure(
        lambda d: len(d.counted), _FAULT, "drives: however they ended, less those uncounted"
    )
    uncounted: int = _figure(
        lambda d: len(d.all) - len(d.counted),
        _FAULT,
        "uncounted: ended before the policy took over",
    )
    status: Mapping[str, int] = _figure(
        lambda d: {name: sum(each.status == name for each in d.all) for name in STATUSES}
    )
    km: float = _figure(lambda d: d.km, _FAULT, "km: distance driven", "{:.2f}")
    crashes_any: int = _figure(
        lambda d: len(d.crashed),
        _GLANCE,
        "drives with a crash: whosever fault it was; the range is a share",
        "{:d} of {row.episodes}",
        range_form="{:.0%}",
    )
    crashes_any_ci: Range = _figure(lambda d: wilson(len(d.crashed), len(d.counted)))
    crashes_own: int = _figure(
        lambda d: d.own,
        _FAULT,
        "own crashes: crashes and falls by the chair's fault; the range is a share",
        range_form="{:.0%}",
    )
    crashes_own_ci: Range = _figure(lambda d: wilson(d.own, len(d.counted)))
    drops: int = _figure(
        lambda d: sum(each.reason == DROP for each in d.crashed),
        _FAULT,
        "falls off kerbs: also own crashes",
    )
    crash_reasons: Mapping[str, int] = _figure(
        lambda d: dict(sorted(Counter(each.reason for each in d.crashed).items()))
    )
    red_entries: int = _figure(
        _count("red_entries"),
        _FAULT,
        "red lights: times that the chair entered a crossing at red",
    )
    kpi1: Measured = _figure(
        _ratio("distance_sum", "steps"),
        _OBEDIENCE,
        "KPI 1: mean distance between the driven and the user's stick, over all steps",
        "{:.3f}",
    )
    followed: Measured = _figure(
        _ratio("within", "steps"),
        _GLANCE,
        "did what was asked: share of steps within 0.1768 of the user's stick",
        "{:.0%}",
    )
    followed_ci: Range = _figure(_followed_range)
    kpi2: Measured = _figure(
        lambda d: _share(_count("steps")(d), len(d.counted)),
        _ARRIVAL,
        "KPI 2: steps of a drive until a crash or its end, mean",
        "{:.0f}",
    )
    freezes: int = _figure(
        _count("freezes"),
        _OBEDIENCE,
        "times frozen: stood for 3 s or more while the user's stick was out",
        after="stick_travel_per_s",
    )
    accel_rms_mps2: Measured = _figure(
        _jerkiness,
        _OBEDIENCE,
        "jerkiness: acceleration, root mean square, m/s²",
        "{:.2f}",
    )
    stick_travel_per_s: Measured = _figure(
        _ratio("stick_travel", "time_s"),
        _OBEDIENCE,
        "stick travel: of the driven stick, per second",
        "{:.2f}",
    )
    asked_travel_per_s: Measured = _figure(_ratio("asked_travel", "time_s"))
    speed_mps: Measured = _figure(
        _ratio("m", "time_s"), _ARRIVAL, "speed, m/s: mean", "{:.2f}", after="crossings"
    )
    arrived: int = _figure(
        lambda d: d.arrived,
        _GLANCE,
        "arrived: at the destination, of drives that have one to reach; the range is a share",
        "{:d} of {row.attempts}",
        range_form="{:.0%}",
        counted_in="attempts",
    )
    attempts: int = _figure(lambda d: len(d.directed))
    arrived_ci: Range = _figure(lambda d: wilson(d.arrived, len(d.directed)))
    harm: str | None = _figure(
        _harm,
        _GLANCE,
        "harm: on ways, what is worse than for the user alone: more crashes, 5 % fewer arrivals, a "
        "pace below 80 %, more than one unneeded intervention a drive",
        "{}",
        after="arrived",
    )
    pace: Measured = _figure(
        lambda d: _pace(both_counted(d.all, d.unaided)),
        _ARRIVAL,
        "pace: the user's own time over that with the policy, where both arrived, mean",
        "{:.0%}",
    )
    goals: int = _figure(
        _count("goals"),
        _ARRIVAL,
        "goals: destinations reached, also in drives that go on to another",
    )
    given_up: int = _figure(
        _count("given_up"), _ARRIVAL, "given up: destinations that the user gave up"
    )
    crossings: int = _figure(_count("crossings"), _ARRIVAL, "crossings: crossings completed")
    road_s: float = _figure(
        lambda d: _total(d.counted, "road_s"),
        _ARRIVAL,
        "seconds on road: time of standing on a carriageway",
        "{:.0f}",
    )
    score: Measured = _figure(
        lambda d: _share(math.fsum(d.scores), len(d.scores)),
        _GLANCE,
        "score: 0 after any crash, else the share of steps in no unneeded intervention or, where "
        "nobody judged these, within 0.1768 of the user's stick; mean, without ways",
        "{:.2f}",
    )
    score_ci: Range = _figure(lambda d: bootstrapped(d.scores))
    interventions: int = _figure(
        lambda d: sum(len(each.interventions) for each in d.counted),
        _ALARMS,
        "interventions: stretches in which the policy did not do what was asked, in all drives",
    )
    judged_episodes: int = _figure(lambda d: len(d.judged))
    needed: int = _figure(
        lambda d: sum(_interventions(d, NEEDED)),
        _ALARMS,
        "needed: judged ones without which a copy of the world shows a crash within 5 s",
        after="missed",
    )
    unneeded: int = _figure(
        lambda d: sum(_interventions(d, NEEDLESS)),
        _GLANCE,
        "unneeded interventions: without which nothing happens within 5 s, in the drives that "
        "were judged so",
        "{:d} in {row.judged_episodes}",
        range_form="{:.0f}",
        counted_in="judged_episodes",
        after="followed",
    )
    unneeded_ci: Range = _figure(_unneeded_range)
    missed: int = _figure(
        _count("missed"),
        _ALARMS,
        "missed crashes: own crashes without an intervention in the last 5 s",
    )
    warned_share: Measured = _figure(
        lambda d: _share(_total(d.judged, "warned"), _total(d.judged, "to_warn")),
        _ALARMS,
        "warned in time: share of dangers with a warning at least 1 s ahead; 0 % if it cannot warn",
        "{:.0%}",
    )
    false_warnings_per_km: Measured = _figure(
        lambda d: _per_km(_total(d.judged, "false_warnings"), _total(d.judged, "m") / 1000.0),
        _ALARMS,
        "false warnings per km: warnings that no danger follows",
        "{:.0f}",
    )
    helps: int = _figure(_count("helps"), _ALARMS, "help: times that the user asked for help")
    saved: int | None = _figure(
        lambda d: d.saved_lost and d.saved_lost[0],
        _FAULT,
        "saved: drives with a crash of the user alone, and none with the policy",
    )
    lost: int | None = _figure(
        lambda d: d.saved_lost and d.saved_lost[1],
        _FAULT,
        "lost: drives with a crash with the policy, and none of the user alone",
    )
    mcnemar_p: Measured = _figure(
        lambda d: d.saved_lost and mcnemar(*d.saved_lost),
        _FAULT,
        "p: McNemar's exact p-value of saved against lost",
        "{:.2g}",
    )

    @property
    def undone(self) -> int:
        """Episodes that its policy did not bring to an end: it failed or was refused."""
        return self.status[POLICY_FAILED] + self.status[REFUSED]

    @property
    def without_result(self) -> bool:
        """Whether its policy came to the end of no episode that it was given."""
        return self.undone == sum(self.status.values()) - self.status[NOT_REACHED] > 0

    def to_json(self) -> dict[str, Any]:
        """Plain values under the same names."""
        return asdict(self)


_FIGURES: Final = {each.name: each.metadata for each in fields(ResultRow) if each.metadata}
_ORDER: Final = (*_QUESTIONS, *_FIGURES)
COLUMNS: Final = sorted(
    (Column(name, *of["column"], **of["look"]) for name, of in _FIGURES.items() if of["column"]),
    key=lambda column: (
        _ORDER.index(column.question),
        _ORDER.index(column.after or column.key),
        bool(column.after),
    ),
)
GROUPS: Final = {
    question: [column for column in COLUMNS if column.question == question]
    for question in _QUESTIONS
}
LOOK: Final = GROUPS[_GLANCE]  # all that a first look needs


def filled_columns(columns: Sequence[Column], rows: Sequence[ResultRow]) -> list[Column]:
    """Those in which a row has a figure."""
    return [column for column in columns if any(column.texts(row)[0] for row in rows)]


def row_of(policy: str, part: str, records: Episodes, unaided: Episodes) -> ResultRow:
    """One row: a policy on one part of a suite, or on all of it.

    Args:
        policy: What it is called.
        part: The part, "" for all.
        records: Its episodes.
        unaided: The same episodes with the user alone, in the same order; empty where they were
            not driven.
    """
    drives = _Drives(records, unaided)
    figures = {name: _rounded(figure["total"](drives)) for name, figure in _FIGURES.items()}
    return ResultRow(policy=policy, part=part, **figures)


def pooled_rows(
    policy: str, records: Episodes, unaided: Episodes
) -> tuple[list[ResultRow], ResultRow]:
    """A policy's rows by part, in the order of the parts' first episodes, and that of all."""
    rows = []
    for part in dict.fromkeys(record.part for record in records):
        chosen = [number for number, record in enumerate(records) if record.part == part]
        alone = [unaided[number] for number in chosen] if len(unaided) == len(records) else []
        rows.append(row_of(policy, part, [records[number] for number in chosen], alone))
    return rows, row_of(policy, "", records, unaided)


def _rounded(value: Any) -> Any:
    """Sums of floats in one order are equal everywhere; their last digits are not worth a byte."""
    if isinstance(value, float):
        return round(value, _DIGITS)
    if isinstance(value, tuple):
        return tuple(_rounded(item) for item in value)
    return value
