"""The paper's two key performance indicators and what must stand beside them, counted of one episode step by step.

KPI 1 is the mean joystick distance between user and agent, KPI 2 the number of steps an episode lives. A chair that
never moves wins KPI 2, and most steps are easy to follow in, so it is counted too how a policy follows where the user
moves and nothing is in the way, and whether it gets anywhere: routes, crossings, crashes, and what it holds up.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Set
from typing import Any, Final, NamedTuple

import numpy as np

from wcsim.config import RewardConfig
from wcsim.supervisor.rewards import DISTANCE_TOLERANCE, fault, hardest
from wcsim.types import F64, Bool

MAX_FOLLOW_DISTANCE = 0.1768  # Table 1, sqrt(0.125^2 + 0.125^2)
FOLLOWED = MAX_FOLLOW_DISTANCE + DISTANCE_TOLERANCE  # up to which a stick counts as followed
PUSHES = 0.3  # a stick that is out so far is meant
_BLOCKED_SHARE = 0.5  # who gives less than this share of the user's throttle blocks
STANDS_MPS = 0.05
FREEZE_S = 3.0
DROP = "drop"  # the crash reason of a fall off a kerb
_STOOD_S: Final = 1.0  # a chair that stands so long on a carriageway stands where it should not
_PATH_S: Final = 1.0  # a point of the path every so often
_STRETCHES: Final = frozenset({"warnings", "interventions", "overrules"})  # of ticks, counted where they begin


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

    def plus(self, happened: Set[str], distance: float | None, speed_mps: float, steps: int | None = None) -> KpiTotals:
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
        return self._replace(ended=self.ended + (self.steps > 0), ended_steps=self.ended_steps + self.steps, steps=0)


class KpiMeter:
    """Counts the steps that a policy drove in one episode; 49 bytes a step.

    Args:
        tick_s: Of a step.
        reward: What counts as a collision.
    """

    def __init__(self, tick_s: float, reward: RewardConfig) -> None:
        self._tick_s, self._reward = tick_s, reward
        self._numbers = array("d")  # distance, asked x and y, given x and y, speed of each step
        self._free = array("b")
        self._counts = {"goals": 0, "given_up": 0, "red_entries": 0, "crossings": 0, "helps": 0}
        self._standing = 0  # steps on a carriageway
        self._every = max(1, round(_PATH_S / tick_s))
        self._stood_s, self._in_red, self._crashed = 0.0, False, False
        self._path: list[tuple[float, float]] = []
        self._at = (0.0, 0.0)

    def add(self, info: Mapping[str, Any], free: bool) -> None:
        """One step, as an environment's `info` tells it; whether the moment that was answered was free of danger."""
        events, asked, given, speed_mps = info["events"], info["asked"], info["given"], float(info["speed_mps"])
        self._numbers.extend((float(info["joystick_distance"]), asked.x, asked.y, given.x, given.y, speed_mps))
        self._free.append(free)
        happened = (events.arrived, events.gave_up, events.entered_red, events.crossed, events.help_asked)
        for name, is_so in zip(self._counts, happened, strict=True):
            self._counts[name] += is_so
        standing = events.on_carriageway and abs(speed_mps) < STANDS_MPS
        self._standing += standing
        if not events.crashed:  # how a chair came into a crash is not told by what that did to it
            self._stood_s = self._stood_s + self._tick_s if standing else 0.0
            self._in_red = events.on_carriageway and (self._in_red or events.entered_red)
        self._crashed = events.crashed
        self._walk(info)

    def crash(self, info: Mapping[str, Any]) -> dict[str, Any]:
        """Reason, fault, partner and words of the crash that `info` tells of, under their names in a record.

        The other's fault is the chair's own where it had stood on a carriageway or had come onto it at red.
        """
        events, contacts = info["events"], info.get("contacts", ())
        whose = str(fault(events.crash_reason, contacts, self._reward))
        if whose == "other" and (self._stood_s >= _STOOD_S - 1e-9 or self._in_red):
            whose = "own"
        hit = hardest(events.crash_reason, contacts, self._reward)
        partner = "" if hit is None else hit.kind
        return {"reason": events.crash_reason, "fault": whose, "partner": partner, "crash": events.crash}

    def sums(self) -> dict[str, Any]:
        """The sums of all steps under their names in a record."""
        numbers = np.array(self._numbers, np.float64).reshape(-1, 6)
        distance, asked, given, speed_mps = numbers[:, 0], numbers[:, 1:3], numbers[:, 3:5], numbers[:, 5]
        free = np.array(self._free, np.bool_)
        within, moving = distance <= FOLLOWED, free & (_out(asked) > PUSHES)
        blocked = free & (asked[:, 1] > PUSHES) & (given[:, 1] < _BLOCKED_SHARE * asked[:, 1])
        driven = len(numbers) - self._crashed  # how smooth it was is not told by a crash
        accelerations = np.diff(speed_mps[:driven]) / self._tick_s
        return {
            "steps": len(numbers),
            "m": round(float(np.sum(np.abs(speed_mps) * self._tick_s)), 6),
            "distance_sum": round(float(distance.sum()), 9),
            "within": int(within.sum()),
            "free_steps": int(free.sum()),
            "free_sum": round(float(distance[free].sum()), 9),
            "blocked_steps": int(blocked.sum()),
            "moving_steps": int(moving.sum()),
            "moving_sum": round(float(distance[moving].sum()), 9),
            "moving_within": int((moving & within).sum()),
            "freezes": self._freezes(speed_mps, asked, given),
            "road_s": round(self._standing * self._tick_s, 6),
            "accel_sq_sum": round(float(np.sum(accelerations**2)), 6),
            "stick_travel": round(_travel(given), 6),
            "asked_travel": round(_travel(asked), 6),
            "path_m": tuple(self._path if len(numbers) % self._every == 0 else [*self._path, self._at]),
            **self._counts,
        }

    def _walk(self, info: Mapping[str, Any]) -> None:
        state = info.get("state")
        if state is None:
            return
        x_m, y_m = (round(float(value), 2) for value in state.p_WB_m[:2])
        self._at = (x_m, y_m)
        if len(self._free) % self._every == 0:
            self._path.append(self._at)

    def _freezes(self, speed_mps: F64, asked: F64, given: F64) -> int:
        """Stretches of FREEZE_S and more in which only the agent keeps the chair from going."""
        frozen: Bool = (np.abs(speed_mps) < STANDS_MPS) & (_out(asked) > PUSHES) & (_out(given) < PUSHES)
        edges = np.flatnonzero(np.diff(np.r_[False, frozen, False]))
        lasted_s = (edges[1::2] - edges[::2]) * self._tick_s
        # A hair less: so many ticks may be a little under the bound.
        return int(np.count_nonzero(lasted_s >= FREEZE_S - 1e-6))


def _out(sticks: F64) -> F64:
    """(N,) how far sticks (N, 2) are out."""
    return np.asarray(np.hypot(sticks[:, 0], sticks[:, 1]), np.float64)


def _travel(sticks: F64) -> float:
    """How far a stick's tip goes in all."""
    return float(np.sum(np.hypot(*np.diff(sticks, axis=0).T))) if len(sticks) > 1 else 0.0
