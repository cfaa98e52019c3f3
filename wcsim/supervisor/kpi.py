"""The paper's two key performance indicators, and what must stand beside them.

KPI 1 is the mean joystick distance between user and agent, KPI 2 the number of steps an episode
lives. A chair that never moves wins KPI 2. So this counts, too, whether it gets anywhere: routes,
crossings, crashes, and what it holds up.
"""

from collections.abc import Mapping, Sequence, Set
from typing import Any, Final, NamedTuple, Self

import numpy as np

from wcsim.config import RewardConfig
from wcsim.supervisor.rewards import DISTANCE_TOLERANCE, find_hardest_contact, judge_crash_fault
from wcsim.types import F64, Bool, Contact, Events, Joystick

MAX_FOLLOW_DISTANCE: Final = 0.1768  # Table 1, sqrt(0.125^2 + 0.125^2)
FOLLOWED: Final = MAX_FOLLOW_DISTANCE + DISTANCE_TOLERANCE  # up to here a stick counts as followed
DROP: Final = "drop"  # the crash reason of a fall off a kerb
_PUSHES: Final = 0.3  # a stick that is out so far is meant
_STANDS_MPS: Final = 0.05
_FREEZE_S: Final = 3.0
_ON_ROAD_S: Final = 1.0  # a chair that stands so long on a carriageway stands where it should not
_PATH_S: Final = 1.0  # from one point of a path to the next
# Stretches of ticks, counted where they begin.
_STRETCHES: Final = frozenset({"warnings", "interventions", "overrules"})
# Counts of a record, and the event of a step that each counts.
_EVENTS: Final = {
    "goals": "arrived",
    "given_up": "gave_up",
    "red_entries": "entered_red",
    "crossings": "crossed",
    "helps": "help_asked",
}


class KpiTotals(NamedTuple):
    """Running totals of one chair over its episodes, after each tick; a film has those of all."""

    ticks: int = 0
    judged: int = 0  # ticks of which both sticks are known
    distance_sum: float = 0.0  # of joystick distances
    speed_sum: float = 0.0  # of ticks, in m/s
    moving_ticks: int = 0
    crashes: int = 0
    drops: int = 0
    arrivals: int = 0
    given_up: int = 0
    helps: int = 0
    warnings: int = 0  # stretches of ticks, as interventions and overrules
    interventions: int = 0
    overrules: int = 0
    ended: int = 0  # episodes
    ended_steps: int = 0  # of them
    steps: int = 0  # of the running episode, from a handover on; 0 once it has ended
    on: frozenset[str] = frozenset()  # the running stretches

    @property
    def kpi1(self) -> float | None:
        """Mean joystick distance, KPI 1; None where no tick is judged."""
        return self.distance_sum / self.judged if self.judged else None

    @property
    def kpi2(self) -> float:
        """Mean steps that an episode lived, KPI 2; those of the first while none has ended."""
        return self.ended_steps / self.ended if self.ended else float(self.steps)

    def starting(self, happened: Set[str]) -> Set[str]:
        """What of this starts with the next tick: a stretch does so once."""
        return happened - self.on

    def plus(
        self, happened: Set[str], distance: float | None, speed_mps: float, steps: int | None = None
    ) -> Self:
        """With one tick more.

        Args:
            happened: Names of the counters above that it counts for.
            distance: Of the joysticks; None where it is not judged.
            speed_mps: Of the chair.
            steps: Of the running episode, with this tick; None for one more than before.
        """
        counts: dict[str, Any] = {name: getattr(self, name) + 1 for name in self.starting(happened)}
        return self._replace(
            ticks=self.ticks + 1,
            judged=self.judged + (distance is not None),
            distance_sum=self.distance_sum + (distance or 0.0),
            speed_sum=self.speed_sum + abs(speed_mps),
            moving_ticks=self.moving_ticks + (abs(speed_mps) > _STANDS_MPS),
            steps=self.steps + 1 if steps is None else steps,
            on=_STRETCHES & happened,
            **counts,
        )

    def after_episode(self) -> Self:
        """After the episode's end, by a crash, its step limit, or the start of another one."""
        return self._replace(
            ended=self.ended + (self.steps > 0), ended_steps=self.ended_steps + self.steps, steps=0
        )


