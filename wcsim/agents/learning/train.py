"""A training run, from its configuration to the saved policies of both phases.

In the first phase the user's joystick drives, in the second the learner's own. The number of steps
decides which one it is (`agents/learning/phases.py`), so one call of SB3's `learn` goes through
both. All that a run saves and reports on the way is done between two rollouts, where every step is
stored and no update is half-done.
"""

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import gymnasium
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv

from wcsim.agents.learning.build import build_q_learner, default_settings_for_network
from wcsim.agents.learning.callbacks import (
    EpisodeMetricsCallback,
    EventReportCallback,
    SeqDqnCallback,
    StopSignalHandler,
    TrainProgress,
)
from wcsim.agents.learning.checkpoint import make_checkpoint_restorer, save_checkpoint
from wcsim.agents.learning.phases import LearningPhase
from wcsim.agents.learning.saved_policy import save_policy
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.networks.device import temporary_torch_settings, validate_device_name
from wcsim.agents.runs.checkpoint import Alive, Log, restore_newest_checkpoint
from wcsim.agents.runs.metrics import (
    STEP_COLUMNS,
    MetricsFile,
    TensorBoardLog,
    require_tensorboard_installed,
)
from wcsim.agents.runs.run_folder import (
    METRICS,
    STEPS,
    ResolvedRun,
    RunFolder,
    format_resume_command,
    open_or_create_run,
)
from wcsim.config.run_file import QTrainingProgress
from wcsim.core import files, seeding
from wcsim.errors import DiskFullError, InterruptedRunError, LinkError

MakeEnv = Callable[[], gymnasium.Env[Any, Any]]
Progress = Callable[[TrainProgress], None]

PROGRESS_EVERY: Final = 50  # steps
Q_ALARM: Final = 1.5  # times the largest value that the reward allows
# Wall time between checkpoints with a replay of their own (True), and between those that share the
# newest replay, if there is one. Each has a timer; `learn.checkpoint_every` saves beside them.
SAVE_EVERY_S: Final = {True: 900.0, False: 60.0}
_now_s = time.monotonic


def train_dqn(
    run: ResolvedRun,
    make_env: MakeEnv,
    progress: Progress = lambda now: None,
    *,
    progress_every: int = PROGRESS_EVERY,
    callbacks: Sequence[BaseCallback] = (),
    alive: Alive = lambda: None,
    log: Log = lambda text: None,
    wait_no_more: Callable[[], object] | None = None,
) -> Path:
    """Learn both phases and leave a run folder.

    Args:
        run: The run; with `resume`, configuration, seed, town and rewards must be its own. Equal
            seeds on equal machines give equal weights.
        make_env: Makes the environment; it is reset with the run's seed first.
        progress: Called every `progress_every` steps.
        progress_every: Steps between two calls of `progress`, at least a rollout's.
        callbacks: Callbacks of Stable-Baselines3, beside wcsim's own.
        alive: Called now and then while something takes long that is no step of the environment.
        log: Gets messages for the user, such as checkpoints that could not be used.
        wait_no_more: Makes a LinkError of waiting for a world, where a launcher ends this process:
            see `StopSignalHandler`.

    Returns:
        The run folder, with policies/phase1 and policies/final.

    Raises:
        InterruptedRunError: A stop was requested; checkpoint and final policy are saved, `resume`
            goes on.
        LinkError, DiskFullError: The environment's world is gone; a checkpoint is saved, where
            there is room.
        PolicyError, ConfigError: The folder is in use, not empty or cannot be resumed; the device
            cannot be used.
    """
    # 1. What cannot be used here is refused before a folder is made.
    validate_device_name(run.config.learn.device)
    if run.config.learn.tensorboard:
        require_tensorboard_installed()
    # 2. The run folder, for this process alone.
    folder = open_or_create_run(run, default_settings_for_network)
    with (
        files.lock_run_folder(folder.path),
        temporary_torch_settings(run.config.learn),
        StopSignalHandler(wait_no_more) as stop,
    ):
        env = DummyVecEnv([make_env])
        try:
            # 3. The learner. An environment that waits for its world does the updates meanwhile.
            model = build_q_learner(run.config, env, run.info.seed)
            inner = env.envs[0].unwrapped
            if model.settings.updates == "while_waiting" and hasattr(inner, "due_work"):
                inner.due_work = model.due_updates
                model.meanwhile = True
            stop.on_first_signal = getattr(inner, "wait_less", stop.on_first_signal)
            # 4. A run that goes on: the learner of its newest checkpoint, in a new world.
            before = None
            if run.resume:
                before = _restore_newest(folder, model, log, alive)
            if before is not None:
                # A world cannot be saved: the run goes on in a new one, with a seed of its own.
                step = model.num_timesteps
                seed = seeding.derive_seed(folder.manifest.seed, "agent", "segment", step)
                env.seed(seed)
                folder = folder.with_status("running", step)
                folder.event("resume", step=step, seed=seed)
            # 5. Both phases, with the logs open.
            session = _Session(
                folder, model, before, run.resume, stop, progress, progress_every, alive
            )
            with session.board or contextlib.nullcontext():
                return session.learn(callbacks)
        finally:
            env.close()


