"""What is counted of one test episode, step by step: of a suite's episodes as of an environment's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from wcsim.agents.evaluation.suite.records import CRASHED
from wcsim.config import RewardConfig
from wcsim.supervisor.kpi import FOLLOWED, PUSHES, STANDS_MPS, KpiMeter, KpiStep, StepLog, summarise
from wcsim.supervisor.rewards import fault, hardest

_STOOD_S: Final = 1.0  # a chair that stands so long on a carriageway stands where it should not
_PATH_S: Final = 1.0  # a point of the path every so often


class EpisodeMeter:
    """Counts the steps that a policy drove.

    Args:
        tick_s: Of a step.
        reward: What counts as a collision.
    """

    def __init__(self, tick_s: float, reward: RewardConfig) -> None:
        self._tick_s, self._reward, self._meter = tick_s, reward, KpiMeter()
        self._every = max(1, round(_PATH_S / tick_s))
        self._stood_s, self._in_red = 0.0, False
        self._path: list[tuple[float, float]] = []
        self._at, self.steps, self._helps = (0.0, 0.0), 0, 0

    def add(self, info: Mapping[str, Any], free: bool | None) -> None:
        """One step, as an environment's `info` tells it; whether the moment that was answered was free of danger."""
        events, tick_s = info["events"], self._tick_s
        self._meter.add(
            KpiStep(
                distance=float(info["joystick_distance"]),
                free=free,
                asked=info["asked"],
                given=info["given"],
                speed_mps=float(info["speed_mps"]),
                dt_s=tick_s,
                events=events,
            )
        )
        self._helps += events.help_asked
        if not events.crashed:  # how a chair came into a crash is not told by what that did to it
            standing = events.on_carriageway and abs(info["speed_mps"]) < STANDS_MPS
            self._stood_s = self._stood_s + tick_s if standing else 0.0
            self._in_red = events.on_carriageway and (self._in_red or events.entered_red)
        self._walk(info)

    def crash(self, info: Mapping[str, Any]) -> dict[str, Any]:
        """Status, reason, fault, partner and words of the crash that `info` tells of, under their names in a record.

        The other's fault is the chair's own where it had stood on a carriageway or had come onto it at red.
        """
        events, contacts = info["events"], info.get("contacts", ())
        whose = str(fault(events.crash_reason, contacts, self._reward))
        if whose == "other" and (self._stood_s >= _STOOD_S - 1e-9 or self._in_red):
            whose = "own"
        hit = hardest(contacts, self._reward) if events.crash_reason == "collision" else None
        partner = "" if hit is None else hit.kind
        found = {"status": CRASHED, "reason": events.crash_reason, "fault": whose, "partner": partner}
        return {**found, "crash": events.crash}

    def sums(self, crash_reason: str = "") -> dict[str, Any]:
        """The sums of all steps under their names in a record; the episode is over then."""
        self._meter.end_episode(self.steps, crash_reason)
        path = self._path if self.steps % self._every == 0 or not self.steps else [*self._path, self._at]
        return {**_sums_of(self._meter.log()), "path_m": tuple(path), "helps": self._helps}

    def log(self) -> StepLog:
        """Every step, for indicators over several episodes."""
        return self._meter.log()

    def _walk(self, info: Mapping[str, Any]) -> None:
        self.steps += 1
        state = info.get("state")
        if state is None:
            return
        x_m, y_m = (round(float(value), 2) for value in state.p_WB_m[:2])
        self._at = (x_m, y_m)
        if self.steps % self._every == 0:
            self._path.append(self._at)


def _sums_of(log: StepLog) -> dict[str, Any]:
    """The sums of one episode's steps, under their names in `EpisodeRecord`."""
    row = summarise(log)
    free = log.free == 1
    moving = free & (np.hypot(log.asked[:, 0], log.asked[:, 1]) > PUSHES)
    driven = len(log.speed_mps) - any(log.crash_reasons)  # how smooth it was is not told by a crash
    accelerations = np.diff(log.speed_mps[:driven]) / log.dt_s[1:driven]
    return {
        "steps": len(log.distance),
        "m": round(1000.0 * row.km, 6),
        "distance_sum": round(float(log.distance.sum()), 9),
        "free_steps": int(free.sum()),
        "blocked_steps": round((row.blocked_share or 0.0) * int(free.sum())),
        "moving_steps": int(moving.sum()),
        "moving_within": int((moving & (log.distance <= FOLLOWED)).sum()),
        "freezes": row.freezes,
        "road_s": round(row.standing_on_carriageway_s, 6),
        "red_entries": row.red_entries,
        "crossings": row.crossings,
        "accel_sq_sum": round(float(np.sum(accelerations**2)), 6),
        "stick_travel": round(_travel(log.given), 6),
        "asked_travel": round(_travel(log.asked), 6),
    }


def _travel(sticks: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    """How far a stick's tip goes in all."""
    return float(np.sum(np.hypot(*np.diff(sticks, axis=0).T))) if len(sticks) > 1 else 0.0
