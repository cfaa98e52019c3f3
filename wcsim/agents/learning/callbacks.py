"""Stable-Baselines3 callbacks of a training run: metrics, checkpoints, progress, interruption.

Does a learner promise too much? Values at the starts of episodes are compared with the returns that followed. The
maximum over noisy values is too high on average, which is why DQN overestimates and Double DQN was made (van Hasselt,
Guez, Silver 2016). Both numbers are in units of the scaled reward, as the network's values are.
"""

from __future__ import annotations

import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from types import FrameType
from typing import Any, Final

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from wcsim.agents.envs.episode_view import WORLD_RESTARTED
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.policy_api import JOYSTICK_KEY
from wcsim.agents.runs.metrics import KPI1_STEPS, ROW_STEPS, BoardLog, MetricsFile, Value
from wcsim.server.launch.states import WAIT_NO_MORE
from wcsim.supervisor.kpi import KpiTotals
from wcsim.types import Events

GREEDY_EVERY = 5  # steps between two looks at the agent's own choice
_TAIL: Final = 0.05  # an episode that was cut short says nothing of its return while more than this share is to come


@dataclass(slots=True)
class _ValueWatch:
    """The discounted return of one episode as it comes in.

    >>> watch = _ValueWatch(gamma=0.5, scale=0.1, value=3.0)
    >>> for reward in (10.0, 20.0):
    ...     watch.add(reward)
    >>> watch.row(ended=True)
    {'value_start': 3.0, 'return_start': 2.0, 'overestimate': 1.0}
    >>> watch.row(ended=False)["return_start"] is None
    True
    """

    gamma: float
    scale: float  # of rewards
    value: float | None = None  # of the greedy action at the start
    _sum: float = 0.0
    _weight: float = 1.0  # of the next reward

    def add(self, reward: float) -> None:
        """Take in the reward of a step, unscaled."""
        self._sum += self._weight * self.scale * reward
        self._weight *= self.gamma

    def row(self, ended: bool) -> dict[str, Value]:
        """The value at the start, the return, and by how much the value was higher; None where one is not known.

        The episode `ended` by itself, or was cut short by its limit.
        """
        value, found = self.value, self._sum if ended or self._weight <= _TAIL else None
        over = None if value is None or found is None else value - found
        return {"value_start": value, "return_start": found, "overestimate": over}


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainProgress:
    """Progress of a run."""

    step: int
    total_steps: int
    phase: int
    episodes: int
    crashes: int
    kpi1: float | None  # of the agent's own choice, mean of the last `KPI1_STEPS` steps


@dataclass(slots=True)
class _EpisodeSums:
    """What is summed up while an episode runs."""

    kpis: KpiTotals = KpiTotals()  # noqa: RUF009 - a tuple
    reward: float = 0.0
    progress_m: float = 0.0
    greedy: list[float] = field(default_factory=list)
    values: _ValueWatch = field(default_factory=lambda: _ValueWatch(gamma=1.0, scale=1.0))

    def add(self, reward: float, info: dict[str, Any]) -> None:
        """One step, by an environment's `info`."""
        self.reward += reward
        self.values.add(reward)
        self.progress_m += float(info.get("progress_m", 0.0))
        events = info.get("events")
        happened = {"arrivals"} if events is not None and events.arrived else set()
        distance, speed_mps = (
            float(info.get(name, 0.0)) for name in ("joystick_distance", "speed_mps")
        )
        self.kpis = self.kpis.plus(happened, distance, speed_mps)

    def row(self, info: dict[str, Any], crashed: bool) -> dict[str, float | int | str | None]:
        """The row of metrics.csv for an episode that ended with this step; `cut` is 1 where its world ended it."""
        events, kpis = info.get("events"), self.kpis
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
            "cut": int(info.get("reason") == WORLD_RESTARTED),
        }


class SeqCallback(BaseCallback):
    """A callback of a SeqDQN."""

    @property
    def learner(self) -> SeqDQN:
        """The model, by its own type."""
        if not isinstance(self.model, SeqDQN):
            raise TypeError(f"model is {type(self.model).__name__}; expected SeqDQN")
        return self.model

    def _on_step(self) -> bool:
        return True


class EventWatch(SeqCallback):
    """Reports every step in which SUMO took vehicles out of a jam, once, and every crash."""

    def __init__(self, report: Callable[..., None]) -> None:
        """`report` is `RunFolder.event`."""
        super().__init__()
        self.report = report

    def _on_step(self) -> bool:
        step, told = self.num_timesteps, [info.get("events") for info in self.locals["infos"]]
        events: list[Events] = [each for each in told if each is not None]
        if jammed := max((each.jam_teleports for each in events), default=0):
            self.report("jam", step=step, teleported=jammed)
        for each in events:
            if each.crashed:
                self.report("crash", step=step, reason=each.crash_reason, told=each.crash)
        return True


