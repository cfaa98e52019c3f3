"""What grows in a long run: memory of every process and the run folder, as slopes with upper bounds.

A slope is fitted within the lives of processes, each with a level of its own, to means over blocks of time, which are
nearly independent of each other where single samples are not. Bounds are of one side, 95 %.
"""

from __future__ import annotations

import contextlib
import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import psutil  # type: ignore[import-untyped]

from wcsim.core.files import count_folder_bytes
from wcsim.server.launch.states import LaunchProcessStates

RUN_H: Final = 600.0
"""Hours of the long run that bounds are reckoned for."""
SAMPLE_S, WARM_S, BLOCKS = 1.0, 10.0, 12
WORLD, LAUNCHER = "world", "launcher"


@dataclass(frozen=True, slots=True, kw_only=True)
class Slope:
    """Growth an hour: the best estimate, and a bound that it is below with 95 %; infinite with too few samples."""

    per_h: float = 0.0
    upper_per_h: float = math.inf
    most: float = 0.0  # the largest value that was seen


@dataclass(frozen=True, slots=True, kw_only=True)
class LongRun:
    """Upper bounds for `RUN_H` hours."""

    memory_gb: float
    disk_gb: float
    recovery_s: float  # of a world that was killed


def t_quantile(freedom: int) -> float:
    """The 95 % quantile of Student's distribution; infinite without freedom.

    >>> [round(t_quantile(n), 2) for n in (3, 10, 100)], t_quantile(0)
    ([2.35, 1.81, 1.66], inf)
    """
    from scipy.stats import t

    return float(t.ppf(0.95, freedom)) if freedom >= 1 else math.inf


def fitted(lives: Sequence[Sequence[tuple[float, float]]], warm_s: float = WARM_S) -> Slope:
    """The slope of values over time that all lives share.

    Args:
        lives: Of each life (time in s, value).
        warm_s: The begin of each life that is left out.
    """
    times_h, values, freedom = [], [], -1
    most = max((value for life in lives for _, value in life), default=0.0)
    for life in lives:
        blocks = _blocks(life, warm_s)
        if len(blocks) < 2:
            continue
        at_h, of = np.array(blocks).T
        times_h.append((at_h - at_h.mean()) / 3600.0)
        values.append(of - of.mean())
        freedom += len(blocks) - 1
    if not times_h or freedom < 1:
        return Slope(most=most)
    x, y = np.concatenate(times_h), np.concatenate(values)
    spread = float(x @ x)
    per_h = float(x @ y) / spread
    error = math.sqrt(float(np.sum((y - per_h * x) ** 2)) / freedom / spread)
    return Slope(per_h=per_h, upper_per_h=per_h + t_quantile(freedom) * error, most=most)


def _blocks(life: Sequence[tuple[float, float]], warm_s: float) -> list[tuple[float, float]]:
    """Means over parts of a life."""
    if not life:
        return []
    warm = [(t, v) for t, v in life if t >= life[0][0] + warm_s]
    parts = np.array_split(np.array(warm).reshape(-1, 2), min(BLOCKS, max(1, len(warm))))
    return [(float(part[:, 0].mean()), float(part[:, 1].mean())) for part in parts if len(part)]


def predicted_s(values_s: Sequence[float]) -> float:
    """A bound for the next of these, 95 %."""
    if len(values_s) < 3:
        return math.inf
    values = np.array(values_s)
    return float(values.mean() + t_quantile(len(values) - 1) * values.std(ddof=1) * math.sqrt(1.0 + 1.0 / len(values)))


class _Samples:
    """Times (s) and values as plain doubles: what is measured with is part of the launcher, and is not to grow."""

    def __init__(self) -> None:
        self._times_s, self._values = array("d"), array("d")

    def add(self, time_s: float, value: float) -> None:
        """One more."""
        self._times_s.append(time_s)
        self._values.append(value)

    @property
    def pairs(self) -> list[tuple[float, float]]:
        """All of them, (time, value)."""
        return list(zip(self._times_s, self._values, strict=True))


