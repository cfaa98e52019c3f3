"""Sections `[learn]`, `[danger]` and `[collect]`: the learner, its danger head, and its data."""

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from wcsim.config.base import (
    Model,
    NotNegative,
    Positive,
    PositiveShare,
    Share,
    Text,
    Texts,
    Word,
    exclude_if,
    within,
)
from wcsim.config.env import EpisodeSteps

PROCESS_GROWTH_MB: Final = 400.0

Count = Annotated[int, within(1, 100_000)]
Steps = Annotated[int, within(1, 10**9)]
UpdateTime = Literal["before_acting", "while_waiting"]
StepsOrNone = Annotated[int, within(0, 10**9)]


class DangerConfig(Model):
    """The danger network: its parts, its training, and its rule."""

    width: Annotated[int, within(4, 256)] = 20  # Channels of the first layer.
    updates: Annotated[int, within(1, 10**7)] = 1500  # Updates in a round.
    batch: Annotated[int, within(2, 4096)] = 64  # Steps in a batch.
    learning_rate: Positive = 2e-3  # Learning rate of Adam.
    weight_decay: NotNegative = 1e-3  # Weight decay of Adam.
    tight_share: Share = 0.5  # Share of a batch from steps with an unsafe action.
    # Steps before danger in which an action already counts as unsafe.
    ahead: Annotated[int, within(0, 20)] = 1
    # Labels: an oracle limited to what cameras showed, an all-knowing one, crashes that happened,
    # or what Table 2 paid afterwards, but for sticks.
    teacher: Literal["visible", "truth", "crashes", "returns"] = "visible"
    threshold: PositiveShare = 0.2  # Assistance level. Actions with a higher danger are blocked.
    # Danger that blocks the user's action in one tick. Below it two in a row do. 0: always one.
    at_once: Share = 0.0
    # Warns above this danger of the user's own stick, smoothed over about three ticks.
    warn: Share = 0.3


class CollectConfig(Model):
    """Driving for training data: where, by which users, and with how many perturbations."""

    rounds: Count = 2  # Rounds of driving and learning.
    # Segments of driving in a round. 0: learn only from recorded data.
    segments: Annotated[int, within(0, 100_000)] = 6
    ticks: Annotated[int, within(10, 100_000)] = 400  # Ticks in a segment.
    chairs: Annotated[int, within(1, 12)] = 6  # Chairs in its world.
    episode_steps: Count = 300  # Longest episode.
    towns: Texts = ()  # Towns used in turn with those of --town.
    # Number of towns that `wcsim town make` generates for this run.
    made_towns: Annotated[int, within(0, 1000)] = 0
    data: Texts = ()  # Folders of `wcsim collect` to learn from as well.
    # Share of chairs in towns that begin before a kerb, or off their ways.
    off_way_share: Share = 0.5
    # Share of segments in generated scenes: hidden road users and narrow places.
    scene_share: Share = 0.3
    # Simulated users to draw from.
    profiles: Annotated[tuple[Text, ...], Field(min_length=1, max_length=64)] = (
        "inattentive", "tremor", "slow", "competent", "switch",
    )  # fmt: skip
    variants: Texts = ()  # Settings separated by blanks, drawn per segment.
    # Of episodes without the network: share that the user drives. The oracle drives the rest.
    follow_share: Share = 0.4
    network_share: Share = 0.75  # Share of episodes that the network drives, once there is one.
    astray_share: Share = 0.33  # Share of time with a random offset on the stick.
    # Standard deviation of each component of that offset.
    astray_spread: Annotated[float, within(0.0, 2.0), exclude_if(0.5)] = 0.5
    # Shortest and longest time for which it is held.
    astray_ticks: Annotated[tuple[Count, Count], exclude_if((4, 12))] = (4, 12)

    @model_validator(mode="after")
    def _can_be_held(self) -> Self:
        if self.astray_ticks[0] > self.astray_ticks[1]:
            raise ValueError(
                f"collect.astray_ticks={list(self.astray_ticks)}; expected the shorter time first"
            )
        return self