class EpisodeMetrics(SeqCallback):
    """Writes a row at the end of each episode, and KPI 1 of the agent's own choice every `ROW_STEPS` steps."""

    def __init__(
        self,
        rows: MetricsFile,
        steps: MetricsFile,
        begun_s: float,
        board: BoardLog | None = None,
        episodes: int = 0,
        crashes: int = 0,
    ) -> None:
        """`rows` is metrics.csv, `steps` steps.csv; episodes and crashes are those of what was done before."""
        super().__init__()
        self.begun_s, self.episodes, self.crashes = begun_s, episodes, crashes
        self._logs: list[MetricsFile | BoardLog] = [rows] if board is None else [rows, board]
        self._steps = steps
        self.sums: list[_EpisodeSums] = []
        self._looks: list[float] = []  # distances since the last row of steps.csv
        self._rows: deque[float] = deque(maxlen=KPI1_STEPS // ROW_STEPS)

    @property
    def kpi1(self) -> float | None:
        """Mean joystick distance of the agent's own choice over the last `KPI1_STEPS` steps."""
        return sum(self._rows) / len(self._rows) if self._rows else None

    def _on_training_start(self) -> None:
        self.sums = [_EpisodeSums() for _ in range(self.training_env.num_envs)]

    def _on_step(self) -> bool:
        self._look_greedy()
        self._look_at_starts()
        for seat, info in enumerate(self.locals["infos"]):
            if info.get("reason") != WORLD_RESTARTED:  # a step that was not driven
                self.sums[seat].add(float(self.locals["rewards"][seat]), info)
            if self.locals["dones"][seat]:
                self._finish(seat, info)
        return True

    def _look_greedy(self) -> None:
        """KPI 1 is about what the agent chooses; in the first phase the user's action is executed."""
        learner, observation = self.learner, self.learner._last_obs
        if self.n_calls % GREEDY_EVERY:
            return
        for seat, action in enumerate(learner.greedy(observation)):
            distance = learner.action_points.distance(int(action), observation[JOYSTICK_KEY][seat])
            self.sums[seat].greedy.append(distance)
            self._looks.append(distance)
        if (
            self.num_timesteps % ROW_STEPS < GREEDY_EVERY * learner.n_envs
        ):  # one look of each hundred steps
            self._note_steps()

    def _note_steps(self) -> None:
        """A row of steps.csv."""
        self._rows.append(float(np.mean(self._looks)))
        self._looks = []
        self._steps.add(
            {
                "step": self.num_timesteps,
                "phase": self._phase(),
                "kpi1_greedy": self._rows[-1],
                "elapsed_s_wall": time.monotonic() - self.begun_s,
            }
        )

    def _phase(self) -> int:
        """The phase of the step that was just done."""
        return int(self.learner.plan.phase(self.num_timesteps - self.learner.n_envs))

    def _look_at_starts(self) -> None:
        """The value of what the agent saw when its episode began."""
        learner, observation = self.learner, self.learner._last_obs
        starts = [seat for seat, sums in enumerate(self.sums) if not sums.kpis.ticks]
        if not starts:
            return
        seen, _ = learner.policy.obs_to_tensor(observation)
        with torch.no_grad():
            values = learner.q_net(seen)
            taken = values.max(dim=1).values
        for seat in starts:
            value, scale = float(taken[seat]), learner.settings.reward_scale
            self.sums[seat].values = _ValueWatch(gamma=learner.gamma, scale=scale, value=value)

    def _finish(self, seat: int, info: dict[str, Any]) -> None:
        sums, learner = self.sums[seat], self.learner
        if not sums.kpis.ticks:  # its world ended before its first step
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
            "elapsed_s_wall": time.monotonic() - self.begun_s,
            **sums.values.row(ended=crashed),
        }
        for log in self._logs:
            log.add(row)
        self.sums[seat] = _EpisodeSums()


class Between(SeqCallback):
    """Calls a function between rollouts, where nothing is half-done."""

    def __init__(self, call: Callable[[], None]) -> None:
        super().__init__()
        self.call = call

    def _on_rollout_start(self) -> None:
        self.call()


class StopRequest:
    """While open, SIGINT and SIGTERM ask for a stop; a second signal stops at once. Only in the main thread.

    Where a launcher ends this process, no user waits for its end, and a second signal comes of the
    first one having been sent to all: it, and the launcher's own `WAIT_NO_MORE`, end the waiting for a world alone.
    """

    def __init__(self, wait_no_more: Callable[[], object] | None = None) -> None:
        """`wait_no_more` ends the waiting, and is called within a signal's handler; None without a launcher."""
        self._wait_no_more = wait_no_more
        self.wait_less: Callable[[], object] = lambda: (
            None
        )  # called by the first signal, within its handler
        self.asked, self.forced = False, False
        self.ending = (
            False  # the last files are being written: what is asked for again is under way
        )
        self._before: dict[int, Any] = {}

    def look(self) -> None:
        """Raise KeyboardInterrupt once a stop was asked for."""
        if self.asked:
            raise KeyboardInterrupt

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            ends_waiting = () if self._wait_no_more is None else (WAIT_NO_MORE,)
            for number in (signal.SIGINT, signal.SIGTERM, *ends_waiting):
                self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        del frame
        again = self.asked or number == WAIT_NO_MORE
        self.asked = True
        if not again:
            self.wait_less()
        elif self._wait_no_more is not None:
            self._wait_no_more()
        elif not self.ending:
            self.forced = True
            raise KeyboardInterrupt
