"""Which disturbance moves a policy's result: a list driven clean, and again with each disturbance alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from wcsim.agents.evaluation.intervals import bootstrapped
from wcsim.agents.evaluation.suite.records import EpisodeRecord, undriven
from wcsim.agents.evaluation.suite.rows import row_of
from wcsim.agents.evaluation.suite.run import Done, SuiteOrder, run_suite

CLEAN: Final = ("cameras.0.noise=none", "world.action_delay_ticks=0")
DISTURBANCES: Final[Mapping[str, tuple[str, ...]]] = {
    "clean": (),
    "noise": ("cameras.0.noise=typical",),
    "delay of 200 ms": ("world.action_delay_ticks=2",),
    "a picture in five lost": ("cameras.0.lost_share=0.2",),
    "pictures up to 0.4 s old": ("cameras.0.every_ticks=5",),
    "tilt by accelerometer": ("imu.tilt=accelerometer",),
    "camera off by 2 degrees": ("vary.camera_turn_deg=[2,2]",),
    "mid-wheel drive": ("chair.plant=mwd",),
    "10 km/h": ("chair.v_max_mps=2.78",),
}
_KEPT: Final = (
    *("policy", "episodes", "status", "crashes_own", "crashes_other", "crashes_per_km"),
    *("kpi1_free_within", "speed_mps"),
)

Row = dict[str, Any]
Told = Callable[[str], object]


def sensitivity(order: SuiteOrder, policies: Sequence[str], told: Told) -> list[Row]:
    """Drive a list with each disturbance alone, without forks; a row for each policy and disturbance.

    `score_change` is the mean difference to the same episodes driven clean, with its 95 % interval (bootstrap).

    Raises what `run_suite` raises.
    """
    rows: list[Row] = []
    clean: Mapping[str, Sequence[EpisodeRecord]] = {}
    for name, settings in DISTURBANCES.items():
        disturbed = replace(order, settings=(*CLEAN, *order.settings, *settings), forks=0)  # what is set disturbs all
        driven = run_suite(disturbed, policies, _telling(told, name))
        clean = clean or driven
        for policy, records in driven.items():
            for line in undriven(policy, records):
                told(f"{name}: {line}")
            rows.append({"disturbance": name, "settings": list(settings), **_row(policy, records, clean[policy])})
    return sorted(rows, key=lambda row: list(driven).index(row["policy"]))


def _telling(told: Told, name: str) -> Done:
    return lambda policy, done, of: told(f"{name}: {policy}, {done} of {of} blocks")


def _row(policy: str, records: Sequence[EpisodeRecord], clean: Sequence[EpisodeRecord]) -> Row:
    whole = row_of(policy, "", records, ())
    changes = [now.score - before.score for now, before in zip(records, clean, strict=True)]
    kept = {key: whole[key] for key in (*_KEPT, "score", "score_ci")}
    return kept | {
        "score_change": round(float(np.mean(changes)), 6),
        "score_change_ci": _pair(bootstrapped(changes)),
    }


def _pair(interval: Iterable[float] | None) -> list[float] | None:
    return None if interval is None else [round(float(value), 6) for value in interval]
