"""Callbacks of Stable-Baselines3 that a training logs with, its progress, and a request to stop it.

Does a learner promise too much? Values at the starts of episodes are compared with the returns that
followed. The maximum over noisy values is too high on average, which is why DQN overestimates and
Double DQN was made (van Hasselt, Guez, Silver 2016). Both numbers are in units of the scaled
reward, as the network's values are.
"""

import signal
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from types import FrameType
from typing import Any, Final

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from wcsim.agents.envs.episode_view import OBJECTS, WORLD_RESTARTED, Info
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.policy_api import JOYSTICK_KEY
from wcsim.agents.runs.metrics import (
    KPI1_STEPS,
    ROW_STEPS,
    MetricsFile,
    TensorBoardLog,
    Value,
    read_metrics,
)
from wcsim.core.processes import SignalContextBase
from wcsim.server.launch.states import WAIT_NO_MORE
from wcsim.supervisor.kpi import KpiTotals
from wcsim.types import Events

GREEDY_EVERY: Final = 5  # steps between two readings of the agent's own choice
# The return of an episode that was cut short counts as known up to this share of what may follow.
_TAIL: Final = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainProgress:
    """Progress of a run."""

    step: int
    total_steps: int
    phase: int
    episodes: int
    crashes: int
    kpi1: float | None  # of the agent's own choice, mean of the last `KPI1_STEPS` steps


class SeqDqnCallback(BaseCallback):
    """A callback of a SeqDQN."""

    @property
    def learner(self) -> SeqDQN:
        """The model, by its own type."""
        if not isinstance(self.model, SeqDQN):
            raise TypeError(f"model is {type(self.model).__name__}; expected SeqDQN")
        return self.model

    def _on_step(self) -> bool:
        return True


class EventReportCallback(SeqDqnCallback):
    """Reports every step in which SUMO took vehicles out of a jam, once, and every crash."""

    def __init__(self, report: Callable[..., None]) -> None:
        """`report` is `RunFolder.event`."""
        super().__init__()
        self._report = report

    def _on_step(self) -> bool:
        step = self.num_timesteps
        by_seat = [_events(info) for info in self.locals["infos"]]
        events: list[Events] = [each for each in by_seat if each is not None]
        if jammed := max((each.jam_teleports for each in events), default=0):
            self._report("jam", step=step, teleported=jammed)
        for each in events:
            if each.crashed:
                self._report("crash", step=step, reason=each.crash_reason, told=each.crash)
        return True


