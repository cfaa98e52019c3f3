"""Section `[learn]`: the learner."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from wcsim.config.base import Model, NotNegative, Positive, Share, Text, Word

Steps = Annotated[int, Field(ge=1, le=10**9)]

StepsOrNone = Annotated[int, Field(ge=0, le=10**9)]


class LearnConfig(Model):
    """Both learning phases."""

    total_steps: Steps = 20_000
    phase1_steps: StepsOrNone = 5_000
    network: Word = "small"
    head: Literal["residual", "plain", "danger"] = "residual"
    # A run or policy folder of a danger network that stays as it is; values are learned on top, with head="residual".
    danger: Annotated[Text, Field(exclude_if=lambda path: not path)] = ""
    danger_weight: Annotated[NotNegative, Field(exclude_if=lambda weight: weight == 1.0)] = 1.0  # in scaled reward
    gamma: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.97
    learning_rate: Positive = 3e-4
    learning_rate_fade: Share = 0.0  # last share of the run, over which the learning rate falls to zero
    batch_size: Annotated[int, Field(ge=1, le=4096)] = 32
    replay_frames: Annotated[int, Field(ge=100, le=10**7)] = 50_000
    learning_starts: StepsOrNone = 500
    train_every: Annotated[int, Field(ge=1, le=10**4)] = 4
    gradient_steps: Annotated[int, Field(ge=1, le=10**4)] = 1
    n_step: Annotated[int, Field(ge=1, le=50)] = 5
    tau: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    reward_scale: Positive = 0.05
    clip_norm: Positive = 10.0
    double_q: bool = True
    margin: NotNegative = 1.0
    margin_fade: Share = 0.25
    precrash_share: Share = 0.25
    precrash_window: Annotated[int, Field(ge=1, le=10**6)] = 20
    exploration: Literal["local", "uniform"] = "local"
    epsilon_start: Share = 0.2
    epsilon_end: Share = 0.05
    epsilon_sigma: Positive = 0.5
    epsilon_hold: Annotated[int, Field(ge=1, le=100)] = 1  # steps that an explored offset from the stick is held
    aid: Literal["none", "oracle"] = "none"  # beyond the paper: safe actions from the privileged truth, in training
    aid_weight: NotNegative = 1.0
    aid_batch: Annotated[int, Field(ge=1, le=4096)] = 32
    aid_margin: NotNegative = 1.0  # joystick distance by which an unsafe action must lose more than a safe one
    aid_share: Share = 0.5  # of the aid's batch, from steps in which some action ends badly
    aid_ahead: Annotated[int, Field(ge=0, le=50)] = 0  # steps before it ends badly in which an action is unsafe already
    aid_relabel: Share = 0.5  # of the aid's batch, with another joystick than the user's
    mirror: bool = False  # batches are mirrored left to right half of the time
    checkpoint_every: Steps = 5_000
    threads: Annotated[int, Field(ge=1, le=64)] = 1
    device: Word = "cpu"
    episode_steps: Annotated[int, Field(ge=1, le=1_000_000)] = 1_000
