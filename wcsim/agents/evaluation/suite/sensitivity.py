"""Which disturbance moves a policy's result: a list driven clean, and again with each disturbance alone."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from wcsim.agents.evaluation.suite.intervals import Interval, bootstrapped
from wcsim.agents.evaluation.suite.records import EpisodeRecord, both_counted, undriven
from wcsim.agents.evaluation.suite.rows import ResultRow, row_of
from wcsim.agents.evaluation.suite.run import Done, SuiteOrder, run_suite
from wcsim.errors import TownError

CLEAN: Final = ("cameras.0.noise=none", "world.action_delay_ticks=0")
JUPEDSIM: Final = "people by JuPedSim"
DISTURBANCES: Final[Mapping[str, tuple[str, ...]]] = {
    "clean": (),
    "noise": ("cameras.0.noise.depth={}", "cameras.0.noise.classes={}", "cameras.0.noise.rgb={}"),
    "whole things, usual": ("cameras.0.noise.objects=usual",),
    "whole things, poor": ("cameras.0.noise.objects=poor",),
    "delay of 200 ms": ("world.action_delay_ticks=2",),
    "a picture in five lost": ("cameras.0.lost_share=0.2",),
    "pictures up to 0.4 s old": ("cameras.0.every_ticks=5",),
    "tilt by accelerometer": ("imu.tilt=accelerometer",),
    "camera off by 2 degrees": ("vary.camera_turn_deg=[2,2]",),
    "mid-wheel drive": ("chair.plant=mwd",),
    "10 km/h": ("chair.v_max_mps=2.78",),
    JUPEDSIM: ("world.street=jupedsim",),
}
Told = Callable[[str], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbed:
    """A policy's row with one disturbance, and what that does to its score."""

    disturbance: str
    settings: tuple[str, ...]
    row: ResultRow
    score_change: float  # mean difference to the same episodes driven clean
    score_change_ci: Interval | None

    def to_json(self) -> dict[str, Any]:
        """Plain values: the row's, and its own under the same names."""
        own = {name: getattr(self, name) for name in ("disturbance", "settings", "score_change", "score_change_ci")}
        return self.row.to_json() | own


def sensitivity(order: SuiteOrder, policies: Sequence[str], told: Told) -> list[Disturbed]:
    """Drive a list with each disturbance alone, without forks; a row for each policy and disturbance that it can have.

    Raises what `run_suite` raises.
    """
    rows: list[Disturbed] = []
    clean: Mapping[str, Sequence[EpisodeRecord]] = {}
    for name, settings in DISTURBANCES.items():
        disturbed = replace(order, settings=(*CLEAN, *order.settings, *settings), forks=0)  # what is set disturbs all
        try:
            driven = run_suite(disturbed, policies, _telling(told, name))
        except TownError as error:
            # A town may be one in which JuPedSim dies: a list without that row says more than none.
            if not clean or name != JUPEDSIM:
                raise
            told(f"{name}: left out: {error}")
            continue
        clean = clean or driven
        for policy, records in driven.items():
            for line in undriven(policy, records):
                told(f"{name}: {line}")
            changes = [now.score - before.score for now, before in both_counted(records, clean[policy])]
            low_high = bootstrapped(changes)
            rows.append(
                Disturbed(
                    disturbance=name,
                    settings=settings,
                    row=row_of(policy, "", records, ()),
                    score_change=round(float(np.mean(changes)), 6),
                    score_change_ci=None if low_high is None else (round(low_high[0], 6), round(low_high[1], 6)),
                )
            )
    return sorted(rows, key=lambda each: list(clean).index(each.row.policy))


def _telling(told: Told, name: str) -> Done:
    return lambda policy, done, of: told(f"{name}: {policy}, {done} of {of} blocks")
