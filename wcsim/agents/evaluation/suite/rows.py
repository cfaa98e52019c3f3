"""The rows of a suite's table: sums of episodes, with what each figure stands on and how well it is known."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from wcsim.agents.evaluation.intervals import bootstrapped, garwood, mcnemar, wilson
from wcsim.agents.evaluation.suite.records import (
    CRASHED,
    FINISHED,
    NEEDED,
    NEEDLESS,
    ON_THE_WAY,
    POLICY_FAILED,
    REFUSED,
    STATUSES,
    EpisodeRecord,
    saved_and_lost,
)
from wcsim.config.suite import SuiteFile
from wcsim.supervisor.kpi import DROP

_DIGITS: Final = 6
_FAR_ENOUGH_KM: Final = 0.05  # below this a rate per kilometre says nothing

Row = dict[str, Any]


def row_of(policy: str, part: str, records: Sequence[EpisodeRecord], unaided: Sequence[EpisodeRecord]) -> Row:
    """One row: a policy on one part of a suite, or on all of it.

    Args:
        policy: What it is called.
        part: The part, "" for all.
        records: Its episodes.
        unaided: The same episodes with the user alone, in the same order; empty where they were not driven.
    """
    row: Row = {
        "policy": policy,
        "part": part,
        "episodes": len(records),
        "status": {name: sum(record.status == name for record in records) for name in STATUSES},
        **_crashes(records),
        **_obedience(records),
        **_service(records),
        **_interventions(records),
    }
    if len(unaided) == len(records) and records:
        row |= _twins(records, unaided)
    return {key: _rounded(value) for key, value in row.items()}


def _crashes(records: Sequence[EpisodeRecord]) -> Row:
    crashes = [record for record in records if record.status == CRASHED]
    own = sum(record.own for record in crashes)
    km = _km(records)
    low, high = garwood(own)
    rated = km >= _FAR_ENOUGH_KM
    return {
        "km": km,
        "crashes_own": own,
        "crashes_other": len(crashes) - own,
        "drops": sum(record.reason == DROP for record in crashes),
        "crash_reasons": dict(sorted(Counter(record.reason for record in crashes).items())),
        "crashes_per_km": own / km if rated else None,
        "crashes_per_km_ci": [low / km, high / km] if rated else None,
        "red_entries": sum(record.red_entries for record in records),
        "alive_at_end": _ratio(len(records) - len(crashes) - _failed(records), len(records)),
        "alive_at_end_ci": _pair(wilson(sum(map(_alive, records)), len(records))),
    }


def _obedience(records: Sequence[EpisodeRecord]) -> Row:
    steps = sum(record.steps for record in records)
    moving = [record.moving_steps for record in records]
    within = [record.moving_within / record.moving_steps if record.moving_steps else 0.0 for record in records]
    return {
        "kpi1": _ratio(math.fsum(record.distance_sum for record in records), steps),
        "kpi1_free_within": _ratio(sum(record.moving_within for record in records), sum(moving)),
        "kpi1_free_within_ci": _pair(bootstrapped(within, [float(count) for count in moving])),
        "kpi2_median": float(np.median([record.steps for record in records])) if records else None,
        "blocked_share": _ratio(sum(r.blocked_steps for r in records), sum(r.free_steps for r in records)),
        "freezes": sum(record.freezes for record in records),
    }


def _service(records: Sequence[EpisodeRecord]) -> Row:
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
        "speed_mps": _ratio(math.fsum(record.m for record in records), time_s),
        "arrivals": arrived,
        "attempts": len(sent),
        "arrivals_ci": _pair(wilson(arrived, len(sent))),
        "road_s": math.fsum(record.road_s for record in records),
        "score": _ratio(math.fsum(scores), len(scores)),
        "score_ci": _pair(bootstrapped(scores)),
    }


def _interventions(records: Sequence[EpisodeRecord]) -> Row:
    judged = [record for record in records if record.judged]
    found = [item for record in judged for item in record.interventions]
    km = _km(judged)
    return {
        "interventions": sum(len(record.interventions) for record in records),
        "judged_episodes": len(judged),
        "judged_km": km,
        "needed": sum(item.verdict == NEEDED for item in found),
        "needless": sum(item.verdict == NEEDLESS for item in found),
        "missed": sum(record.missed for record in records),
        "warned_share": _ratio(sum(record.warned for record in judged), sum(record.to_warn for record in judged)),
        "false_warnings_per_km": sum(r.false_warnings for r in judged) / km if km >= _FAR_ENOUGH_KM else None,
        "helps": sum(record.helps for record in records),
    }


def _sum(records: Sequence[EpisodeRecord], name: str) -> float:
    return math.fsum(getattr(record, name) for record in records)


def _km(records: Sequence[EpisodeRecord]) -> float:
    return math.fsum(record.m for record in records) / 1000.0


def pooled_rows(
    policy: str, records: Sequence[EpisodeRecord], unaided: Sequence[EpisodeRecord]
) -> tuple[list[Row], Row]:
    """A policy's rows by part, in the order of the parts' first episodes, and that of all episodes."""
    rows = []
    for part in dict.fromkeys(record.part for record in records):
        chosen = [number for number, record in enumerate(records) if record.part == part]
        twins = [unaided[number] for number in chosen] if len(unaided) == len(records) else []
        rows.append(row_of(policy, part, [records[number] for number in chosen], twins))
    return rows, row_of(policy, "", records, unaided)


def undone(row: Mapping[str, Any]) -> int:
    """Episodes of a row that its policy did not bring to an end: it failed or was refused."""
    status: dict[str, int] = row["status"]
    return status[POLICY_FAILED] + status[REFUSED]


def result_of(file: SuiteFile, sha256: str, rows: Sequence[Row], pooled: Sequence[Row]) -> dict[str, Any]:
    """The whole result as plain values; the version is in the suite's name."""
    return {"suite": file.suite, "set": file.set, "list_sha256": sha256, "rows": list(rows), "pooled": list(pooled)}


def _twins(records: Sequence[EpisodeRecord], unaided: Sequence[EpisodeRecord]) -> Row:
    """What became of the same episodes with the user alone; crashes that are the chair's own, and falls."""
    saved, lost = saved_and_lost(records, unaided)
    return {
        "unaided_crashes_own": sum(twin.own for twin in unaided),
        "saved": saved,
        "lost": lost,
        "mcnemar_p": mcnemar(saved, lost),
    }


def _alive(record: EpisodeRecord) -> bool:
    return record.status not in (CRASHED, POLICY_FAILED) and record.steps > 0


def _failed(records: Sequence[EpisodeRecord]) -> int:
    return sum(record.status != CRASHED and not _alive(record) for record in records)


def _ratio(above: float, below: float) -> float | None:
    return above / below if below else None


def _pair(interval: tuple[float, float] | None) -> list[float] | None:
    return None if interval is None else list(interval)


def _rounded(value: Any) -> Any:
    """Sums of floats in one order are equal everywhere; their last digits are not worth a byte."""
    if isinstance(value, float):
        return round(value, _DIGITS)
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return value
