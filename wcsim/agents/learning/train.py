"""A training run from configuration to saved policies."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import gymnasium
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv

from wcsim.agents.learning.build import build_model, network_settings
from wcsim.agents.learning.callbacks import (
    Between,
    EpisodeMetrics,
    EventWatch,
    StopRequest,
    TrainProgress,
)
from wcsim.agents.learning.checkpoint import restoring, save_checkpoint
from wcsim.agents.learning.phases import LearningPhase
from wcsim.agents.learning.saved_policy import save_policy
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.networks.device import checked_device, torch_settings
from wcsim.agents.runs.checkpoint import go_on
from wcsim.agents.runs.metrics import STEP_COLUMNS, BoardLog, MetricsFile, check_tensorboard
from wcsim.agents.runs.run_folder import (
    METRICS,
    STEPS,
    ResolvedRun,
    RunFolder,
    folder_of,
    how_to_resume,
)
from wcsim.config.run_file import SittingFile
from wcsim.core import files, seeding
from wcsim.errors import DiskFullError, InterruptedRunError, LinkError

SAVE_EVERY_S = {
    True: 900.0,
    False: 60.0,
}  # between checkpoints with their replay, and those that take the newest along

MakeEnv = Callable[[], gymnasium.Env[Any, Any]]
Progress = Callable[[TrainProgress], None]
PROGRESS_EVERY = 50  # steps
Q_ALARM = 1.5  # times the largest value that the reward allows
_now_s = time.monotonic


def train(
    run: ResolvedRun,
    make_env: MakeEnv,
    progress: Progress | None = None,
    *,
    progress_every: int = PROGRESS_EVERY,
    callbacks: Sequence[BaseCallback] = (),
    alive: Callable[[], object] = lambda: None,
    log: Callable[[str], object] = lambda text: None,
    wait_no_more: Callable[[], object] | None = None,
) -> Path:
    """Learn both phases and leave a run folder.

    Args:
        run: The run; with `resume`, configuration, seed, town and rewards must be its own. Equal seeds on equal
            machines give equal weights.
        make_env: Makes the environment; it is reset with the run's seed first.
        progress: Called every `progress_every` steps.
        progress_every: Steps between two calls of `progress`, at least a rollout's.
        callbacks: Callbacks of Stable-Baselines3, beside wcsim's own.
        alive: Called now and then while something takes long that is no step of the environment.
        log: Gets messages for the user, such as checkpoints that could not be used.
        wait_no_more: Makes a LinkError of waiting for a world, where a launcher ends this process: see `StopRequest`.

    Returns:
        The run folder, with policies/phase1 and policies/final.

    Raises:
        InterruptedRunError: A stop was asked for; checkpoint and final policy are saved, `resume` goes on.
        LinkError, DiskFullError: The environment's world is gone; a checkpoint is saved, where there is room.
        PolicyError, ConfigError: The folder is in use, not empty or cannot be resumed; the device cannot be used.
    """
    checked_device(run.config.learn.device)
    if run.config.learn.tensorboard:
        check_tensorboard()
    folder = folder_of(run, network_settings)
    with (
        files.locked(folder.path),
        torch_settings(run.config.learn),
        StopRequest(wait_no_more) as request,
    ):
        env = DummyVecEnv([make_env])
        try:
            model = build_model(run.config, env, run.info.seed)
            _learn_meanwhile(model, env)
            request.wait_less = getattr(env.envs[0].unwrapped, "wait_less", request.wait_less)
            sitting = _restored(folder, model, log, alive) if run.resume else None
            session = _Session(
                folder, model, request, progress, run.resume, sitting, progress_every, alive
            )
            session.callbacks.extend(callbacks)
            with session.board or contextlib.nullcontext():
                return session.learn()
        finally:
            env.close()


def _learn_meanwhile(model: SeqDQN, env: DummyVecEnv) -> None:
    """Have an environment that can wait for its world do the due updates meanwhile; others do them before they wait."""
    inner = env.envs[0].unwrapped
    if model.settings.updates == "while_waiting" and hasattr(inner, "due_work"):
        inner.due_work, model.meanwhile = model.due_updates, True


def _next_multiple(step: int, steps: int) -> int:
    return (step // steps + 1) * steps


class _Session:
    """One sitting of a run: a fresh start or a resume, until done or stopped."""

    def __init__(
        self,
        run: RunFolder,
        model: SeqDQN,
        request: StopRequest,
        progress: Progress | None,
        resume: bool,
        before: SittingFile | None,
        progress_every: int,
        alive: Callable[[], object],
    ) -> None:
        self.run, self.model, self.progress, self.request, self.alive = (
            run,
            model,
            progress,
            request,
            alive,
        )
        self.learn_config = run.config.learn
        if before is not None:
            self._new_segment()
        before = before or SittingFile()
        kept = model.num_timesteps if resume else None
        self.board = BoardLog(run.path, kept) if self.learn_config.tensorboard else None
        self.episodes = EpisodeMetrics(
            MetricsFile(run.path / METRICS, kept),
            MetricsFile(run.path / STEPS, kept, STEP_COLUMNS),
            time.monotonic(),
            self.board,
            model._episode_num,
            before.crashes,
        )
        self.phase1_done = before.phase1_done
        self.alarmed = before.q_alarm
        self.unsaved = ""  # why the last checkpoint could not be written
        if before.owes_updates:
            model.due = 1, model.batch_size
        self._every: dict[Callable[[], None], int] = {
            self._checkpoint: self.learn_config.checkpoint_every,
            self._report: progress_every,
        }
        self._next_at = {
            call: _next_multiple(model.num_timesteps, steps) for call, steps in self._every.items()
        }
        self._save_s = {replay: _now_s() + seconds for replay, seconds in SAVE_EVERY_S.items()}
        self.callbacks: list[BaseCallback] = [
            self.episodes,
            EventWatch(self.run.event),
            Between(self._between),
        ]

    def learn(self) -> Path:
        """Run to the end. Raises InterruptedRunError when it was stopped."""
        total = self.learn_config.total_steps
        try:
            remaining = total - self.model.num_timesteps
            if remaining > 0:
                self.model.learn(
                    remaining, callback=self.callbacks, log_interval=None, reset_num_timesteps=False
                )  # type: ignore[arg-type]
                self.model.catch_up()
        except KeyboardInterrupt:
            if self.request.asked and not self.request.forced:
                with contextlib.suppress(
                    KeyboardInterrupt
                ):  # asked for again: the checkpoints before are whole
                    self._checkpoint()
            raise self._interrupted() from None
        except (
            LinkError,
            DiskFullError,
        ) as error:  # the world is gone, or the seat: what was learned is worth keeping
            if self.model.num_timesteps > 0:
                self._checkpoint()
            if self.request.asked and isinstance(error, LinkError):
                raise self._interrupted() from error
            raise
        if not self.phase1_done and self.learn_config.phase1_steps > 0:
            self._switched()
            self.phase1_done = (
                self.model.phase is LearningPhase.AGENT_DRIVEN
            )  # a run that goes on has done it
        self._checkpoint()
        self._finish("done")
        return self.run.path

    def _interrupted(self) -> InterruptedRunError | DiskFullError:
        """Write the last files; what is to be raised then."""
        self.request.ending = True
        self._finish("interrupted")
        path, done = (
            self.run.path,
            f"{self.model.num_timesteps} of {self.learn_config.total_steps} steps",
        )
        if not self.unsaved:
            return InterruptedRunError(
                f"stopped after {done}; {path} holds the policy so far; continue it: {how_to_resume(path)}"
            )
        return DiskFullError(
            f"stopped after {done}; the policy so far is saved, but the last checkpoint could not be written "
            f"({self.unsaved}): {how_to_resume(path)} continues from the one before it, or starts again if there is "
            "none; free some disk space"
        )

    def _between(self) -> None:
        """What is due between two rollouts. Raises KeyboardInterrupt once a stop was asked for."""
        self._switch_phase()
        step = self.model.num_timesteps
        for call, steps in self._every.items():
            if step >= self._next_at[call]:
                self._next_at[call] = _next_multiple(step, steps)
                call()
        for replay, seconds in SAVE_EVERY_S.items():
            if _now_s() >= self._save_s[replay]:
                self._checkpoint(replay)
                self._save_s[replay] = (
                    _now_s() + seconds
                )  # from its end: a slow disk must not be all that is done
        self.request.look()

    def _switch_phase(self) -> None:
        """Before the first rollout of the second phase: the first is complete and stored then."""
        if not self.phase1_done and self.model.phase is LearningPhase.AGENT_DRIVEN:
            if self.learn_config.phase1_steps > 0:
                self._switched()
            self.phase1_done = (
                True  # not before: what fails on a full disk is done when the run goes on
            )

    def _switched(self) -> None:
        self._save("phase1")
        self.run.event("phase2", step=self.model.num_timesteps)

    def _save(self, stage: str) -> None:
        path = self.run.policy(stage)
        try:
            save_policy(path, self.model, self.run.config.eye, self.run.manifest_sha256())
        except (DiskFullError, OSError) as error:
            raise DiskFullError(
                f"{path}: the policy could not be saved ({error}); make room, then continue: wcsim resume RUN"
            ) from None

    def _finish(self, status: Literal["done", "interrupted"]) -> None:
        """Final policy and manifest; there is no checkpoint of a step that was torn in two."""
        self._save("final")
        self._report()
        self.run = self.run.with_status(status, self.model.num_timesteps)
        self.run.event(status, step=self.model.num_timesteps)

    def _checkpoint(self, replay: bool = True) -> None:
        self._watch_values()
        extra = {
            "crashes": self.episodes.crashes,
            "phase1_done": self.phase1_done,
            "q_alarm": self.alarmed,
            "owes_updates": self.model.due is not None,
        }
        try:
            save_checkpoint(self.run.checkpoints, self.model, extra, self.alive, replay=replay)
        except (DiskFullError, OSError) as error:  # those before are whole, and learning goes on
            self.unsaved = str(error)
            self.run.event("checkpoint_failed", step=self.model.num_timesteps, reason=str(error))
            return
        self.unsaved = ""
        self.run.event("checkpoint" if replay else "weights", step=self.model.num_timesteps)

    def _watch_values(self) -> None:
        """Values beyond all possible returns mean that learning has come apart; log that once."""
        reward, learn = self.run.config.reward, self.learn_config
        largest = learn.reward_scale * (
            reward.crash + max(reward.base, reward.penalty) / (1.0 - learn.gamma)
        )
        if self.model.max_abs_q > Q_ALARM * largest and not self.alarmed:
            self.alarmed = True
            value = self.model.max_abs_q
            shown = value if math.isfinite(value) else str(value)
            self.run.event(
                "q_alarm", step=self.model.num_timesteps, max_abs_q=shown, largest=largest
            )

    def _report(self) -> None:
        if self.progress is not None:
            step, total = self.model.num_timesteps, self.learn_config.total_steps
            self.progress(
                TrainProgress(
                    step=step,
                    total_steps=total,
                    phase=int(self.model.phase),
                    episodes=self.episodes.episodes,
                    crashes=self.episodes.crashes,
                    kpi1=self.episodes.kpi1,
                )
            )

    def _new_segment(self) -> None:
        """The world cannot be saved: a resumed run goes on in a new one, with a seed of its own."""
        segment = seeding.derive(
            self.run.manifest.seed, "agent", "segment", self.model.num_timesteps
        )
        if self.model.env is not None:
            self.model.env.seed(segment)
        self.run = self.run.with_status("running", self.model.num_timesteps)
        self.run.event("resume", step=self.model.num_timesteps, seed=segment)


def _restored(
    run: RunFolder, model: SeqDQN, log: Callable[[str], object], alive: Callable[[], object]
) -> SittingFile | None:
    """What came before the newest sound checkpoint, which is restored; None for a run that begins again."""
    found = go_on(run, restoring(model, alive), log)
    if found is None:
        log(f"{run.path} stopped before its first checkpoint; it starts again")
        run.event("begin_again")
        return None
    return found.value