class KpiStep(NamedTuple):
    """One step that a policy drove, as far as the record of its episode depends on it."""

    distance: float  # of the joysticks
    user: Joystick
    given: Joystick  # what the chair was given
    speed_mps: float
    events: Events
    at_m: tuple[float, float] | None  # W; None where it is not known

    @classmethod
    def of(cls, info: Mapping[str, Any]) -> Self:
        """One step, from an environment's `info`."""
        objects = info["objects"]
        state, at_m = objects.state, None
        if state is not None:
            at_m = round(float(state.p_WB_m[0]), 2), round(float(state.p_WB_m[1]), 2)
        return cls(
            distance=float(info["joystick_distance"]),
            user=objects.asked,
            given=objects.given,
            speed_mps=float(info["speed_mps"]),
            events=objects.events,
            at_m=at_m,
        )

    @property
    def stands_on_road(self) -> bool:
        """Whether the chair stands on a carriageway."""
        return self.events.on_carriageway and abs(self.speed_mps) < _STANDS_MPS


def make_crash_fields(
    events: Events,
    contacts: Sequence[Contact],
    steps: Sequence[KpiStep],
    tick_s: float,
    config: RewardConfig,
) -> dict[str, Any]:
    """Reason, fault, partner and words of a crash after these steps, by their names in a record.

    The other's fault is the chair's own where it had stood on a carriageway, or entered it at red.
    """
    at_fault = str(judge_crash_fault(events.crash_reason, contacts, config))
    still_s, in_red = 0.0, False
    for step in steps:
        # What a crash did to a chair says nothing of how it came into the crash.
        if step.events.crashed:
            break
        still_s = still_s + tick_s if step.stands_on_road else 0.0
        in_red = step.events.on_carriageway and (in_red or step.events.entered_red)
    if at_fault == "other" and (still_s >= _ON_ROAD_S - 1e-9 or in_red):
        at_fault = "own"
    hit = find_hardest_contact(events.crash_reason, contacts, config)
    return {
        "reason": events.crash_reason,
        "fault": at_fault,
        "partner": "" if hit is None else hit.kind,
        "crash": events.crash,
    }


def sum_kpi_steps(steps: Sequence[KpiStep], tick_s: float) -> dict[str, Any]:
    """The sums of an episode's steps, by their names in a record.

    NumPy sums pairwise, `KpiTotals` tick by tick: their last digits differ, and saved results
    depend on both.
    """
    rows = [
        (each.distance, each.user.x, each.user.y, each.given.x, each.given.y, each.speed_mps)
        for each in steps
    ]
    numbers = np.array(rows, np.float64).reshape(-1, 6)
    distance = numbers[:, 0]
    user = numbers[:, 1:3]
    given = numbers[:, 3:5]
    speed_mps = numbers[:, 5]
    within = distance <= FOLLOWED
    pushed = np.hypot(*user.T) > _PUSHES
    stands = np.abs(speed_mps) < _STANDS_MPS
    frozen = stands & pushed & (np.hypot(*given.T) < _PUSHES)
    # A crash says nothing of how smooth the drive was.
    smooth = len(steps) - bool(steps and steps[-1].events.crashed)
    accelerations = np.diff(speed_mps[:smooth]) / tick_s
    # The path has a place after every so many steps, and the last one.
    every = max(1, round(_PATH_S / tick_s))
    shown = [*steps[every - 1 :: every], *steps[len(steps) - bool(len(steps) % every) :]]
    return {
        "steps": len(steps),
        "m": round(float(np.sum(np.abs(speed_mps) * tick_s)), 6),
        "distance_sum": round(float(distance.sum()), 9),
        "within": int(within.sum()),
        "freezes": _long_stretches(frozen, tick_s),
        "road_s": round(sum(each.stands_on_road for each in steps) * tick_s, 6),
        "accel_sq_sum": round(float(np.sum(accelerations**2)), 6),
        "stick_travel": round(_travel(given), 6),
        "asked_travel": round(_travel(user), 6),
        "path_m": tuple(each.at_m for each in shown if each.at_m is not None),
        **{
            name: sum(getattr(each.events, event) for each in steps)
            for name, event in _EVENTS.items()
        },
    }


def _long_stretches(frozen: Bool, tick_s: float) -> int:
    """Stretches of _FREEZE_S and more of ticks (N,) in which only the agent stops the chair."""
    edges = np.flatnonzero(np.diff(np.r_[False, frozen, False]))
    lasted_s = (edges[1::2] - edges[::2]) * tick_s
    # A hair less: so many ticks may be a little under the bound.
    return int(np.count_nonzero(lasted_s >= _FREEZE_S - 1e-6))


def _travel(sticks: F64) -> float:
    """The length of the way of a stick's tip."""
    return float(np.sum(np.hypot(*np.diff(sticks, axis=0).T))) if len(sticks) > 1 else 0.0
