"""Section `[learn]`: the learner."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from wcsim.config.base import Model, NotNegative, Positive, Share, Text, Word

Steps = Annotated[int, Field(ge=1, le=10**9)]

PROCESS_GROWTH_MB = 400.0

UpdateTime = Literal["before_acting", "while_waiting"]

StepsOrNone = Annotated[int, Field(ge=0, le=10**9)]


class LearnConfig(Model):
    """Both learning phases."""

    total_steps: Steps = 20_000  # of both phases
    phase1_steps: StepsOrNone = 5_000  # in which the user's action is executed
    phase1: Annotated[Literal["margin", "supervised", "td"], Field(exclude_if=lambda how: how == "margin")] = (
        "margin"  # what teaches the first phase beside TD: a margin, cross-entropy (supervised), or nothing (td)
    )
    select_by: Annotated[Word, Field(exclude_if=lambda suite: not suite)] = (
        ""  # suite or list that chooses which of several clients learns the second phase; none: all do
    )
    network: Word = "small"  # by name (wcsim networks), or module:Class
    head: Literal["residual", "plain", "danger"] = "residual"  # follow reward and a rest, values alone, or dangers
    danger: Annotated[Text, Field(exclude_if=lambda path: not path)] = (
        ""  # run or policy folder of a danger network that stays as it is; values are learned on top (head="residual")
    )
    danger_weight: Annotated[NotNegative, Field(exclude_if=lambda weight: weight == 1.0)] = (
        1.0  # of its dangers, in scaled reward
    )
    gamma: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.97  # above 0.991 crashing pays better than waiting
    learning_rate: Positive = 3e-4  # Adam's
    learning_rate_fade: Share = 0.0  # last share of the run, over which the learning rate falls to zero
    batch_size: Annotated[int, Field(ge=1, le=4096)] = 32  # steps in an update
    replay_frames: Annotated[int, Field(ge=100, le=10**7)] = 50_000  # steps that are remembered
    process_growth_mb: Annotated[float, Field(ge=10.0, le=10**6, exclude_if=lambda mb: mb == PROCESS_GROWTH_MB)] = (
        PROCESS_GROWTH_MB  # of memory, beyond a full replay, that a client may take before a fresh process goes on
    )
    replay_store: Literal["memory", "disk"] = "memory"  # where the frames are; disk: in the run folder
    memory: Literal["steps", "groups", "windows"] = "steps"  # what is drawn; docs/replay.md
    group_steps: Annotated[int, Field(ge=1, le=1_000)] = 16  # of a group of steps in a row
    burn_in: Annotated[int, Field(ge=0, le=1_000)] = 8  # steps before a group that are run again without loss
    learning_starts: StepsOrNone = 500  # steps before the first update
    train_every: Annotated[int, Field(ge=1, le=10**4)] = 4  # steps between updates
    gradient_steps: Annotated[int, Field(ge=1, le=10**4)] = 1  # updates at a time
    updates: Annotated[UpdateTime, Field(exclude_if=lambda when: when == "before_acting")] = (
        "before_acting"  # when those that are due are done: while_waiting, after the next action was said
    )
    n_step: Annotated[int, Field(ge=1, le=50)] = 5  # rewards before the value is taken
    tau: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01  # share by which the target network follows in an update
    reward_scale: Positive = 0.05  # times the reward: values stay in the range of a few
    clip_norm: Positive = 10.0  # largest norm of a gradient
    double_q: bool = True  # Double DQN; false: DQN
    margin: NotNegative = 1.0  # weight of the loss towards the user's action
    margin_fade: Share = 0.25  # share of the second phase in which it fades to nothing
    precrash_share: Share = 0.25  # of a batch, from steps shortly before crashes
    precrash_window: Annotated[int, Field(ge=1, le=10**6)] = 20  # steps before a crash that count as such
    exploration: Literal["local", "uniform"] = "local"  # near the user's stick, or any action
    epsilon_start: Share = 0.2  # share of explored steps as the second phase begins
    epsilon_end: Share = 0.05  # and as it ends
    epsilon_sigma: Positive = 0.5  # spread of local exploration, in stick units
    epsilon_hold: Annotated[int, Field(ge=1, le=100)] = 1  # steps that an explored offset from the stick is held
    aid: Literal["none", "oracle"] = "none"  # beyond the paper: safe actions from the privileged truth, in training
    aid_weight: NotNegative = 1.0  # of the advice's loss in the second phase
    aid_batch: Annotated[int, Field(ge=1, le=4096)] = 32  # steps of advice in an update
    aid_margin: NotNegative = 1.0  # joystick distance by which an unsafe action must lose more than a safe one
    aid_share: Share = 0.5  # of the aid's batch, from steps in which some action ends badly
    aid_ahead: Annotated[int, Field(ge=0, le=50)] = 0  # steps before it ends badly in which an action is unsafe already
    aid_relabel: Share = 0.5  # of the aid's batch, with another joystick than the user's
    mirror: bool = False  # batches are mirrored left to right half of the time
    tensorboard: Annotated[bool, Field(exclude_if=lambda on: not on)] = False  # scalars too, where it is installed
    checkpoint_every: Steps = 5_000  # steps
    threads: Annotated[int, Field(ge=1, le=64)] = 1  # of PyTorch
    device: Word = "cpu"  # cpu, or cuda
    episode_steps: Annotated[int, Field(ge=1, le=1_000_000)] = 1_000  # longest episode

    @model_validator(mode="after")
    def _can_wait(self) -> LearnConfig:
        if self.updates == "while_waiting" and self.head == "danger":
            raise ValueError(
                "learn.updates=while_waiting with learn.head=danger; expected before_acting: only learners by "
                "Q-learning do their updates while they wait"
            )
        return self
