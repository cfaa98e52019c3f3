"""A training run of a danger network that learns from each step as it drives, from configuration to saved policies.

The teacher is the environment: `info["truth"]` of every observation. Phases, exploration, checkpoints, metrics.csv and
policies are those of Q-learning (`agents/learning/train.py`); the policy is of the same kind as that of rounds, and
what was driven lies in `data/`, a folder as `wcsim collect` writes it.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import gymnasium
from safetensors import SafetensorError

from wcsim.agents.collecting.data_folder import DATA, write_manifest
from wcsim.agents.collecting.drive_segment import DrivenRow
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.rule import rule_of
from wcsim.agents.danger.saved import save_danger
from wcsim.agents.envs.episode_view import EpisodeStep, delay_ticks
from wcsim.agents.learning.build import phase_plan, with_window
from wcsim.agents.learning.callbacks import GREEDY_EVERY, EpisodeSums, StopRequest, TrainProgress, report_events
from wcsim.agents.learning.phases import LearningPhase
from wcsim.agents.learning.train import PROGRESS_EVERY, MakeEnv, Progress, stopped_error, tell_loaded, torch_settings
from wcsim.agents.learning.watching.metrics import MetricsFile
from wcsim.agents.learning.watching.tensorboard import BoardLog, require_tensorboard
from wcsim.agents.online.agent import DrivingTurn, OnlineAgent
from wcsim.agents.online.online_checkpoint import Counters, OnlineState, load_online, save_online
from wcsim.agents.online.taught_ride import TaughtRide
from wcsim.agents.policy_api import JOYSTICK_KEY, Observation
from wcsim.agents.runs.resumed_folder import folder_of
from wcsim.agents.runs.run_folder import METRICS, ResolvedRun, RunFolder
from wcsim.config import LearnConfig
from wcsim.core import files, seeding
from wcsim.errors import DiskFullError, InterruptedRunError, LinkError, PolicyError
from wcsim.supervisor.actions import action_set
from wcsim.types import Truth


def _as_it_is(call: Callable[..., Any]) -> Callable[..., Any]:
    return call


@dataclass(frozen=True, slots=True, kw_only=True)
class Listeners:
    """Who is told what while a run goes on."""

    progress: Progress | None = None
    progress_every: int = PROGRESS_EVERY  # steps between two calls of `progress`
    alive: Callable[[], object] = lambda: None  # called now and then while something takes long that is no step
    say: Callable[[str], object] = lambda text: None  # told what a person should know
    deciding: Callable[[Callable[..., Any]], Callable[..., Any]] = _as_it_is  # put around decisions, to measure them
    learning: Callable[[Callable[..., Any]], Callable[..., Any]] = _as_it_is  # and around updates
    wait_no_more: Callable[[], object] | None = None  # ends waiting for a world: see `StopRequest`


def train_online(run: ResolvedRun, make_env: MakeEnv, listeners: Listeners | None = None) -> Path:
    """Learn both phases and leave a run folder with policies/phase1 and policies/final.

    Args:
        run: The run; with `resume`, configuration, seed, town and rewards must be its own. Equal seeds on equal
            machines give equal weights.
        make_env: Makes the environment; it is reset with the run's seed first, and tells the truth.
        listeners: Who is told what.

    Raises:
        InterruptedRunError: A stop was asked for; checkpoint and final policy are saved, `resume` goes on.
        LinkError, DiskFullError: The environment's world is gone; a checkpoint is saved, where there is room.
        PolicyError, ConfigError: The folder is in use, not empty or cannot be resumed; the environment tells no truth.
    """
    if run.config.learn.tensorboard:
        require_tensorboard()
    folder, heard_by = folder_of(run, with_window), listeners or Listeners()
    with files.locked(folder.path), torch_settings(run.config), StopRequest(heard_by.wait_no_more) as request:
        env = make_env()
        request.wait_less = getattr(env.unwrapped, "wait_less", request.wait_less)
        try:
            session = _OnlineSession(folder, env, request, heard_by, run.resume)
            with session.board or contextlib.nullcontext():
                return session.learn()
        finally:
            env.close()


class _OnlineSession:
    """One sitting of a run: a fresh start or a resume, until done or stopped."""

    def __init__(
        self, run: RunFolder, env: gymnasium.Env[Any, Any], request: StopRequest, listeners: Listeners, resume: bool
    ) -> None:
        self.run, self._env, self._request, self._listeners = run, env, request, listeners
        config, seed = run.config, run.manifest.seed
        self._config, self._learn, self._plan = config, config.learn, phase_plan(config.learn)
        self._learner = DangerLearner(config, seed, planned_updates(config.learn))
        self._ride = TaughtRide(config, run.path / DATA, seed)
        self._agent = OnlineAgent(config, self._learner.net, seeding.generator(seed, "agent", "explore"))
        self._lectures_rng = seeding.generator(seed, "agent", "lectures")
        self._world_seed, self._now = seed, Counters()
        if resume:
            self._resume()
        self._ride.lectures.begin(self._lectures_rng)
        keep_to_step = self._now.step if resume else None
        self._metrics = MetricsFile(run.path / METRICS, keep_to_step)
        self.board = BoardLog(run.path, keep_to_step) if config.learn.tensorboard else None
        self._begun_s, self._sums = time.monotonic(), EpisodeSums()
        self._kpi1: float | None = None  # of the last finished episode
        self._unsaved = ""  # why the last checkpoint could not be written
        self._choose, self._teach = listeners.deciding(self._agent.choose), listeners.learning(self._learner.learn)
        self._points = action_set(config.env.actions)

    def learn(self) -> Path:
        """Run to the end. Raises InterruptedRunError when it was stopped."""
        total = self._learn.total_steps
        try:
            self._drive(total)
        except KeyboardInterrupt:
            if self._request.asked and not self._request.forced:
                with contextlib.suppress(KeyboardInterrupt):  # asked for again: the checkpoints before are whole
                    self._checkpoint()
            raise self._interrupted() from None
        except (LinkError, DiskFullError) as error:  # the world is gone: what was learned before is worth keeping
            if self._now.step > 0:
                self._checkpoint()
            if self._request.asked and isinstance(error, LinkError):
                raise self._interrupted() from error
            raise
        if not self._now.phase1_done and self._learn.phase1_steps > 0:
            self._switch()
        self._checkpoint()
        self._finish("done")
        return self.run.path

    def _interrupted(self) -> InterruptedRunError | DiskFullError:
        """Write the last files; what is to be raised then."""
        self._request.ending = True
        self._finish("interrupted")
        return stopped_error(self.run.path, self._now.step, self._learn.total_steps, self._unsaved)

    def _drive(self, total: int) -> None:
        learn = self._learn
        if self._now.step >= total:
            return
        seen, said = self._begin(*self._env.reset(seed=self._world_seed))
        while self._now.step < total:
            if self._now.step % learn.train_every == 0:
                self._between()
            seen, said = self._step(seen, said)
            due = self._now.step % learn.train_every == 0 and self._now.step > learn.learning_starts
            if due and self._ride.lectures.tight_share > 0.0:  # from safe steps alone it would learn that all is safe
                self._teach(self._ride.lectures, learn.gradient_steps)

    def _step(self, seen: Observation, said: Truth) -> tuple[Observation, Truth]:
        """One step of the environment; what is seen after it, of the next episode where one has ended."""
        step, plan = self._now.step, self._plan
        turn = DrivingTurn(phase=plan.phase(step), epsilon=plan.epsilon(step), greedy=step % GREEDY_EVERY == 0)
        choice = self._choose(seen, turn)
        if turn.phase is LearningPhase.ACTION_DRIVEN and self._agent.would >= 0:
            self._sums.greedy.append(self._points.distance(self._agent.would, seen[JOYSTICK_KEY]))
        observation, reward, terminated, truncated, info = self._env.step(choice.action)
        after = EpisodeStep(observation, float(reward), bool(terminated), bool(truncated), info)
        self._now = replace(self._now, step=step + 1)
        self._ride.add(self._agent.sight, DrivenRow(seen=seen, said=said, choice=choice, step=after, delay=self._delay))
        self._sums.add(after.reward, after.info)
        events = after.info.get("events")
        if events is not None:
            report_events(self.run.event, self._now.step, (events,))
        if after.done:
            self._note(after, turn)
            return self._begin(*self._env.reset())
        return after.observation, truth_of(after.info)

    def _begin(self, seen: Observation, info: dict[str, Any]) -> tuple[Observation, Truth]:
        self._delay = delay_ticks(self._config, info.get("drawn"))
        self._agent.begin(self._delay)
        return seen, truth_of(info)

    def _note(self, after: EpisodeStep, turn: DrivingTurn) -> None:
        """A row of metrics.csv, and for TensorBoard where that is wanted."""
        now = self._now = replace(
            self._now, episodes=self._now.episodes + 1, crashes=self._now.crashes + int(after.terminated)
        )
        row = self._sums.row(after.info, after.terminated)
        self._kpi1 = self._sums.distance / self._sums.steps
        rest = {"step": now.step, "episode": now.episodes, "phase": int(turn.phase), "epsilon": turn.epsilon}
        learned = {
            "loss": self._learner.loss,
            "updates": self._learner.updates,
            "max_abs_q": None,
            "margin_weight": 0.0,
            "value_start": None,
            "return_start": None,
            "overestimate": None,
        }
        row = {**row, **rest, **learned, "elapsed_s_wall": time.monotonic() - self._begun_s}
        self._metrics.add(row)
        if self.board is not None:
            self.board.add(row)
        self._sums = EpisodeSums()

    def _between(self) -> None:
        """What is done between steps, when all of them are kept."""
        if self._request.asked:
            raise KeyboardInterrupt
        step, learn = self._now.step, self._learn
        if not self._now.phase1_done and self._plan.phase(step) is LearningPhase.AGENT_DRIVEN:
            self._switch()
        if step and _passes(step, learn.checkpoint_every, learn.train_every):
            self._checkpoint()
        if _passes(step, self._listeners.progress_every, learn.train_every):
            self._report()

    def _switch(self) -> None:
        if self._learn.phase1_steps > 0:
            self._save("phase1")
            self.run.event("phase2", step=self._now.step)
        self._now = replace(self._now, phase1_done=True)  # not before: see `PhaseSwitch`

    def _save(self, stage: str) -> None:
        path, config = self.run.policy(stage), self._config
        try:
            save_danger(path, self._learner.net, rule_of(config.danger), config, self.run.manifest_sha256())
        except (DiskFullError, OSError, SafetensorError) as error:
            raise DiskFullError(f"{path}: the policy could not be saved ({error}); make room and --resume") from None

    def _finish(self, status: Literal["done", "interrupted"]) -> None:
        self._save("final")
        self._report()
        self.run = self.run.with_status(status, self._now.step)
        self.run.event(status, step=self._now.step)

    def _checkpoint(self) -> None:
        self._listeners.alive()
        manifest, ride = self.run.manifest, self._ride
        try:
            ride.write()
            write_manifest(self.run.path / DATA, self._config, {manifest.town: manifest.town_sha256}, ride.segments)
            save_online(self.run.checkpoints, self._learner, self._state())
        except (DiskFullError, OSError, SafetensorError) as error:  # those before are whole, and learning goes on
            self._unsaved = str(error)
            self.run.event("checkpoint_failed", step=self._now.step, reason=str(error))
            return
        self._unsaved = ""
        self.run.event("checkpoint", step=self._now.step)

    def _state(self) -> OnlineState:
        return OnlineState(
            counters=self._now,
            segments=self._ride.segments,
            explore_rng=self._agent.rng,
            lectures_rng=self._lectures_rng,
        )

    def _resume(self) -> None:
        """Go on from the newest sound checkpoint, in a new world with a seed of its own; begin again without one."""
        run, listeners = self.run, self._listeners
        found = load_online(run.checkpoints, self._learner, self._ride, listeners.alive)
        if found is None:
            listeners.say(f"{run.path} stopped before its first checkpoint; it starts again")
            run.event("begin_again")
            return
        state, loaded = found
        tell_loaded(run, loaded, listeners.say)
        self._now, self._agent.rng, self._lectures_rng = state.counters, state.explore_rng, state.lectures_rng
        self._world_seed = seeding.derive(run.manifest.seed, "agent", "segment", self._now.step)
        self.run = run.with_status("running", self._now.step)
        self.run.event("resume", step=self._now.step, seed=self._world_seed)

    def _report(self) -> None:
        if self._listeners.progress is not None:
            now = self._now
            self._listeners.progress(
                TrainProgress(
                    step=now.step,
                    total_steps=self._learn.total_steps,
                    phase=int(self._plan.phase(now.step)),
                    episodes=now.episodes,
                    crashes=now.crashes,
                    kpi1=self._kpi1,
                )
            )


def truth_of(info: dict[str, Any]) -> Truth:
    """The truth that an environment tells. Raises PolicyError when it tells none."""
    said = info.get("truth")
    if not isinstance(said, Truth):
        raise PolicyError(
            "the environment returns no truth; expected info['truth'] with every observation: set env.truth=true, or "
            "env.truth_visible=true for labels limited to what the cameras showed"
        )
    return said


def planned_updates(learn: LearnConfig) -> int:
    """How many updates a run of these settings does in all.

    >>> planned_updates(LearnConfig(total_steps=100, learning_starts=20, train_every=4, gradient_steps=2))
    40
    """
    return max((learn.total_steps - learn.learning_starts) // learn.train_every, 1) * learn.gradient_steps


def _passes(step: int, every: int, stride: int) -> bool:
    """Whether a multiple of `every` lies in the last `stride` steps.

    >>> [step for step in range(0, 24, 4) if _passes(step, 10, 4)]
    [0, 12, 20]
    """
    return step % every < stride