def _restore_newest(
    folder: RunFolder,
    model: SeqDQN,
    log: Log,
    alive: Alive,
) -> QTrainingProgress | None:
    """Bring a learner to its newest sound checkpoint; None, with an event, where a run has none."""
    found = restore_newest_checkpoint(folder, make_checkpoint_restorer(model, alive), log)
    if found is None:
        log(f"{folder.path} stopped before its first checkpoint; it starts again")
        folder.event("begin_again")
        return None
    return found.value


class _Session(SeqDqnCallback):
    """What one process does of a run: from a fresh start, or a resume, to its end or a stop.

    As a callback of SB3 it saves and reports between two rollouts.
    """

    def __init__(
        self,
        folder: RunFolder,
        model: SeqDQN,
        before: QTrainingProgress | None,
        resume: bool,
        stop: StopSignalHandler,
        progress: Progress,
        progress_every: int,
        alive: Alive,
    ) -> None:
        super().__init__()
        self.model = model
        self._folder = folder
        self._settings = folder.config.learn
        self._stop = stop
        self._progress = progress
        self._progress_every = progress_every
        self._alive = alive
        self._unsaved = ""  # why the last checkpoint could not be written
        before = before or QTrainingProgress()
        self._phase1_done = before.phase1_done
        self._q_alarm = before.q_alarm
        if before.owes_updates:
            model.due = 1, model.batch_size
        # Rows after the restored step belong to work that is done again.
        last_step = model.num_timesteps if resume else None
        self.board = TensorBoardLog(folder.path, last_step) if self._settings.tensorboard else None
        self._episodes = EpisodeMetricsCallback(
            MetricsFile(folder.path / METRICS, last_step),
            MetricsFile(folder.path / STEPS, last_step, STEP_COLUMNS),
            time.monotonic(),
            self.board,
            model._episode_num,
            before.crashes,
        )
        self._checkpoint_at = _next_multiple(model.num_timesteps, self._settings.checkpoint_every)
        self._report_at = _next_multiple(model.num_timesteps, progress_every)
        self._save_at_s = {full: _now_s() + every_s for full, every_s in SAVE_EVERY_S.items()}

    def learn(self, callbacks: Sequence[BaseCallback]) -> Path:
        """Learn what is left of both phases, and save the end. Raises as `train_dqn`."""
        model = self.learner
        try:
            # 1. Drive and learn. What is due between two rollouts does `_on_rollout_start`.
            remaining = self._settings.total_steps - model.num_timesteps
            if remaining > 0:
                own = [self._episodes, EventReportCallback(self._folder.event), self]
                model.learn(
                    remaining,
                    callback=[*own, *callbacks],
                    log_interval=None,  # type: ignore[arg-type]
                    reset_num_timesteps=False,
                )
                model.catch_up()
        except KeyboardInterrupt:
            # 2. A stop. One that was forced, or raised from elsewhere, may have cut a step in two:
            # a learner in such a state gets no checkpoint, and the run goes on from the last one.
            if self._stop.requested and not self._stop.forced:
                # Requested once more: the checkpoints before are whole.
                with contextlib.suppress(KeyboardInterrupt):
                    self._save_checkpoint()
            raise self._save_interrupted() from None
        except (LinkError, DiskFullError) as error:
            # 3. The world or the seat is lost; what was learned is worth saving. A stop meanwhile
            # leaves the checkpoints before, which are whole.
            if model.num_timesteps > 0:
                with contextlib.suppress(KeyboardInterrupt):
                    self._save_checkpoint()
            if self._stop.requested and isinstance(error, LinkError):
                raise self._save_interrupted() from error
            raise
        # 4. The end, also of a run that had no rollout in its second phase.
        if not self._phase1_done and self._settings.phase1_steps > 0:
            self._save_phase1()
            # A run that ends within its first phase does it again where it is extended.
            self._phase1_done = model.phase is LearningPhase.AGENT_DRIVEN
        self._save_checkpoint()
        self._save_end("done")
        return self._folder.path

    def _on_rollout_start(self) -> None:
        """Save and report what is due. Raises KeyboardInterrupt once a stop was requested."""
        step = self.learner.num_timesteps
        # 1. The first phase is complete: its policy is saved before the second one changes it.
        if not self._phase1_done and self.learner.phase is LearningPhase.AGENT_DRIVEN:
            if self._settings.phase1_steps > 0:
                self._save_phase1()
            # Not before: what fails on a full disk is done when the run goes on.
            self._phase1_done = True
        # 2. Checkpoints and progress by steps. A rollout may jump over a multiple.
        if step >= self._checkpoint_at:
            self._checkpoint_at = _next_multiple(step, self._settings.checkpoint_every)
            self._save_checkpoint()
        if step >= self._report_at:
            self._report_at = _next_multiple(step, self._progress_every)
            self._report_progress()
        # 3. Checkpoints by wall time. Weights are small and saved often.
        for full, every_s in SAVE_EVERY_S.items():
            if _now_s() >= self._save_at_s[full]:
                self._save_checkpoint(full=full)
                # Counted from its end: on a slow disk, saving must not be all that is done.
                self._save_at_s[full] = _now_s() + every_s
        # 4. A stop, now that all of this is written.
        self._stop.raise_if_requested()

    def _save_phase1(self) -> None:
        self._save_policy("phase1")
        self._folder.event("phase2", step=self.learner.num_timesteps)

    def _save_policy(self, stage: str) -> None:
        path = self._folder.policy(stage)
        try:
            manifest_sha256 = self._folder.manifest_sha256()
            save_policy(path, self.learner, self._folder.config.eye, manifest_sha256)
        except (DiskFullError, OSError) as error:
            raise DiskFullError(
                f"{path}: the policy could not be saved ({error}); make room, then continue: "
                "wcsim resume RUN"
            ) from None

    def _save_checkpoint(self, *, full: bool = True) -> None:
        """Save a checkpoint, with a replay of its own when `full`; on a full disk, log that."""
        step = self.learner.num_timesteps
        self._log_q_alarm()
        extra = {
            "crashes": self._episodes.crashes,
            "phase1_done": self._phase1_done,
            "q_alarm": self._q_alarm,
            "owes_updates": self.learner.due is not None,
        }
        folder = self._folder.checkpoints
        try:
            save_checkpoint(folder, self.learner, extra, self._alive, replay=full)
        except (DiskFullError, OSError) as error:
            # The checkpoints before are whole, so learning goes on.
            self._unsaved = str(error)
            self._folder.event("checkpoint_failed", step=step, reason=str(error))
            return
        self._unsaved = ""
        self._folder.event("checkpoint" if full else "weights", step=step)

    def _log_q_alarm(self) -> None:
        """Log, once a run, values beyond all possible returns: learning has diverged."""
        reward, learn = self._folder.config.reward, self._settings
        largest = learn.reward_scale * (
            reward.crash + max(reward.base, reward.penalty) / (1.0 - learn.gamma)
        )
        value = self.learner.max_abs_q
        if value > Q_ALARM * largest and not self._q_alarm:
            self._q_alarm = True
            # JSON has no infinity.
            shown = value if math.isfinite(value) else str(value)
            step = self.learner.num_timesteps
            self._folder.event("q_alarm", step=step, max_abs_q=shown, largest=largest)

    def _save_interrupted(self) -> InterruptedRunError | DiskFullError:
        """Save the end of a run that was stopped; the error to raise after it."""
        # From here on a second signal requests what is already under way.
        self._stop.ending = True
        self._save_end("interrupted")
        path = self._folder.path
        done = f"{self.learner.num_timesteps} of {self._settings.total_steps} steps"
        if not self._unsaved:
            return InterruptedRunError(
                f"stopped after {done}; {path} holds the policy so far; continue it: "
                f"{format_resume_command(path)}"
            )
        return DiskFullError(
            f"stopped after {done}; the policy so far is saved, but the last checkpoint could not "
            f"be written ({self._unsaved}): {format_resume_command(path)} continues from the one "
            "before it, or starts again if there is none; free some disk space"
        )

    def _save_end(self, status: Literal["done", "interrupted"]) -> None:
        """Save the final policy and the status, and report the last step."""
        step = self.learner.num_timesteps
        self._save_policy("final")
        self._report_progress()
        self._folder = self._folder.with_status(status, step)
        self._folder.event(status, step=step)

    def _report_progress(self) -> None:
        self._progress(
            TrainProgress(
                step=self.learner.num_timesteps,
                total_steps=self._settings.total_steps,
                phase=int(self.learner.phase),
                episodes=self._episodes.episodes,
                crashes=self._episodes.crashes,
                kpi1=self._episodes.kpi1,
            )
        )


def _next_multiple(step: int, every: int) -> int:
    return (step // every + 1) * every