class GrowthLog:
    """Samples of memory and disk, and which processes there were; `look` is called a few times a second."""

    def __init__(self, folder: Path, warm_s: float = WARM_S) -> None:
        self._folder, self._warm_s = folder, warm_s
        self._seen: set[tuple[int, float]] = set()  # (pid, time of birth)
        self._memory: dict[tuple[str, int], _Samples] = {}  # MB of each life
        self._disk = _Samples()  # MB
        self._looked_s = -math.inf

    def look(self, state: LaunchProcessStates, now_s: float, *, settled: bool = True) -> None:
        """Take samples when it is time to; until the run has settled, of who there is alone."""
        if now_s - self._looked_s < SAMPLE_S or state.stopping:
            return
        self._looked_s = now_s
        here = psutil.Process().pid
        pids = {LAUNCHER: here, WORLD: state.world_pid, **{client.name: client.pid for client in state.clients}}
        for who, pid in pids.items():
            with contextlib.suppress(psutil.Error):
                if pid:
                    self._sample(who, psutil.Process(pid), now_s, settled=settled, ours=pid != here)
        if settled:
            self._disk.add(now_s, count_folder_bytes(self._folder) / 1e6)

    def orphans(self) -> int:
        """Processes that were started and still run."""
        return sum(_lives(pid, born_s) for pid, born_s in self._seen)

    @property
    def memory(self) -> dict[str, Slope]:
        """MB of each kind of process, by its name."""
        by_name: dict[str, list[list[tuple[float, float]]]] = {}
        for (who, _), life in self._memory.items():
            by_name.setdefault(who, []).append(life.pairs)
        return {who: fitted(lives, self._warm_s) for who, lives in by_name.items()}

    @property
    def disk(self) -> Slope:
        """MB of the run folder."""
        return fitted([self._disk.pairs], self._warm_s)

    def _sample(self, who: str, process: psutil.Process, now_s: float, *, settled: bool, ours: bool) -> None:
        life = self._memory.setdefault((who, process.pid), _Samples())
        held_mb = process.memory_info().rss / 1e6
        if settled and held_mb:  # a process that died, and that nobody has waited for yet, holds nothing
            life.add(now_s, held_mb)
        if ours:
            self._seen.add((process.pid, process.create_time()))


class SettledPace:
    """How fast a settled run ticks: over all lives of its world, without the time in which there was none."""

    def __init__(self) -> None:
        self._ticks, self._spent_s = 0, 0.0
        self._last: tuple[int, int, float] | None = None  # process, its ticks, and when

    def look(self, state: LaunchProcessStates, now_s: float, *, settled: bool = True) -> None:
        """Take in how things are; what a world does before the run has settled, or while it ends, does not count."""
        world, before = state.world, self._last
        if state.stopping or not settled or world is None or not (state.world_pid and world.ticks):
            self._last = None
            return
        self._last = state.world_pid, world.ticks, now_s
        if before is not None and before[0] == state.world_pid:
            self._ticks += world.ticks - before[1]
            self._spent_s += now_s - before[2]

    @property
    def ticks_per_s(self) -> float:
        """The mean; 0 when it is not known."""
        return self._ticks / self._spent_s if self._spent_s > 0.0 else 0.0


def long_run(
    memory: Mapping[str, Slope], disk: Slope, epoch_h: float, recovery_s: float, client_growth_mb: float = math.inf
) -> LongRun:
    """Bounds for `RUN_H` hours.

    Args:
        memory: MB of each process; a world grows for an epoch, a client until it is replaced, the launcher for the
            whole run.
        disk: MB of the run folder.
        epoch_h: Hours that an epoch lasts.
        recovery_s: A bound for a world that dies.
        client_growth_mb: By how much a client has grown when it is replaced, at the begin of the next epoch.
    """
    hours = {who: min(epoch_h, RUN_H) if who == WORLD else RUN_H for who in memory}
    expected_mb, errors_mb = 0.0, []
    for who, slope in memory.items():
        grown_mb, error_mb = max(0.0, slope.per_h) * hours[who], (slope.upper_per_h - slope.per_h) * hours[who]
        replaced_mb = math.inf
        if who not in (WORLD, LAUNCHER):
            replaced_mb = client_growth_mb + max(0.0, slope.upper_per_h) * min(epoch_h, RUN_H)
        if grown_mb + error_mb > replaced_mb:
            grown_mb, error_mb = replaced_mb, 0.0
        expected_mb += slope.most + grown_mb
        errors_mb.append(error_mb)
    # Processes err apart from each other, so their errors are added as variances are.
    error_mb = math.hypot(*errors_mb)
    disk_mb = disk.most + max(0.0, disk.upper_per_h) * RUN_H
    return LongRun(memory_gb=(expected_mb + error_mb) / 1e3, disk_gb=disk_mb / 1e3, recovery_s=recovery_s)


def _lives(pid: int, born_s: float) -> bool:
    try:
        process = psutil.Process(pid)
        return bool(process.create_time() == born_s and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.Error:
        return False
