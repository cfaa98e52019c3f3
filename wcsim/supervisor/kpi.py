"""The paper's two key performance indicators and what must stand beside them, counted of one episode step by step.

KPI 1 is the mean joystick distance between user and agent, KPI 2 the number of steps an episode lives. A chair that
never moves wins KPI 2, and most steps are easy to follow in, so it is counted too how a policy follows where the user
moves and nothing is in the way, and whether it gets anywhere: routes, crossings, crashes, and what it holds up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from typing import Any, Final, NamedTuple

import numpy as np

from wcsim.config import RewardConfig
from wcsim.supervisor.rewards import DISTANCE_TOLERANCE, fault, hardest
from wcsim.types import F64, Bool, Contact, Events, Joystick

MAX_FOLLOW_DISTANCE = 0.1768  # Table 1, sqrt(0.125^2 + 0.125^2)
FOLLOWED = MAX_FOLLOW_DISTANCE + DISTANCE_TOLERANCE  # up to which a stick counts as followed
PUSHES = 0.3  # a stick that is out so far is meant
_BLOCKED_SHARE = 0.5  # who gives less than this share of the user's throttle blocks
STANDS_MPS = 0.05
FREEZE_S = 3.0
DROP = "drop"  # the crash reason of a fall off a kerb
_STOOD_S: Final = 1.0  # a chair that stands so long on a carriageway stands where it should not
_PATH_S: Final = 1.0  # a point of the path every so often
_STRETCHES: Final = frozenset(
    {"warnings", "interventions", "overrules"}
)  # of ticks, counted where they begin
_EVENTS: Final = {  # of a record, and what a step counts for
    "goals": "arrived",
    "given_up": "gave_up",
    "red_entries": "entered_red",
    "crossings": "crossed",
    "helps": "help_asked",
}


class KpiTotals(NamedTuple):
    """Running totals of one chair over its episodes, after each tick; a film keeps those of every tick."""

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
    steps: int = 0  # of the episode that is on, from a handover on; 0 once it has ended
    on: frozenset[str] = frozenset()  # the stretches that go on

    @property
    def kpi1(self) -> float | None:
        """Mean joystick distance, KPI 1; None where no tick is judged."""
        return self.distance_sum / self.judged if self.judged else None

    @property
    def kpi2(self) -> float:
        """Mean steps that an episode lived, KPI 2; of the one that is on while none has ended."""
        return self.ended_steps / self.ended if self.ended else float(self.steps)

    def begun(self, happened: Set[str]) -> Set[str]:
        """What of this begins with the next tick: a stretch does so once."""
        return happened - self.on

    def plus(
        self, happened: Set[str], distance: float | None, speed_mps: float, steps: int | None = None
    ) -> KpiTotals:
        """With one tick more.

        Args:
            happened: Names of the counters above that it counts for.
            distance: Of the joysticks; None where it is not judged.
            speed_mps: Of the chair.
            steps: Of the episode that is on, with this tick; None for one more than before.
        """
        counts: dict[str, Any] = {name: getattr(self, name) + 1 for name in self.begun(happened)}
        return self._replace(
            ticks=self.ticks + 1,
            judged=self.judged + (distance is not None),
            distance_sum=self.distance_sum + (distance or 0.0),
            speed_sum=self.speed_sum + abs(speed_mps),
            moving_ticks=self.moving_ticks + (abs(speed_mps) > STANDS_MPS),
            steps=self.steps + 1 if steps is None else steps,
            on=_STRETCHES & happened,
            **counts,
        )

    def over(self) -> KpiTotals:
        """After the episode's end, by a crash, its step limit, or because somebody began another."""
        return self._replace(
            ended=self.ended + (self.steps > 0), ended_steps=self.ended_steps + self.steps, steps=0
        )


class KpiStep(NamedTuple):
    """What the record of an episode is made of, of one step that a policy drove."""

    distance: float  # of the joysticks
    asked: Joystick
    given: Joystick
    speed_mps: float
    free: bool  # whether the moment that was answered was free of danger
    events: Events
    at_m: tuple[float, float] | None  # W; None where it is not told

    @classmethod
    def of(cls, info: Mapping[str, Any], free: bool) -> KpiStep:
        """One step, as an environment's `info` tells it."""
        state = info.get("state")
        at_m = (
            None
            if state is None
            else (round(float(state.p_WB_m[0]), 2), round(float(state.p_WB_m[1]), 2))
        )
        distance, speed_mps = float(info["joystick_distance"]), float(info["speed_mps"])
        return cls(distance, info["asked"], info["given"], speed_mps, free, info["events"], at_m)

    @property
    def stands_on_road(self) -> bool:
        """Whether the chair stands on a carriageway."""
        return self.events.on_carriageway and abs(self.speed_mps) < STANDS_MPS


