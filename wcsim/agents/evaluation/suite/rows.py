"""The rows of a suite's table: sums of episodes, what each figure stands on, and how well it is known."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

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
from wcsim.core import seeding
from wcsim.supervisor.kpi import DROP
from wcsim.types import F64

_DRAWS = 2000
FEWEST = 6  # of so many coins one in 32 shows one side alone, of five one in 16: fewer tell nothing at 95 %
_TAIL = 0.5 * (1.0 - 0.95)  # of a distribution on each side of the interval

Interval = tuple[float, float]


def garwood(events: int) -> Interval:
    """The exact (Garwood) 95 % interval of the mean of a Poisson distribution from which `events` were counted once.

    >>> [round(bound, 3) for bound in garwood(5)]
    [1.623, 11.668]
    """
    from scipy.stats import chi2

    low = 0.5 * float(chi2.ppf(_TAIL, 2 * events)) if events else 0.0
    return low, 0.5 * float(chi2.isf(_TAIL, 2 * events + 2))


def _wilson(count: int, of: int) -> Interval | None:
    """Wilson's 95 % interval of a share, which has a width where none or all were counted too; None of nothing.

    >>> [round(bound, 3) for bound in _wilson(20, 20)]
    [0.839, 1.0]
    """
    from scipy.stats import binomtest

    if of == 0:
        return None
    low, high = binomtest(count, of).proportion_ci(method="wilson")
    return float(low), float(high)


def bootstrapped(values: Sequence[float] | F64, weights: Sequence[float] | F64 | None = None) -> Interval | None:
    """The 95 % interval of a weighted mean over episodes, by drawing episodes anew.

    None without any weight, and of fewer than `FEWEST`. The draws are the same for the same numbers of episodes.
    """
    value = np.asarray(values, np.float64)
    weight = np.ones(len(value)) if weights is None else np.asarray(weights, np.float64)
    if len(value) < FEWEST or weight.sum() <= 0.0:
        return None
    drawn = seeding.generator(0, "bootstrap", len(value)).integers(0, len(value), (_DRAWS, len(value)))
    total = weight[drawn].sum(1)
    means = np.where(total > 0.0, (value * weight)[drawn].sum(1) / np.maximum(total, 1e-12), np.nan)
    low, high = np.nanpercentile(means, (2.5, 97.5)).tolist()
    return float(low), float(high)


def mcnemar(only_first: int, only_second: int) -> float:
    """Exact two-sided p-value of McNemar's test: as many or more one-sided pairs if neither were better.

    >>> round(mcnemar(1, 9), 4)
    0.0215
    """
    from scipy.stats import binomtest

    pairs = only_first + only_second
    return float(binomtest(only_first, pairs).pvalue) if pairs else 1.0


_DIGITS: Final = 6
_FAR_ENOUGH_KM: Final = 0.05  # below this a rate per kilometre says nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultRow:
    """A policy on one part of a list, or on all of it; None where nothing was measured, `_ci` are 95 % intervals."""

    policy: str
    part: str  # "" for all
    episodes: int  # that count
    uncounted: int  # that ended before the policy took over, and hazards that are free episodes once more
    status: Mapping[str, int]  # how many ended so, all of them
    km: float
    crashes_any: int
    crashes_own: int
    crashes_other: int  # another's fault, while the chair stood where it may
    drops: int
    crash_reasons: Mapping[str, int]
    crashes_per_km: float | None  # of the chair's own
    crashes_per_km_ci: Interval | None
    red_entries: int  # it set out over a crossing that had red
    crashed: float | None  # share of the episodes that a crash ended, whosever fault it was
    crashed_ci: Interval | None
    kpi1: float | None  # mean joystick distance
    kpi1_within: float | None  # share of steps with one of at most 0.1768
    kpi1_free: float | None  # mean over the steps that were free of danger when the policy answered
    kpi1_moving: float | None  # mean over the free steps in which the user's stick is out by more than 0.3
    kpi1_free_within: float | None  # share of those with one of at most 0.1768
    kpi1_free_within_ci: Interval | None
    free_share: float | None  # of the steps
    kpi2: float | None  # mean steps that an episode lived
    kpi2_median: float | None
    blocked_share: float | None  # of the free steps: the user pushes forward and gets less than half of it
    freezes: int  # times that the chair stood for 3 s and more though the user pushed, because the policy did not
    accel_rms_mps2: float | None  # from step to step
    stick_travel_per_s: float | None  # way of the stick that the chair was given
    asked_travel_per_s: float | None  # and of the user's
    speed_mps: float | None
    arrivals: int  # episodes that ended at their goal, of those that have one to reach
    attempts: int  # those
    arrivals_ci: Interval | None
    goals: int  # destinations reached, also those that are drawn one after the other
    given_up: int
    crossings: int  # completed: in from one pavement, out on the opposite one
    road_s: float  # of standing on a carriageway
    score: float | None
    score_ci: Interval | None
    interventions: int
    judged_episodes: int
    judged_km: float
    needed: int
    needless: int
    needless_ci: Interval | None
    missed: int
    warned_share: float | None
    false_warnings_per_km: float | None
    helps: int  # times that the user asked for help
    unaided_crashes_own: int | None = None  # of the same episodes with the user alone, as the next
    saved: int | None = None
    lost: int | None = None
    mcnemar_p: float | None = None

    @property
    def undone(self) -> int:
        """Episodes that its policy did not bring to an end: it failed or was refused."""
        return self.status[POLICY_FAILED] + self.status[REFUSED]

    @property
    def without_result(self) -> bool:
        """Whether its policy came to the end of no episode that it was given, whatever the figures say."""
        return self.undone == sum(self.status.values()) - self.status[NOT_REACHED] > 0

    def to_json(self) -> dict[str, Any]:
        """Plain values under the same names."""
        return asdict(self)


def row_of(policy: str, part: str, records: Sequence[EpisodeRecord], unaided: Sequence[EpisodeRecord]) -> ResultRow:
    """One row: a policy on one part of a suite, or on all of it.

    Args:
        policy: What it is called.
        part: The part, "" for all.
        records: Its episodes.
        unaided: The same episodes with the user alone, in the same order; empty where they were not driven.
    """
    counted = [record for record in records if record.counts]
    figures: dict[str, Any] = {
        "uncounted": len(records) - len(counted),
        "status": {name: sum(record.status == name for record in records) for name in STATUSES},
        **_crashes(counted),
        **_obedience(counted),
        **_service(counted),
        **_interventions(counted),
        **(_twins(records, unaided) if records and len(unaided) == len(records) else {}),
    }
    rounded = {key: _rounded(value) for key, value in figures.items()}
    return ResultRow(policy=policy, part=part, episodes=len(counted), **rounded)


def _crashes(records: Sequence[EpisodeRecord]) -> dict[str, Any]:
    crashes = [record for record in records if record.status == CRASHED]
    own = sum(record.own for record in crashes)
    km = _km(records)
    low, high = garwood(own)
    rated = km >= _FAR_ENOUGH_KM
    return {
        "km": km,
        "crashes_any": len(crashes),
        "crashes_own": own,
        "crashes_other": len(crashes) - own,
        "drops": sum(record.reason == DROP for record in crashes),
        "crash_reasons": dict(sorted(Counter(record.reason for record in crashes).items())),
        "crashes_per_km": own / km if rated else None,
        "crashes_per_km_ci": (low / km, high / km) if rated else None,
        "red_entries": _count(records, "red_entries"),
        "crashed": _ratio(len(crashes), len(records)),
        "crashed_ci": _wilson(len(crashes), len(records)),
    }


def _obedience(records: Sequence[EpisodeRecord]) -> dict[str, Any]:
    steps, free, moving = (_count(records, name) for name in ("steps", "free_steps", "moving_steps"))
    within = [record.moving_within / record.moving_steps if record.moving_steps else 0.0 for record in records]
    return {
        "kpi1": _ratio(_sum(records, "distance_sum"), steps),
        "kpi1_within": _ratio(_count(records, "within"), steps),
        "kpi1_free": _ratio(_sum(records, "free_sum"), free),
        "kpi1_moving": _ratio(_sum(records, "moving_sum"), moving),
        "kpi1_free_within": _ratio(_count(records, "moving_within"), moving),
        "kpi1_free_within_ci": bootstrapped(within, [float(record.moving_steps) for record in records]),
        "free_share": _ratio(free, steps),
        "kpi2": _ratio(steps, len(records)),
        "kpi2_median": float(np.median([record.steps for record in records])) if records else None,
        "blocked_share": _ratio(_count(records, "blocked_steps"), free),
        "freezes": _count(records, "freezes"),
    }


def _service(records: Sequence[EpisodeRecord]) -> dict[str, Any]:
    scores = [record.score for record in records]
    sent = [record for record in records if record.part in ON_THE_WAY]
    arrived = sum(record.status == FINISHED for record in sent)
    time_s = _sum(records, "time_s")
    # From step to step; that of a crash is left out.
    changes = sum(max(0, record.steps - 1 - (record.status == CRASHED)) for record in records)
    return {
        "accel_rms_mps2": None if (mean := _ratio(_sum(records, "accel_sq_sum"), changes)) is None else math.sqrt(mean),
        "stick_travel_per_s": _ratio(_sum(records, "stick_travel"), time_s),
        "asked_travel_per_s": _ratio(_sum(records, "asked_travel"), time_s),
        "speed_mps": _ratio(_sum(records, "m"), time_s),
        "arrivals": arrived,
        "attempts": len(sent),
        "arrivals_ci": _wilson(arrived, len(sent)),
        "goals": _count(records, "goals"),
        "given_up": _count(records, "given_up"),
        "crossings": _count(records, "crossings"),
        "road_s": _sum(records, "road_s"),
        "score": _ratio(math.fsum(scores), len(scores)),
        "score_ci": bootstrapped(scores),
    }


def _interventions(records: Sequence[EpisodeRecord]) -> dict[str, Any]:
    judged = [record for record in records if record.judged]
    needed, needless = (
        [sum(item.verdict == verdict for item in record.interventions) for record in judged]
        for verdict in (NEEDED, NEEDLESS)
    )
    spread = bootstrapped(needless)  # of the mean
    km = _km(judged)
    return {
        "interventions": sum(len(record.interventions) for record in records),
        "judged_episodes": len(judged),
        "judged_km": km,
        "needed": sum(needed),
        "needless": sum(needless),
        "needless_ci": spread and (spread[0] * len(judged), spread[1] * len(judged)),
        "missed": _count(records, "missed"),
        "warned_share": _ratio(_count(judged, "warned"), _count(judged, "to_warn")),
        "false_warnings_per_km": _count(judged, "false_warnings") / km if km >= _FAR_ENOUGH_KM else None,
        "helps": _count(records, "helps"),
    }


def _count(records: Sequence[EpisodeRecord], name: str) -> int:
    return sum(getattr(record, name) for record in records)


def _sum(records: Sequence[EpisodeRecord], name: str) -> float:
    return math.fsum(getattr(record, name) for record in records)


def _km(records: Sequence[EpisodeRecord]) -> float:
    return math.fsum(record.m for record in records) / 1000.0


def pooled_rows(
    policy: str, records: Sequence[EpisodeRecord], unaided: Sequence[EpisodeRecord]
) -> tuple[list[ResultRow], ResultRow]:
    """A policy's rows by part, in the order of the parts' first episodes, and that of all episodes."""
    rows = []
    for part in dict.fromkeys(record.part for record in records):
        chosen = [number for number, record in enumerate(records) if record.part == part]
        twins = [unaided[number] for number in chosen] if len(unaided) == len(records) else []
        rows.append(row_of(policy, part, [records[number] for number in chosen], twins))
    return rows, row_of(policy, "", records, unaided)


def _twins(records: Sequence[EpisodeRecord], unaided: Sequence[EpisodeRecord]) -> dict[str, Any]:
    """What became of the same episodes with the user alone; crashes that are the chair's own, and falls."""
    saved, lost = saved_and_lost(records, unaided)
    return {
        "unaided_crashes_own": sum(twin.own for _, twin in both_counted(records, unaided)),
        "saved": saved,
        "lost": lost,
        "mcnemar_p": mcnemar(saved, lost),
    }


def _ratio(above: float, below: float) -> float | None:
    return above / below if below else None


def _rounded(value: Any) -> Any:
    """Sums of floats in one order are equal everywhere; their last digits are not worth a byte."""
    if isinstance(value, float):
        return round(value, _DIGITS)
    if isinstance(value, tuple):
        return tuple(_rounded(item) for item in value)
    return value