class EpisodeMetricsCallback(SeqDqnCallback):
    """Writes a row for each episode, and KPI 1 of the agent's own choice for `ROW_STEPS` steps."""

    def __init__(
        self,
        rows: MetricsFile,
        steps: MetricsFile,
        started_s: float,
        board: TensorBoardLog | None = None,
        episodes: int = 0,
        crashes: int = 0,
    ) -> None:
        """Log into `rows` (metrics.csv), `steps` (steps.csv) and, where there is one, `board`.

        Args:
            rows: One for each episode.
            steps: One for each `ROW_STEPS` steps.
            started_s: When the training started, by `time.monotonic`.
            board: Gets the rows of episodes too.
            episodes: Done before.
            crashes: Those of them that ended in one.
        """
        super().__init__()
        self._started_s = started_s
        self.episodes = episodes
        self.crashes = crashes
        self._logs: list[MetricsFile | TensorBoardLog] = [rows] if board is None else [rows, board]
        self._steps = steps
        self._by_seat: list[_EpisodeSums] = []
        self._distances: list[float] = []  # of the greedy actions since the last row of steps.csv
        self._means: deque[float] = deque(maxlen=KPI1_STEPS // ROW_STEPS)
        # A run that goes on has rows; a report refuses damaged ones.
        for row in read_metrics(steps.path, steps.columns):
            with suppress(ValueError):
                self._means.append(float(row["kpi1_greedy"]))

    @property
    def kpi1(self) -> float | None:
        """Mean joystick distance of the agent's own choice over the last `KPI1_STEPS` steps."""
        return sum(self._means) / len(self._means) if self._means else None

    def _on_training_start(self) -> None:
        self._by_seat = [_EpisodeSums() for _ in range(self.training_env.num_envs)]

    def _on_step(self) -> bool:
        learner = self.learner
        # What the step was chosen by: SB3 replaces it after the callbacks.
        observation = learner._last_obs
        # 1. KPI 1 is about what the agent chooses; in phase 1 the user's action is executed.
        if self.n_calls % GREEDY_EVERY == 0:
            for seat, action in enumerate(learner.greedy(observation)):
                stick = observation[JOYSTICK_KEY][seat]
                distance = learner.action_points.distance(int(action), stick)
                self._by_seat[seat].greedy.append(distance)
                self._distances.append(distance)
            # The first reading in each hundred steps.
            if self.num_timesteps % ROW_STEPS < GREEDY_EVERY * learner.n_envs:
                self._write_steps_row()
        # 2. The value of the greedy action where an episode starts, as far as it is learned.
        starts = [seat for seat, sums in enumerate(self._by_seat) if not sums.kpis.ticks]
        if starts:
            tensors: Any = learner.policy.obs_to_tensor(observation)[0]
            with torch.no_grad():
                values = learner.q_net(tensors)
                best = values.argmax(dim=1, keepdim=True)
                learned = learner.q_net.learned(values, tensors).gather(1, best)
            for seat in starts:
                self._by_seat[seat].discounted = _DiscountedReturn(
                    gamma=learner.gamma,
                    scale=learner.settings.reward_scale,
                    start_value=float(learned[seat, 0]),
                )
        # 3. What the step brought, and the rows of episodes that ended with it.
        rests = learner.learned_rewards(self.locals["actions"], self.locals["rewards"])
        for seat, info in enumerate(self.locals["infos"]):
            # A world that was restarted ends an episode in a step that was not driven.
            if not info.get(WORLD_RESTARTED):
                self._by_seat[seat].add(
                    float(self.locals["rewards"][seat]), float(rests[seat]), info
                )
            if self.locals["dones"][seat]:
                self._write_episode_row(seat, info)
        return True

    def _write_steps_row(self) -> None:
        self._means.append(float(np.mean(self._distances)))
        self._distances = []
        self._steps.add(
            {
                "step": self.num_timesteps,
                "phase": self._phase(),
                "kpi1_greedy": self._means[-1],
                "elapsed_s_wall": time.monotonic() - self._started_s,
            }
        )

    def _write_episode_row(self, seat: int, info: Info) -> None:
        learner, sums = self.learner, self._by_seat[seat]
        # Its world ended before its first step.
        if not sums.kpis.ticks:
            return
        crashed = not info.get("TimeLimit.truncated", False)
        self.episodes += 1
        self.crashes += int(crashed)
        row: dict[str, Value] = {
            "step": self.num_timesteps,
            "episode": self.episodes,
            "phase": self._phase(),
            **sums.row(info, crashed),
            "epsilon": learner.exploration_rate,
            "margin_weight": learner.plan.margin_weight(self.num_timesteps),
            "loss": learner.last_loss,
            "max_abs_q": learner.max_abs_q,
            "updates": learner._n_updates,
            "elapsed_s_wall": time.monotonic() - self._started_s,
            **sums.discounted.row(ended=crashed),
        }
        for log in self._logs:
            log.add(row)
        self._by_seat[seat] = _EpisodeSums()

    def _phase(self) -> int:
        """The phase of the step that was just done; SB3 has counted it already."""
        return int(self.learner.plan.phase(self.num_timesteps - self.learner.n_envs))


class StopSignalHandler(SignalContextBase):
    """While open, SIGINT and SIGTERM request a stop; a second signal stops at once.

    Only in the main thread. Where a launcher ends this process, no user waits for its end, and a
    second signal comes of the first one having been sent to all processes. There it ends only the
    waiting for a world, as the launcher's own `WAIT_NO_MORE` does.
    """

    def __init__(self, wait_no_more: Callable[[], object] | None = None) -> None:
        """`wait_no_more` ends the waiting within a signal's handler; None without a launcher."""
        ends_waiting = () if wait_no_more is None else (WAIT_NO_MORE,)
        super().__init__(signal.SIGINT, signal.SIGTERM, *ends_waiting)
        self._wait_no_more = wait_no_more
        # Called by the first signal, within its handler.
        self.on_first_signal: Callable[[], object] = lambda: None
        self.requested = False
        self.forced = False  # by a second signal, which may have cut a step in two
        self.ending = False  # the last files are being written

    def raise_if_requested(self) -> None:
        """Raise KeyboardInterrupt once a stop was requested."""
        if self.requested:
            raise KeyboardInterrupt

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        again = self.requested or number == WAIT_NO_MORE
        self.requested = True
        if not again:
            self.on_first_signal()
        elif self._wait_no_more is not None:
            self._wait_no_more()
        elif not self.ending:
            self.forced = True
            raise KeyboardInterrupt


@dataclass(slots=True)
class _DiscountedReturn:
    """The discounted return of one episode as its rewards come in, beside the value at its start.

    >>> episode = _DiscountedReturn(gamma=0.5, scale=0.1, start_value=3.0)
    >>> for reward in (10.0, 20.0):
    ...     episode.add(reward)
    >>> episode.row(ended=True)
    {'value_start': 3.0, 'return_start': 2.0, 'overestimate': 1.0}
    >>> episode.row(ended=False)["return_start"] is None
    True
    """

    gamma: float = 1.0
    scale: float = 1.0  # of rewards
    start_value: float | None = None  # of the greedy action at the start
    _sum: float = 0.0
    _weight: float = 1.0  # of the next reward

    def add(self, reward: float) -> None:
        """Add the reward of a step, unscaled."""
        self._sum += self._weight * self.scale * reward
        self._weight *= self.gamma

    def row(self, ended: bool) -> dict[str, Value]:
        """The value at the start, the return, and by how much the value was higher.

        The episode `ended` by itself, or was cut short by its limit. What is not known is None.
        """
        value = self.start_value
        found = self._sum if ended or self._weight <= _TAIL else None
        over = None if value is None or found is None else value - found
        return {"value_start": value, "return_start": found, "overestimate": over}


@dataclass(slots=True)
class _EpisodeSums:
    """What is summed up while an episode runs."""

    kpis: KpiTotals = KpiTotals()  # noqa: RUF009 - a tuple
    reward: float = 0.0
    progress_m: float = 0.0
    greedy: list[float] = field(default_factory=list)  # joystick distances
    discounted: _DiscountedReturn = field(default_factory=_DiscountedReturn)

    def add(self, reward: float, learned: float, info: Info) -> None:
        """Add a step, by an environment's `info`; its reward, and the part that is learned."""
        self.reward += reward
        self.discounted.add(learned)
        self.progress_m += float(info.get("progress_m", 0.0))
        events = _events(info)
        happened = {"arrivals"} if events is not None and events.arrived else set()
        distance = float(info.get("joystick_distance", 0.0))
        self.kpis = self.kpis.plus(happened, distance, float(info.get("speed_mps", 0.0)))

    def row(self, info: Info, crashed: bool) -> dict[str, Value]:
        """The row of metrics.csv for an episode that ended with this step.

        `cut` is 1 where its world ended it.
        """
        events, kpis = _events(info), self.kpis
        return {
            "return": self.reward,
            "length": kpis.ticks,
            "kpi1": kpis.kpi1,
            "kpi1_greedy": sum(self.greedy) / len(self.greedy) if self.greedy else None,
            "crashed": int(crashed),
            "crash_reason": "" if events is None else events.crash_reason,
            "speed_mps": kpis.speed_sum / kpis.ticks,
            "progress_m": self.progress_m,
            "arrivals": kpis.arrivals,
            "cut": int(info.get(WORLD_RESTARTED, False)),
        }


def _events(info: Info) -> Events | None:
    """The events of a step; None of an environment that has none."""
    return getattr(info.get(OBJECTS), "events", None)
