"""The paper's two key performance indicators and what must stand beside them.

KPI 1 is the mean joystick distance between user and agent, KPI 2 the number of steps an episode lives. A chair that
never moves wins KPI 2, so distance driven, speed and crashes per kilometre belong to every row. A number that nothing
was measured for is None, never NaN.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass

import numpy as np

from wcsim.errors import ConfigError
from wcsim.types import F64, I32, Bool

MAX_FOLLOW_DISTANCE = 0.1768  # Table 1, sqrt(0.125^2 + 0.125^2)
SMALLEST = 1e-9  # kilometres or seconds below this are none at all


@dataclass(frozen=True, slots=True, kw_only=True)
class StepLog:
    """Every step of a test in order, and how its episodes ended.

    Steps after the last entry of `episode_steps` belong to an episode that still runs: they count, except for KPI 2.
    """

    distance: F64  # (N,) joystick distance
    free: I32  # (N,) 1 free, 0 danger, -1 not known
    speed_mps: F64  # (N,) signed forward speed
    dt_s: F64  # (N,)
    episode_steps: I32  # (E,)
    episode_crashed: Bool  # (E,)


@dataclass(frozen=True, slots=True, kw_only=True)
class KpiRow:
    """One row of a result table; None where nothing was measured."""

    steps: int
    episodes: int
    crashes: int
    km: float
    hours: float
    distance_mean: float | None  # KPI 1
    distance_p95: float | None
    share_within: float | None  # share of steps with a distance <= 0.1768
    distance_free_mean: float | None  # KPI 1 over the steps without danger
    distance_danger_mean: float | None
    free_share: float | None  # of the steps for which it is known
    steps_alive_mean: float | None  # KPI 2
    steps_alive_median: float | None
    speed_mean_mps: float | None
    crashes_per_km: float | None
    crashes_per_1000_steps: float | None


def summarise(log: StepLog) -> KpiRow:
    """All indicators of a test. Raises ConfigError when the step arrays differ in length."""
    lengths = {len(log.distance), len(log.free), len(log.speed_mps), len(log.dt_s)}
    if len(lengths) != 1 or len(log.episode_steps) != len(log.episode_crashed):
        raise ConfigError(f"step arrays have lengths {sorted(lengths)}; expected one value per step in each")
    steps, crashes = len(log.distance), int(np.count_nonzero(log.episode_crashed))
    km = float(np.sum(np.abs(log.speed_mps) * log.dt_s)) / 1000.0
    total_s = float(np.sum(log.dt_s))
    known = log.free >= 0
    within = log.distance <= MAX_FOLLOW_DISTANCE + 1e-6
    return KpiRow(
        steps=steps,
        episodes=len(log.episode_steps),
        crashes=crashes,
        km=km,
        hours=total_s / 3600.0,
        distance_mean=_mean(log.distance),
        distance_p95=float(np.quantile(log.distance, 0.95)) if steps else None,
        share_within=_mean(within),
        distance_free_mean=_mean(log.distance[log.free == 1]),
        distance_danger_mean=_mean(log.distance[log.free == 0]),
        free_share=_mean(log.free[known] == 1),
        steps_alive_mean=_mean(log.episode_steps),
        steps_alive_median=float(np.median(log.episode_steps)) if len(log.episode_steps) else None,
        speed_mean_mps=_ratio(float(np.sum(log.speed_mps * log.dt_s)), total_s),
        crashes_per_km=_ratio(crashes, km),
        crashes_per_1000_steps=_ratio(1000.0 * crashes, steps),
    )


class KpiMeter:
    """Collects steps one by one; 25 bytes a step."""

    def __init__(self) -> None:
        self._distance, self._speed, self._dt = array("d"), array("d"), array("d")
        self._free = array("b")
        self._episode_steps, self._crashed = array("i"), array("b")

    def add(self, distance: float, free: bool | None, speed_mps: float, dt_s: float) -> None:
        """One step; `free` is None when nobody asked for the truth."""
        self._distance.append(distance)
        self._free.append(-1 if free is None else int(free))
        self._speed.append(speed_mps)
        self._dt.append(dt_s)

    def end_episode(self, steps: int, crashed: bool) -> None:
        """An episode ended after `steps` steps."""
        self._episode_steps.append(steps)
        self._crashed.append(int(crashed))

    def log(self) -> StepLog:
        """A copy of everything collected."""
        return StepLog(
            distance=np.array(self._distance, np.float64),
            free=np.array(self._free, np.int32),
            speed_mps=np.array(self._speed, np.float64),
            dt_s=np.array(self._dt, np.float64),
            episode_steps=np.array(self._episode_steps, np.int32),
            episode_crashed=np.array(self._crashed, np.bool_),
        )

    def row(self) -> KpiRow:
        """The indicators of everything collected."""
        return summarise(self.log())


def _mean(values: F64 | I32 | Bool) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _ratio(above: float, below: float) -> float | None:
    return above / below if below > SMALLEST else None