def crash_of(
    events: Events,
    contacts: Sequence[Contact],
    steps: Sequence[KpiStep],
    tick_s: float,
    config: RewardConfig,
) -> dict[str, Any]:
    """Reason, fault, partner and words of a crash, which these steps led to, under their names in a record.

    The other's fault is the chair's own where it had stood on a carriageway or had come onto it at red.
    """
    whose = str(fault(events.crash_reason, contacts, config))
    stood_s, in_red = 0.0, False
    for step in steps:
        if step.events.crashed:  # how a chair came into a crash is not told by what that did to it
            break
        stood_s = stood_s + tick_s if step.stands_on_road else 0.0
        in_red = step.events.on_carriageway and (in_red or step.events.entered_red)
    if whose == "other" and (stood_s >= _STOOD_S - 1e-9 or in_red):
        whose = "own"
    hit = hardest(events.crash_reason, contacts, config)
    partner = "" if hit is None else hit.kind
    return {
        "reason": events.crash_reason,
        "fault": whose,
        "partner": partner,
        "crash": events.crash,
    }


def sums_of(steps: Sequence[KpiStep], tick_s: float) -> dict[str, Any]:
    """The sums of an episode's steps under their names in a record."""
    rows = [
        (each.distance, each.asked.x, each.asked.y, each.given.x, each.given.y, each.speed_mps)
        for each in steps
    ]
    numbers = np.array(rows, np.float64).reshape(-1, 6)
    distance, asked, given, speed_mps = (
        numbers[:, 0],
        numbers[:, 1:3],
        numbers[:, 3:5],
        numbers[:, 5],
    )
    free = np.array([each.free for each in steps], np.bool_)
    within, pushed = distance <= FOLLOWED, _out(asked) > PUSHES
    moving = free & pushed
    blocked = free & (asked[:, 1] > PUSHES) & (given[:, 1] < _BLOCKED_SHARE * asked[:, 1])
    driven = len(steps) - bool(
        steps and steps[-1].events.crashed
    )  # how smooth it was is not told by a crash
    accelerations = np.diff(speed_mps[:driven]) / tick_s
    return {
        "steps": len(steps),
        "m": round(float(np.sum(np.abs(speed_mps) * tick_s)), 6),
        "distance_sum": round(float(distance.sum()), 9),
        "within": int(within.sum()),
        "free_steps": int(free.sum()),
        "free_sum": round(float(distance[free].sum()), 9),
        "blocked_steps": int(blocked.sum()),
        "moving_steps": int(moving.sum()),
        "moving_sum": round(float(distance[moving].sum()), 9),
        "moving_within": int((moving & within).sum()),
        "stood_steps": int((~free & pushed & (np.abs(speed_mps) < STANDS_MPS)).sum()),
        "freezes": _freezes(speed_mps, asked, given, tick_s),
        "road_s": round(sum(each.stands_on_road for each in steps) * tick_s, 6),
        "accel_sq_sum": round(float(np.sum(accelerations**2)), 6),
        "stick_travel": round(_travel(given), 6),
        "asked_travel": round(_travel(asked), 6),
        "path_m": _path(steps, max(1, round(_PATH_S / tick_s))),
        **{
            name: sum(getattr(each.events, event) for each in steps)
            for name, event in _EVENTS.items()
        },
    }


def _path(steps: Sequence[KpiStep], every: int) -> tuple[tuple[float, float], ...]:
    """Where the chair was after every so many steps, and at the end."""
    kept = [*steps[every - 1 :: every], *steps[len(steps) - bool(len(steps) % every) :]]
    return tuple(each.at_m for each in kept if each.at_m is not None)


def _freezes(speed_mps: F64, asked: F64, given: F64, tick_s: float) -> int:
    """Stretches of FREEZE_S and more in which only the agent keeps the chair from going."""
    frozen: Bool = (
        (np.abs(speed_mps) < STANDS_MPS) & (_out(asked) > PUSHES) & (_out(given) < PUSHES)
    )
    edges = np.flatnonzero(np.diff(np.r_[False, frozen, False]))
    lasted_s = (edges[1::2] - edges[::2]) * tick_s
    # A hair less: so many ticks may be a little under the bound.
    return int(np.count_nonzero(lasted_s >= FREEZE_S - 1e-6))


def _out(sticks: F64) -> F64:
    """(N,) how far sticks (N, 2) are out."""
    return np.asarray(np.hypot(sticks[:, 0], sticks[:, 1]), np.float64)


def _travel(sticks: F64) -> float:
    """How far a stick's tip goes in all."""
    return float(np.sum(np.hypot(*np.diff(sticks, axis=0).T))) if len(sticks) > 1 else 0.0
