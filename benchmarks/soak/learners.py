"""Learners in one street whose processes are killed and stopped: `python -m benchmarks soak --networks A,B,...`."""

from __future__ import annotations

import json
import math
import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.soak.faults import WORLD
from benchmarks.soak.growth import GrowthLog, LongRun, SettledPace, Slope, long_run, predicted_s
from benchmarks.soak.planned import FaultOrder, PlannedFaults, Recovered
from wcsim.agents.clients.group_run import ResolvedClient, ResolvedGroupRun
from wcsim.agents.clients.paid_times import GroupRunTimes, read_group_run_times
from wcsim.agents.runs.checkpoint import KEEP
from wcsim.config import LearnConfig
from wcsim.errors import InterruptedRunError
from wcsim.server.launch.states import ClientProcessState, LaunchProcessStates

SETTINGS = ("learn.replay_frames=1000", "learn.checkpoint_every=100", "learn.updates=while_waiting")
"""Laid over the preset: a replay that is full soon, so that what grows afterwards is no replay; and checkpoints that
come more often than kills, as a learner that never gets beyond its last one learns nothing.
"""
WARM_S = 60.0  # of a process that loads PyTorch, and fills its replay
ENDLESS = 10_000_000  # steps, of a soak that ends by the clock


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnersOrder:
    """What to soak."""

    folder: Path  # where the run goes, which must not exist
    faults: FaultOrder
    steps: int | None = None  # of each; None: until `seconds` are over
    seconds: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnersFacts:
    """What a soak of learners showed."""

    code: int
    ticks: int
    journal_hash: str
    missing: int
    duplicated: int
    kills: int
    stops: int
    alone: int  # faults that nobody else could feel
    recovered: tuple[Recovered, ...]
    orphans: int
    leaked: int  # folders of shared memory
    memory: dict[str, Slope]  # MB, by process
    disk: Slope  # MB
    bounds: LongRun
    paid: GroupRunTimes | None

    def recovery_s(self, of_world: bool) -> list[float]:
        """How long faults were felt, of the world or of clients."""
        return [each.after_s for each in self.recovered if (each.fault.who == WORLD) == of_world]

    @property
    def slow_factor(self) -> float:
        """How many times as long as the median client the slowest one acts and learns; 0 when it is not known."""
        own_s = [s.acting_s + s.learning_s for s in ({} if self.paid is None else self.paid.clients).values()]
        return max(own_s) / statistics.median(own_s) if own_s and min(own_s) > 0.0 else 0.0


class _Watch:
    """Faults, samples and the end, while learners run."""

    def __init__(self, order: LearnersOrder, settled_step: int, progress: Callable[[float], object]) -> None:
        self._order, self._settled_step, self._tell = order, settled_step, progress
        self._settled = False
        self.faults = PlannedFaults(order.faults, self._progress)
        self.growth = GrowthLog(order.folder, WARM_S)
        self.pace = SettledPace()
        self._begun_s: float | None = None  # of the first tick
        self.over = False  # by the clock

    def look(self, state: LaunchProcessStates) -> bool:
        """Called a few times a second; True when it is time to stop."""
        now_s = time.monotonic()
        if self._begun_s is None and state.world is not None and state.world.ticks > 0:
            self._begun_s = now_s
        self._tell(self._progress(state))
        self._settled = self._settled or all(_step(client) >= self._settled_step for client in state.clients)
        self.growth.look(state, now_s, settled=self._settled)
        self.pace.look(state, now_s, settled=self._settled)
        self.faults.act(state)  # after the samples: who is dead holds nothing
        self.over = self.over or (self._order.steps is None and self._progress(state) >= 1.0)
        return self.over

    def _progress(self, state: LaunchProcessStates) -> float:
        """How much of the run is over, 0..1; faults come in the part before the calm end."""
        if self._order.steps is not None:
            return max((c.status.step for c in state.clients if c.status is not None), default=0) / self._order.steps
        spent_s = 0.0 if self._begun_s is None else time.monotonic() - self._begun_s
        return spent_s / self._order.seconds


def soak_learners(
    order: LearnersOrder,
    run: ResolvedGroupRun,
    told: Path,
    train: Callable[[Callable[[LaunchProcessStates], bool]], int],
    progress: Callable[[float], object] = lambda share: None,
) -> LearnersFacts:
    """Run it.

    Args:
        order: What to soak.
        run: The learners.
        told: Where `train` leaves its result, a JSON file.
        train: Trains them; tells what it is given how things are, and stops when that says True. Returns the exit code.
        progress: Hears of the share that is over.

    Raises:
        WcsimError: The networks, the town or the settings cannot be used.
        InterruptedRunError: It was stopped, and not by its clock.
    """
    watch = _Watch(order, max(settled_step(client.config.learn) for client in run.clients), progress)
    try:
        code = train(watch.look)
    except InterruptedRunError:
        if not watch.over:  # by a signal
            raise
        code = 0
    finally:
        watch.faults.wake_all()
    report = json.loads(told.read_text(encoding="utf-8"))
    done = watch.faults.faults
    memory, disk = watch.growth.memory, watch.growth.disk
    return LearnersFacts(
        code=code,
        ticks=report["ticks"],
        journal_hash=report["journal_hash"],
        missing=sum(client["missing"] for client in report["clients"]),
        duplicated=sum(client["duplicated"] for client in report["clients"]),
        kills=sum(fault.what == "kill" for fault in done),
        stops=sum(fault.what == "stop" for fault in done),
        alone=sum(not fault.others for fault in done),
        recovered=tuple(watch.faults.recovered),
        orphans=watch.growth.orphans(),
        leaked=len(list(Path("/dev/shm").glob(f"wcsim-*-{os.getpid()}-*"))),  # noqa: S108 - where sockets lie
        memory=memory,
        disk=disk,
        bounds=long_run(
            memory,
            disk,
            _epoch_h(run, watch),
            _recovery_s(watch.faults.recovered),
            max(client.config.learn.process_growth_mb for client in run.clients),
        ),
        paid=read_group_run_times(order.folder),
    )


def settled_step(learn: LearnConfig) -> int:
    """From which step on neither a learner's memory nor its checkpoints, which hold its replay, should still grow."""
    return learn.replay_frames + KEEP * learn.checkpoint_every


def _step(client: ClientProcessState) -> int:
    return 0 if client.status is None else client.status.step


def slowed(client: ResolvedClient, times: int) -> ResolvedClient:
    """The same client with batches so many times as large."""
    learn = client.config.learn
    learn = learn.model_copy(update={"batch_size": times * learn.batch_size})
    return replace(client, config=client.config.model_copy(update={"learn": learn}))


def _epoch_h(run: ResolvedGroupRun, watch: _Watch) -> float:
    """Hours that an epoch lasts at the pace of this soak."""
    ticks = run.clients[0].config.epoch_ticks or math.inf
    return ticks / max(watch.pace.ticks_per_s, 1e-3) / 3600.0


def _recovery_s(recovered: Sequence[Recovered]) -> float:
    """A bound for the recovery of a world that dies."""
    return predicted_s([one.after_s for one in recovered if one.fault.who == WORLD and one.fault.what == "kill"])


def p99(values_s: Sequence[float]) -> float | None:
    """What 99 % of these are below; None for none."""
    return float(np.percentile(values_s, 99)) if values_s else None
