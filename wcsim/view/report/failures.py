"""The failures of a test, worst first: what happened, whose fault it was, and how to drive this moment again."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.suite.records import (
    CRASHED,
    FINISHED,
    GAVE_UP,
    ON_THE_WAY,
    POLICY_FAILED,
    REFUSED,
    TIMED_OUT,
    EpisodeRecord,
)
from wcsim.agents.evaluation.suite.result_files import KeptEpisode, KeptResult
from wcsim.agents.evaluation.suite.run import UNAIDED
from wcsim.core.reading import counted
from wcsim.types import ActorKind

WORST: Final = (
    "Worst first: own crashes with road users, own crashes with objects and falls, crashes by others, failed policies, "
    "red lights, routes given up or not completed in time, crashes before the policy took over. In each group the "
    "faster in the last second come first."
)
_SOMEBODY: Final = frozenset(kind.value for kind in ActorKind)
_FAULTS: Final = {"own": "own fault", "other": "other's fault"}
_SHORT_S: Final = 0.3  # a last leg of the path below this says nothing of the speed


@dataclass(frozen=True, slots=True, kw_only=True)
class FailedEpisode:
    """An episode that went wrong."""

    policy: str
    episode: KeptEpisode
    reason: str
    whose: str  # own, other, or that the policy did not drive yet
    severity: int  # 0 is worst
    speed_mps: float | None  # in the last second
    unaided: str  # what became of the user alone
    command: str

    @property
    def key(self) -> tuple[int, int]:
        """Block and seat."""
        return self.episode.record.block, self.episode.record.seat


def failures_of(result: KeptResult, folder: Path) -> tuple[FailedEpisode, ...]:
    """All failures of all policies, worst first."""
    alone = {(e.record.block, e.record.seat): e.record for e in result.episodes.get(UNAIDED, ())}
    found = []
    for policy, episodes in result.episodes.items():
        for episode in episodes:
            record = episode.record
            reason, whose, severity = judged(record)
            if not reason:
                continue
            twin = alone.get((record.block, record.seat))
            found.append(
                FailedEpisode(
                    policy=policy,
                    episode=episode,
                    reason=reason,
                    whose=whose,
                    severity=severity,
                    speed_mps=last_speed_mps(episode),
                    unaided="not driven" if twin is None else fate(twin),
                    command=_command_of(result, folder, policy, record),
                )
            )
    return tuple(sorted(found, key=lambda one: (one.severity, -(one.speed_mps or 0.0), one.policy, one.key)))


def judged(record: EpisodeRecord) -> tuple[str, str, int]:
    """Reason, whose fault and severity of an episode; no reason where it went well."""
    if record.status == CRASHED and not record.steps:
        return record.reason, "before the policy", 6
    if record.status == CRASHED:
        own = record.fault == "own"
        return record.reason, record.fault, (0 if record.partner in _SOMEBODY else 1) if own else 2
    if record.status in (POLICY_FAILED, REFUSED):
        return record.status.replace("_", " "), "policy", 3
    if record.red_entries:
        return "red light", "own", 4
    if record.status == GAVE_UP or (record.status == TIMED_OUT and record.part in ON_THE_WAY):
        return record.status.replace("_", " "), "", 5
    return "", "", 7


def fate(record: EpisodeRecord) -> str:
    """What became of an episode, in words."""
    if record.status == CRASHED:
        with_ = f" with {record.partner}" if record.partner else ""
        return f"{record.reason}{with_} ({_FAULTS.get(record.fault, record.fault)}) after {record.time_s:.0f} s"
    said = "no crash" if record.status == TIMED_OUT and record.part not in ON_THE_WAY else ""
    said = said or ("arrived" if record.status == FINISHED else record.status.replace("_", " "))
    return f"{said}, {counted(record.red_entries, 'red light')}" if record.red_entries else said


def last_speed_mps(episode: KeptEpisode) -> float | None:
    """Mean speed in about the last second; None where no path was recorded.

    A path has the place after each whole second, and the last one (`EpisodeMeter`): at 12.3 s 13 places.
    """
    path_m, time_s = episode.path_m, episode.record.time_s
    if path_m is None or len(path_m) < 2 or time_s <= 0.0:
        return None
    leg_s = time_s - (len(path_m) - 1)
    legs = 1 if leg_s >= _SHORT_S or len(path_m) == 2 else 2
    spent_s = leg_s + (legs - 1)
    way_m = sum(math.dist(path_m[-at], path_m[-at - 1]) for at in range(1, legs + 1))
    return way_m / spent_s if spent_s > 0.0 else None


def _command_of(result: KeptResult, folder: Path, policy: str, record: EpisodeRecord) -> str:
    """The command that drives an episode again, typed where the test was; see `where_typed`."""
    words = ["wcsim", "test", policy, "--suite", result.list_name, "--play", f"{record.block}.{record.seat}"]
    words += ["--out", result.out or folder.resolve().name]  # policies and lists have names from where they were typed
    words += ["--preset", result.preset] if result.preset != "quick" else []
    words += ["--network", result.network] if result.network else []
    words += [word for setting in result.changed for word in ("--set", setting)]
    return shlex.join(words)


def where_typed(result: KeptResult) -> str:
    """Where the commands of a page run, in words."""
    return "in which you ran the test" if result.out else "that contains the folder of the test"


def worst_of(failures: Sequence[FailedEpisode], policy: str) -> FailedEpisode | None:
    """A policy's worst moment."""
    return next((failure for failure in failures if failure.policy == policy), None)
