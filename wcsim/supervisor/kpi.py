"""The paper's two key performance indicators and what must stand beside them.

KPI 1 is the mean joystick distance between user and agent, KPI 2 the number of steps an episode lives. A chair that
never moves wins KPI 2, and most steps are easy to follow in, so a row says too how a policy follows where the user
moves and nothing is in the way, and whether it gets anywhere: routes, crossings, crashes, and what it holds up. A
number that nothing was measured for is None, never NaN.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from wcsim.errors import ConfigError
from wcsim.supervisor.rewards import DISTANCE_TOLERANCE
from wcsim.types import F64, I32, Bool, Events, Joystick

MAX_FOLLOW_DISTANCE = 0.1768  # Table 1, sqrt(0.125^2 + 0.125^2)
FOLLOWED = MAX_FOLLOW_DISTANCE + DISTANCE_TOLERANCE  # up to which a stick counts as followed
_SMALLEST = 1e-9  # kilometres or seconds below this are none at all
PUSHES = 0.3  # a stick that is out so far is meant
_BLOCKED_SHARE = 0.5  # who gives less than this share of the user's throttle blocks
STANDS_MPS = 0.05
FREEZE_S = 3.0
DROP = "drop"  # the crash reason of a fall off a kerb


@dataclass(frozen=True, slots=True, kw_only=True)
class KpiStep:
    """One step of a test: what was asked, what was answered, what came of it."""

    distance: float
    free: bool | None  # of danger when the agent answered; None when nobody asked for the truth
    asked: Joystick  # by the user
    given: Joystick  # by the agent as an answer
    speed_mps: float
    dt_s: float
    events: Events


@dataclass(frozen=True, slots=True, kw_only=True)
class StepLog:
    """Every step of a test in order, and how its episodes ended.

    Steps after the last entry of `episode_steps` belong to an episode that still runs: they count, except for KPI 2.
    """

    distance: F64  # (N,) joystick distance
    free: I32  # (N,) 1 free, 0 danger, -1 not known
    asked: F64  # (N, 2) the user's stick
    given: F64  # (N, 2) the agent's
    speed_mps: F64  # (N,) forwards, or over the ground without a sign, as environments tell it
    dt_s: F64  # (N,)
    on_carriageway: Bool  # (N,)
    crossed: Bool  # (N,)
    entered_red: Bool  # (N,)
    arrived: Bool  # (N,)
    gave_up: Bool  # (N,)
    episode_steps: I32  # (E,)
    crash_reasons: tuple[str, ...]  # (E,) "" for an episode without a crash


@dataclass(frozen=True, slots=True, kw_only=True)
class KpiRow:
    """One row of a result table; None where nothing was measured."""

    steps: int
    episodes: int
    crashes: int
    crash_reasons: Mapping[str, int]  # how many of each; drops among them
    km: float
    hours: float
    distance_mean: float | None  # KPI 1
    distance_p95: float | None
    share_within: float | None  # share of steps with a distance <= 0.1768
    distance_free_mean: float | None  # KPI 1 over the steps without danger
    distance_danger_mean: float | None
    distance_moving_mean: float | None  # KPI 1 over the steps without danger in which the user's stick is out
    moving_within: float | None  # share of those with a distance <= 0.1768
    free_share: float | None  # of the steps for which it is known
    blocked_share: float | None  # of the free steps: the user pushes forward and gets less than half of it
    freezes: int  # stretches of 3 s and more in which the chair stands, the user pushes and the agent does not
    steps_alive_mean: float | None  # KPI 2
    steps_alive_median: float | None
    speed_mean_mps: float | None
    crashes_per_km: float | None
    crashes_per_1000_steps: float | None
    routes_completed: int
    routes_given_up: int
    crossings: int  # completed: in from one pavement, out on the opposite one
    crossings_per_km: float | None
    standing_on_carriageway_s: float
    red_entries: int


def joined(logs: Sequence[StepLog]) -> StepLog:
    """The steps and episodes of several logs, one after the other."""
    arrays = {
        field.name: np.concatenate([getattr(log, field.name) for log in logs])
        for field in fields(StepLog)
        if field.name != "crash_reasons"
    }
    return StepLog(**arrays, crash_reasons=tuple(reason for log in logs for reason in log.crash_reasons))


def summarise(log: StepLog) -> KpiRow:
    """All indicators of a test. Raises ConfigError when the step arrays differ in length."""
    _check_lengths(log)
    steps, reasons = len(log.distance), Counter(reason for reason in log.crash_reasons if reason)
    # Backwards is driven, too.
    km = float(np.sum(np.abs(log.speed_mps) * log.dt_s)) / 1000.0
    total_s = float(np.sum(log.dt_s))
    known, free = log.free >= 0, log.free == 1
    within = log.distance <= FOLLOWED
    moving = free & (_out(log.asked) > PUSHES)
    standing = log.on_carriageway & (np.abs(log.speed_mps) < STANDS_MPS)
    crashes, crossings = reasons.total(), int(np.count_nonzero(log.crossed))
    return KpiRow(
        steps=steps,
        episodes=len(log.episode_steps),
        crashes=crashes,
        crash_reasons=dict(sorted(reasons.items())),
        km=km,
        hours=total_s / 3600.0,
        distance_mean=_mean(log.distance),
        distance_p95=float(np.quantile(log.distance, 0.95)) if steps else None,
        share_within=_mean(within),
        distance_free_mean=_mean(log.distance[free]),
        distance_danger_mean=_mean(log.distance[log.free == 0]),
        distance_moving_mean=_mean(log.distance[moving]),
        moving_within=_mean(within[moving]),
        free_share=_mean(free[known]),
        blocked_share=_mean(_blocked(log)[free]),
        freezes=_freezes(log),
        steps_alive_mean=_mean(log.episode_steps),
        steps_alive_median=float(np.median(log.episode_steps)) if len(log.episode_steps) else None,
        speed_mean_mps=_ratio(float(np.sum(log.speed_mps * log.dt_s)), total_s),
        crashes_per_km=_ratio(crashes, km),
        crashes_per_1000_steps=_ratio(1000.0 * crashes, steps),
        routes_completed=int(np.count_nonzero(log.arrived)),
        routes_given_up=int(np.count_nonzero(log.gave_up)),
        crossings=crossings,
        crossings_per_km=_ratio(crossings, km),
        standing_on_carriageway_s=float(np.sum(log.dt_s[standing])),
        red_entries=int(np.count_nonzero(log.entered_red)),
    )


class KpiMeter:
    """Collects steps one by one; 62 bytes a step."""

    def __init__(self) -> None:
        self._numbers = array("d")  # distance, asked x and y, given x and y, speed, duration of each step
        self._free, self._events = array("b"), array("b")
        self._episode_steps = array("i")
        self._reasons: list[str] = []

    def add(self, step: KpiStep) -> None:
        """One step."""
        asked, given = step.asked, step.given
        self._numbers.extend((step.distance, asked.x, asked.y, given.x, given.y, step.speed_mps, step.dt_s))
        self._free.append(-1 if step.free is None else int(step.free))
        e = step.events
        self._events.extend((e.on_carriageway, e.crossed, e.entered_red, e.arrived, e.gave_up))

    def end_episode(self, steps: int, crash_reason: str = "") -> None:
        """An episode ended after `steps` steps, with a crash if there is a reason."""
        self._episode_steps.append(steps)
        self._reasons.append(crash_reason)

    def log(self) -> StepLog:
        """A copy of everything collected."""
        numbers = np.array(self._numbers, np.float64).reshape(-1, 7)
        events = np.array(self._events, np.bool_).reshape(-1, 5)
        return StepLog(
            distance=numbers[:, 0],
            free=np.array(self._free, np.int32),
            asked=numbers[:, 1:3],
            given=numbers[:, 3:5],
            speed_mps=numbers[:, 5],
            dt_s=numbers[:, 6],
            on_carriageway=events[:, 0],
            crossed=events[:, 1],
            entered_red=events[:, 2],
            arrived=events[:, 3],
            gave_up=events[:, 4],
            episode_steps=np.array(self._episode_steps, np.int32),
            crash_reasons=tuple(self._reasons),
        )

    def row(self) -> KpiRow:
        """The indicators of everything collected."""
        return summarise(self.log())


def _check_lengths(log: StepLog) -> None:
    steps = (
        *(log.distance, log.free, log.asked, log.given, log.speed_mps, log.dt_s),
        *(log.on_carriageway, log.crossed, log.entered_red, log.arrived, log.gave_up),
    )
    lengths = {len(values) for values in steps}
    if len(lengths) != 1 or len(log.episode_steps) != len(log.crash_reasons):
        raise ConfigError(f"step arrays have lengths {sorted(lengths)}; expected one value per step in each")


def _blocked(log: StepLog) -> Bool:
    """(N,) where the user pushes forward and the agent gives less than half of it."""
    blocked: Bool = (log.asked[:, 1] > PUSHES) & (log.given[:, 1] < _BLOCKED_SHARE * log.asked[:, 1])
    return blocked


def _freezes(log: StepLog) -> int:
    """Stretches of FREEZE_S and more, each within one episode, in which only the agent keeps the chair from going."""
    frozen = (np.abs(log.speed_mps) < STANDS_MPS) & (_out(log.asked) > PUSHES) & (_out(log.given) < PUSHES)
    if not frozen.any():
        return 0
    # To the right: a step behind the last end belongs to the episode that still runs.
    episode = np.searchsorted(np.cumsum(log.episode_steps), np.arange(len(frozen)), side="right")
    # A stretch ends with its episode: what follows is another street.
    starts = np.flatnonzero(np.r_[True, (np.diff(frozen) != 0) | (np.diff(episode) != 0)])
    lasted_s = np.add.reduceat(log.dt_s, starts)
    # A hair less: the durations of ticks may add up to a little under the bound.
    return int(np.count_nonzero(frozen[starts] & (lasted_s >= FREEZE_S - 1e-6)))


def _out(sticks: F64) -> F64:
    """(N,) how far sticks (N, 2) are out."""
    return np.asarray(np.hypot(sticks[:, 0], sticks[:, 1]), np.float64)


def _mean(values: F64 | I32 | Bool) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _ratio(above: float, below: float) -> float | None:
    return above / below if below > _SMALLEST else None