class LearnConfig(Model):
    """Q-learning in two phases, and settings that all learners share."""

    total_steps: Steps = 20_000  # Steps of both phases.
    # Steps of the first phase, which executes the user's actions.
    phase1_steps: StepsOrNone = 5_000
    # Loss beside TD in the first phase: margin, cross-entropy (supervised), or none (td).
    phase1: Annotated[Literal["margin", "supervised", "td"], exclude_if("margin")] = "margin"
    # Selects the client for the second phase: kpi1, a client's name, a suite or list. Empty: all
    # continue.
    select_by: Annotated[Word, exclude_if("")] = ""
    # Time of a decision on one core above which a client is not selected, unless all are slower.
    select_ms: Annotated[Positive, exclude_if(100.0)] = 100.0
    network: Word = "patch"  # Network by name (wcsim networks), or module:Class.

    # Of three departures from the paper, the known reward alone keeps up with the user
    # (docs/learning.md).

    # Follow reward plus a residual, plain values, or dangers.
    head: Literal["residual", "plain", "danger"] = "residual"
    # Whether the head splits values into one of the state and advantages of the actions (dueling).
    duel: Annotated[bool, exclude_if(True)] = True
    # Discount factor. Above 0.991 crashing pays better than waiting.
    gamma: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.97
    learning_rate: Positive = 3e-4  # Learning rate of Adam.
    # Last share of the run in which the learning rate falls to zero.
    learning_rate_fade: Share = 0.0
    batch_size: Annotated[int, within(1, 4096)] = 32  # Steps in a batch.
    replay_frames: Annotated[int, within(100, 10**7)] = 50_000  # Steps in the replay memory.
    # Memory in MB, beyond a full replay, after which a client's process is restarted.
    process_growth_mb: Annotated[float, within(10.0, 10**6), exclude_if(PROCESS_GROWTH_MB)] = (
        PROCESS_GROWTH_MB
    )
    # What the replay samples (docs/learning.md).
    memory: Literal["steps", "groups", "windows"] = "steps"
    group_steps: Annotated[int, within(1, 1_000)] = 16  # Consecutive steps in a group.
    # Steps before a group that run without loss, to warm up the state.
    burn_in: Annotated[int, within(0, 1_000)] = 8
    learning_starts: StepsOrNone = 500  # Steps before the first update.
    train_every: Annotated[int, within(1, 10**4)] = 4  # Steps between updates.
    # When updates run: before an action, or while waiting for the world.
    updates: Annotated[UpdateTime, exclude_if("before_acting")] = "before_acting"
    n_step: Annotated[int, within(1, 50)] = 5  # Rewards summed before the value is used.
    tau: PositiveShare = 0.01  # Share by which an update moves the target network.
    reward_scale: Positive = 0.05  # Factor on the reward.
    double_q: bool = True  # Double DQN. False: DQN.
    margin: NotNegative = 1.0  # Weight of the margin loss towards the user's action.
    # In the paper the first phase alone has a loss towards the user.
    margin_fade: Share = 0.25  # Share of the second phase in which that loss fades to zero.
    precrash_share: Share = 0.25  # Share of a batch taken from steps before crashes.
    # Explore near the user's stick, or any action.
    exploration: Literal["local", "uniform"] = "local"
    epsilon_start: Share = 0.2  # Share of explored steps at the start of the second phase.
    epsilon_end: Share = 0.05  # Share of explored steps at its end.
    epsilon_hold: Annotated[int, within(1, 100)] = 1  # Steps for which an explored offset is held.
    # Whether training also uses safe actions from the oracle. Not in the paper.
    aid: Literal["none", "oracle"] = "none"
    aid_weight: NotNegative = 1.0  # Weight of the oracle's loss in the second phase.
    mirror: bool = False  # Whether half of the batches are mirrored left to right.
    # Whether to write TensorBoard scalars, if it is installed.
    tensorboard: Annotated[bool, exclude_if(False)] = False
    checkpoint_every: Steps = 5_000  # Steps between checkpoints.
    threads: Annotated[int, within(1, 64)] = 1  # Threads of PyTorch.
    device: Word = "cpu"  # cpu, or cuda.
    episode_steps: EpisodeSteps = 1_000  # Longest episode in training.

    @model_validator(mode="after")
    def _can_wait(self) -> Self:
        if self.updates == "while_waiting" and self.head == "danger":
            raise ValueError(
                "learn.updates=while_waiting with learn.head=danger; expected before_acting: only "
                "Q-learning can update while it waits"
            )
        return self
