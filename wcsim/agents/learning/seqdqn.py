"""SeqDQN: the double deep Q-learner of wcsim, an algorithm of Stable-Baselines3.

On top of SB3's DQN: double-Q targets, n-step returns from `FrameReplay`, scaled rewards, a soft
target update per gradient step, the large-margin loss of DQfD (Hester et al. 2018) that makes the
first phase supervised, advice from the oracle in the second (`aid`, beyond the paper), exploration
near the user's joystick, and random draws from a generator of its own. `learn`, callbacks, logger,
`save`, `load` and `EvalCallback` are SB3's. A network that carries a state
(`NetSpec.stateful`) does so from tick to tick of an episode, and learns from groups of steps
in a row (see `agents/learning/replay/groups.py`); any other one learns from steps drawn one by one,
each with its window.
"""

from collections.abc import Callable
from typing import Any, ClassVar, Final

import numpy as np
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import DictReplayBufferSamples, GymEnv
from stable_baselines3.common.utils import polyak_update
from torch import Tensor
from torch.nn import functional

from wcsim.agents.learning.phases import LearningPhase, PhasePlan
from wcsim.agents.learning.replay.buffer import FrameReplay
from wcsim.agents.learning.replay.groups import SequenceBatch, Tensors
from wcsim.agents.networks.q_network import Array, QNet, Seen, SeqQPolicy, States
from wcsim.agents.policy_api import IMU_KEY, JOYSTICK_KEY
from wcsim.config import LearnConfig
from wcsim.core import seeding
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.supervisor.observation import count_imu_values
from wcsim.types import F32, F64, I64, Bool

Signs = tuple[tuple[str, tuple[float, ...]], ...]  # of each number of each further sensor, by name

EXPLORED_SIGMA: Final = 0.5  # spread of local exploration, in stick units
MARGIN_OFFSET: Final = 0.4  # joystick distance that a margin adds to that between two actions
MAX_SKIPPED: Final = 10  # updates in a row with a loss or gradient that is not finite

# Advice. Crashes are rare, a few in a kilometre, but the oracle knows of every step which actions
# end badly.
AID_BATCH: Final = 32  # steps of oracle data in a batch
AID_SHARE: Final = 0.3  # of that batch from steps with an action that leads to a crash
AID_AHEAD: Final = 5  # steps before that in which an action already counts as unsafe
AID_MARGIN: Final = 6.0  # joystick distance by which an unsafe action must lose to a safe one
RELABELLED: Final = 0.5  # share of that batch with a random joystick in the user's place
HALF_CELL: Final = 0.125  # of the actions' lattice

# Mirrored batches: left and right are alike for a chair with its camera in the middle, so data
# count twice.
IMU_SIGNS: Final = (1.0, -1.0, 1.0, -1.0, 1.0)  # of ax, ay, az, roll, pitch
GYRO_SIGNS: Final = (-1.0, 1.0, -1.0)
YAW_SIGNS: Final = (-1.0, 1.0)  # of its sine and cosine
JOYSTICK_SIGNS: Final = (-1.0, 1.0)
_SIGNS: Final = {  # of the IMU's row, by its length
    count_imu_values(gyro, yaw): IMU_SIGNS + gyro * GYRO_SIGNS + yaw * YAW_SIGNS
    for gyro in (False, True)
    for yaw in (False, True)
}


class SeqDQN(DQN):
    """Double DQN over wcsim's observations.

    Args:
        policy: See SB3.
        env: See SB3.
        settings: What it has beside SB3's DQN.
        actions: Name of the set of joystick positions.
        mirror_signs: Of the sensors of [sensors], for batches that are mirrored.
        seed: Of all that is drawn.
        **dqn: Of SB3's DQN.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"SeqQPolicy": SeqQPolicy}
    q_net: QNet  # type: ignore[assignment]
    q_net_target: QNet  # type: ignore[assignment]
    replay_buffer: FrameReplay
    _last_obs: dict[str, Array]

    def __init__(
        self,
        policy: str | type[SeqQPolicy],
        env: GymEnv | str,
        *,
        settings: LearnConfig | None = None,
        actions: str = "square81",
        mirror_signs: Signs = (),
        seed: int | None = None,
        _init_setup_model: bool = True,
        **dqn: Any,
    ) -> None:
        # SB3's `save` writes all attributes under their names, those with an underscore too.
        self.settings = settings or LearnConfig()
        self.actions = actions
        self.mirror_signs = mirror_signs
        self.plan = PhasePlan(self.settings)
        self.rng = seeding.make_rng(0 if seed is None else seed, "agent", "explore")
        self._offsets: F64 = np.zeros((0, 2))  # (N, 2) explored by each seat
        # (N,) steps for which they are still held
        self._held: I64 = np.zeros(0, np.int64)
        # What the network carries from step to step, of every seat: before the next step (None
        # where all episodes start) and after it.
        self._carried: States | None = None
        self._next: States | None = None
        # (N,) the best actions in the next step, where they are known
        self._greedy: Array | None = None
        self.skipped_updates = 0
        self.max_abs_q = 0.0
        self.last_loss = float("nan")
        self.meanwhile = False  # whether the environment does the due updates within its step
        # Gradient steps and batch size of updates that were put off.
        self.due: tuple[int, int] | None = None
        dqn.setdefault("replay_buffer_class", FrameReplay)
        super().__init__(policy, env, seed=seed, _init_setup_model=_init_setup_model, **dqn)

    def _setup_model(self) -> None:
        super()._setup_model()
        if self.replay_buffer.groups is not None:
            self.replay_buffer.groups.state_size = self.q_net.encoder.state_size

    @property
    def action_points(self) -> ActionSet:
        """The joystick positions of the actions."""
        return action_set(self.actions)

    @property
    def phase(self) -> LearningPhase:
        """Whose joystick is executed at the present step."""
        return self.plan.phase(self.num_timesteps)

    # --- acting ---

    def predict(
        self,
        observation: Seen,
        state: States | None = None,
        episode_start: Array | None = None,
        deterministic: bool = False,
    ) -> tuple[Array, States | None]:
        """Greedy actions; unless deterministic, each seat explores by a draw of its own."""
        actions, state = self.policy.predict(observation, state, episode_start, deterministic=True)
        if deterministic or not isinstance(observation, dict):
            return actions, state
        self._greedy = np.atleast_1d(actions)
        sticks = np.asarray(observation[JOYSTICK_KEY], np.float64).reshape(-1, 2)
        explores = self._draw_explorers(len(sticks))
        if self.settings.exploration == "uniform":
            drawn = self.rng.integers(0, len(self.action_points), len(sticks))
        else:
            drawn = self.action_points.nearest_many(np.clip(sticks + self._offsets, -1.0, 1.0))
        explored = np.where(explores, drawn, actions)
        return (explored if np.ndim(actions) else explored[0]), state

    def _draw_explorers(self, seats: int) -> Bool:
        """Draw which seats explore now, (N,), and the offsets of those that start to.

        An exploration lasts `epsilon_hold` steps, so it starts that much more rarely.
        """
        hold = self.settings.epsilon_hold
        if len(self._held) != seats:
            self._held = np.zeros(seats, np.int64)
            self._offsets = np.zeros((seats, 2))
        rate = self.exploration_rate / (hold - (hold - 1) * self.exploration_rate)
        starts = (self._held == 0) & (self.rng.random(seats) < rate)
        drawn = self.rng.normal(0.0, EXPLORED_SIGMA, (seats, 2))
        self._offsets = np.where(starts[:, None], drawn, self._offsets)
        self._held = np.where(starts, hold, self._held)
        explores: Bool = self._held > 0
        self._held = np.maximum(self._held - 1, 0)
        return explores

    def _sample_action(self, *given: Any, **named: Any) -> tuple[Array, Array]:
        """Phase 1: the user's nearest action.

        Phase 2: greedy with exploration, from the first step on.
        """
        observation = self._last_obs
        if self.phase is LearningPhase.ACTION_DRIVEN:
            actions = self.action_points.nearest_many(observation[JOYSTICK_KEY])
            # A network with a state has to see what is driven.
            if self.q_net.spec.stateful:
                self._greedy, self._next = self.policy.predict(
                    observation, self._carried, deterministic=True
                )
        else:
            actions, self._next = self.predict(observation, self._carried, deterministic=False)
        if not self.meanwhile:
            self.catch_up()
        return actions, actions

    def greedy(self, observation: dict[str, Array]) -> Array:
        """The network's best actions in the present step, (N,), whatever is executed."""
        if self._greedy is not None:
            return self._greedy
        return self.policy.predict(observation, deterministic=True)[0]

    def learned_rewards(self, actions: Array, rewards: Array) -> Array:
        """Rewards (N,) of the present step, less what following pays if the head knows that."""
        if self.q_net.spec.head != "residual":
            return rewards
        sticks = torch.as_tensor(self._last_obs[JOYSTICK_KEY], device=self.device)
        known = self.q_net.follow_reward(sticks).cpu().numpy() / self.settings.reward_scale
        rest: Array = rewards - known[np.arange(len(known)), np.asarray(actions).reshape(-1)]
        return rest

    def _store_transition(self, replay_buffer: ReplayBuffer, *step: Any) -> None:
        """Store a step and the state before it; seats whose episode ended lose their state."""
        actions, new, rewards, *others = step
        step = actions, new, self.learned_rewards(actions, rewards), *others
        groups = self.replay_buffer.groups
        if groups is not None and self._carried is not None:
            groups.next_states = self._carried[0]
        super()._store_transition(replay_buffer, *step)
        if self._next is not None:
            dones = np.asarray(step[3], bool)[:, None]
            self._carried = tuple(
                np.where(dones, 0.0, part).astype(part.dtype) for part in self._next
            )

    def _setup_learn(self, *given: Any, **named: Any) -> tuple[int, BaseCallback]:
        """SB3's; where it resets the environment, episodes start. Rates are of the next step."""
        before = self._last_obs
        out = super()._setup_learn(*given, **named)
        if self._last_obs is not before:
            self._carried = None
        # SB3 sets both after a step, too late for the first one.
        if self._total_timesteps > self.num_timesteps:
            self._update_current_progress_remaining(self.num_timesteps, self._total_timesteps)
            self.exploration_rate = self.plan.epsilon(self.num_timesteps)
        return out

    def _on_step(self) -> None:
        """Set the exploration rate; unlike SB3's, the target network follows the gradient steps."""
        self.exploration_rate = self.plan.epsilon(self.num_timesteps)
        self.logger.record("rollout/exploration_rate", self.exploration_rate)

    # --- learning ---

    def train(self, gradient_steps: int, batch_size: int = 32) -> None:
        """Do `gradient_steps` updates, now or after the next action. Raises as `do_updates`."""
        if self.settings.updates == "while_waiting":
            self.catch_up()
            self.due = gradient_steps, batch_size
        else:
            self.do_updates(gradient_steps, batch_size)

    def due_updates(self) -> Callable[[], None] | None:
        """The call that does the updates which were put off; None without any.

        They are done between the choice of an action and its outcome, by the environment while it
        waits for the world (`meanwhile`) or before it moves. Either way the action was
        chosen by the weights before them, and they draw from the steps before it.
        """
        return None if self.due is None else self.catch_up

    def catch_up(self) -> None:
        """Do the updates that were put off, if there are any. Raises as `do_updates`."""
        if self.due is not None:
            due, self.due = self.due, None
            self.do_updates(*due)

    def do_updates(self, gradient_steps: int, batch_size: int) -> None:
        """Do so many updates. Raises PolicyError when loss or gradient stay not finite.

        Each draws its batch of steps with the memory's generator, then with `self.rng` whether it
        is mirrored; after that the steps that the oracle has judged, with the memory's, then with
        `self.rng` their joysticks and mirror.
        """
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        margin = self.plan.margin_weight(self.num_timesteps)
        aid = self.plan.aid_weight(self.num_timesteps)
        for _ in range(gradient_steps):
            # 1. A batch, its targets, and the Huber loss; in the first phase also the loss towards
            # the user's action.
            loss = self._draw_batch_loss(batch_size, margin)
            # 2. In the second phase, with aid, the loss of a batch that the oracle has judged.
            if aid > 0.0:
                loss = loss + aid * self.draw_advice_loss()
            # 3. A step along the gradient, and the target network's little step after it.
            self._update(loss)
        # Until the next update it chooses actions, one observation at a time.
        self.policy.set_training_mode(False)
        self._n_updates += gradient_steps
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/loss", self.last_loss)
        self.logger.record("train/max_abs_q", self.max_abs_q)
        self.logger.record("train/margin_weight", margin)
        self.logger.record("train/aid_weight", aid)

    def _draw_batch_loss(self, batch_size: int, margin: float) -> Tensor:
        """Draw a batch from memory; its loss.

        Groups of steps for a network with a state, else single steps.
        """
        if self.q_net.spec.stateful:
            batch = self.replay_buffer.sample_groups(batch_size)
            nets = self.q_net, self.q_net_target
            supervised = (
                (lambda *seen: margin * self.supervised_loss(*seen)) if margin > 0.0 else None
            )
            scale, double_q = self.settings.reward_scale, self.settings.double_q
            loss, self.max_abs_q = _sequence_loss(nets, batch, scale, double_q, supervised)
            return loss
        drawn = self.replay_buffer.sample(batch_size)
        if self._draw_mirrored():
            drawn = _mirror_batch(drawn, self._mirror_map(), self.mirror_signs)
        return self.loss(drawn, margin)

    def loss(self, batch: DictReplayBufferSamples, margin: float) -> Tensor:
        """Huber loss of the n-step double-Q error, plus that towards the user's action."""
        target = self.targets(batch)
        values = self.q_net(batch.observations)
        self.max_abs_q = float(values.detach().abs().max())
        learned = self.q_net.learned(values, batch.observations)
        chosen = learned.gather(1, batch.actions.long())
        loss = functional.smooth_l1_loss(chosen, target)
        if margin > 0.0:
            loss = loss + margin * self.supervised_loss(values, batch.observations)
        return loss

    @torch.no_grad()
    def targets(self, batch: DictReplayBufferSamples) -> Tensor:
        """Scaled n-step returns plus the discounted value after them, (B, 1)."""
        after = self.q_net_target(batch.next_observations)
        chooser = self.q_net(batch.next_observations) if self.settings.double_q else after
        learned = self.q_net.learned(after, batch.next_observations)
        value = learned.gather(1, chooser.argmax(dim=1, keepdim=True))
        discounts = self.gamma if batch.discounts is None else batch.discounts
        return torch.as_tensor(
            self.settings.reward_scale * batch.rewards + (1.0 - batch.dones) * discounts * value
        )

    def supervised_loss(self, values: Tensor, observations: Tensors) -> Tensor:
        """The loss towards the user's action, for weight 1.

        A margin, or the cross-entropy of values in unscaled reward.
        """
        if self.settings.phase1 != "supervised":
            return self.margin_loss(values, observations)
        label = self.q_net.distances(observations[JOYSTICK_KEY]).argmin(dim=1)
        return functional.cross_entropy(values / self.settings.reward_scale, label)

    def margin_loss(self, values: Tensor, observations: Tensors) -> Tensor:
        """How far the user's action is from beating every other by a margin.

        The margin grows with the joystick distance.
        """
        distances = self.q_net.distances(observations[JOYSTICK_KEY])
        label = distances.argmin(dim=1, keepdim=True)
        gap = distances - distances.gather(1, label) + MARGIN_OFFSET
        margin = (self.settings.reward_scale * gap).scatter(1, label, 0.0)
        return ((values + margin).max(dim=1).values - values.gather(1, label)[:, 0]).mean()

    def draw_advice_loss(self) -> Tensor:
        """Draw steps whose actions the oracle has judged; their loss, 0 while there is none."""
        advice = self.replay_buffer.sample_advice(AID_BATCH, AID_SHARE, AID_AHEAD)
        if advice is None:
            return torch.zeros((), device=self.device)
        seen, safe = advice
        sticks = _draw_other_sticks(
            seen[JOYSTICK_KEY].cpu().numpy(), self.action_points.points, RELABELLED, self.rng
        )
        seen = {**seen, JOYSTICK_KEY: torch.as_tensor(sticks, device=self.device)}
        if self._draw_mirrored():
            actions = self._mirror_map()
            seen, safe = _mirrored(seen, actions, self.mirror_signs), safe[:, actions]
        distances = self.q_net.distances(seen[JOYSTICK_KEY])
        return _aid_loss(self.q_net(seen), distances, safe, self.settings.reward_scale, AID_MARGIN)

    def _draw_mirrored(self) -> bool:
        """Draw whether the next batch is mirrored; without `mirror` nothing is drawn."""
        return self.settings.mirror and bool(self.rng.random() < 0.5)

    def _mirror_map(self) -> Tensor:
        return torch.as_tensor(self.action_points.mirror, device=self.device)

    def _update(self, loss: Tensor) -> None:
        """Step along the gradient. Raises PolicyError when too many in a row were not finite."""
        self.last_loss = float(loss.detach())
        finite = np.isfinite(self.last_loss)
        if finite:
            self.policy.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            # Its norm before it is clipped: an infinite gradient cannot be clipped.
            norm = torch.nn.utils.clip_grad_norm_(self.q_net.parameters(), self.max_grad_norm)
            finite = np.isfinite(float(norm))
        if finite:
            self.skipped_updates = 0
            self.policy.optimizer.step()
            polyak_update(self.q_net.parameters(), self.q_net_target.parameters(), self.tau)
            # Running means are no parameters.
            polyak_update(self.batch_norm_stats, self.batch_norm_stats_target, 1.0)
            return
        # The weights stay as they are: one such step would spoil them for good.
        self.skipped_updates += 1
        if self.skipped_updates > MAX_SKIPPED:
            raise PolicyError(
                f"the loss, {self.last_loss}, or its gradient was not finite for "
                f"{self.skipped_updates} updates in a row; expected finite numbers: start a new "
                "run with a smaller learn.learning_rate or learn.reward_scale"
            )


# Losses over groups of steps in a row. Both networks run over the steps before a group without a
# gradient, from the stored state, and then over the group and what its last n-step returns reach.


def _sequence_loss(
    nets: tuple[QNet, QNet],
    batch: SequenceBatch,
    reward_scale: float,
    double_q: bool,
    supervised: Callable[[Tensor, Tensors], Tensor] | None,
) -> tuple[Tensor, float]:
    """Huber loss over the steps of the groups, and the largest value that was met.

    Args:
        nets: Online and target network.
        batch: Groups.
        reward_scale: Of the returns.
        double_q: The online network chooses the action whose value the target network gives.
        supervised: Added to it: of values (N, A) and the joysticks that they are for, by their key.
    """
    online = _group_values(nets[0], batch)
    with torch.no_grad():
        target = _group_values(nets[1], batch)
        judge = online if double_q else target
        rest = nets[1].learned(target, batch.observations)
        goals = _group_targets(judge, rest, batch, reward_scale)[batch.live]
    length = batch.live.shape[1]
    live = batch.live[:, : online.shape[1]]
    values = online[:, :length][live]  # (N, A)
    learned = nets[0].learned(online, batch.observations)[:, :length][live]
    chosen = learned.gather(1, batch.actions[batch.live][:, None])[:, 0]
    loss = functional.smooth_l1_loss(chosen, goals)
    if supervised is not None:
        sticks = batch.observations[JOYSTICK_KEY][:, :length][live]
        loss = loss + supervised(values, {JOYSTICK_KEY: sticks})
    return loss, float(values.detach().abs().max())


def _group_values(net: QNet, batch: SequenceBatch) -> Tensor:
    """Values (K, P, A) of all observations of the groups."""
    return net.unroll(batch.observations, _burned_in(net, batch))[0]


@torch.no_grad()
def _burned_in(net: QNet, batch: SequenceBatch) -> Tensor:
    """The network's state (K, S) where the groups begin."""
    states = batch.states.clone()
    for rows, observations in batch.burn_in:
        states[rows] = net.unroll(observations, states[rows])[1]
    return states


def _group_targets(
    judge: Tensor, target: Tensor, batch: SequenceBatch, reward_scale: float
) -> Tensor:
    """Scaled n-step returns plus the discounted value after them, (K, L).

    Both are (K, P, A): values that choose an action, and the target network's of it.
    """
    best = target.gather(2, judge.argmax(dim=2, keepdim=True))[..., 0]  # (K, P)
    value = best.gather(1, batch.after)
    return reward_scale * batch.returns + (1.0 - batch.terminated) * batch.discounts * value


# Advice


def _draw_other_sticks(
    joysticks_xy: F32, points: F64, share: float, rng: np.random.Generator
) -> F32:
    """Draw other joysticks for the same moments: which actions are safe does not depend on them.

    A share of the rows (B, 2) gets the joystick near one of `points` (A, 2) instead, in the unit
    disc; so a moment in which the user happened to be right teaches too.
    """
    drawn = points[rng.integers(0, len(points), len(joysticks_xy))]
    drawn = drawn + rng.uniform(-HALF_CELL, HALF_CELL, drawn.shape)
    drawn /= np.maximum(np.hypot(drawn[:, 0], drawn[:, 1]), 1.0)[:, None]
    replaced = rng.random(len(drawn)) < share
    return np.where(replaced[:, None], drawn, joysticks_xy).astype(np.float32)


def _aid_loss(
    values: Tensor, distances: Tensor, safe: Tensor, scale: float, unsafe: float
) -> Tensor:
    """How far the safe action nearest to the user's joystick is from winning by a margin.

    The strongest rival counts as in DQfD; every unsafe action counts too, so that one step teaches
    about all of them. A row in which nothing is safe teaches nothing: what it would teach is to
    stand still. Only this loss knows the oracle's verdicts; the policy that learns from it sees
    what every policy sees.

    Args:
        values: (B, A) action values.
        distances: (B, A) joystick distance of every action from the user's.
        safe: (B, A) bool, which actions end well.
        scale: Of the reward; margins are joystick distances times this.
        unsafe: Joystick distance that the margin adds for an action that ends badly.

    Returns:
        A scalar, 0 when every row has its teacher's action ahead by the margins.
    """
    label = _teacher_actions(distances, safe)[:, None]
    farther = (distances - distances.gather(1, label)).clamp(min=0.0)
    margin = (scale * (farther + MARGIN_OFFSET + unsafe * ~safe)).scatter(1, label, 0.0)
    behind = functional.relu(values + margin - values.gather(1, label))  # (B, A), 0 at the label
    dense = (behind * ~safe).sum(dim=1) / (~safe).sum(dim=1).clamp(min=1)
    return ((behind.max(dim=1).values + dense) * safe.any(dim=1)).mean()


def _teacher_actions(distances: Tensor, safe: Tensor) -> Tensor:
    """The safe action nearest to the user's joystick; (B, A) and (B, A) -> (B,)."""
    return distances.masked_fill(~safe, torch.inf).argmin(dim=1)


# The mirror


def _mirror_batch(
    batch: DictReplayBufferSamples, actions: Tensor, signs: Signs = ()
) -> DictReplayBufferSamples:
    """A batch with left and right exchanged; `actions` (A,) is the mirror map of the action set."""
    return batch._replace(
        observations=_mirrored(batch.observations, actions, signs),
        actions=actions[batch.actions.long()],
        next_observations=_mirrored(batch.next_observations, actions, signs),
    )


def _mirrored(observations: Tensors, actions: Tensor, further: Signs) -> Tensors:
    out = dict(observations)
    for key, value in observations.items():
        # Pictures alone: the others are rows of numbers.
        if value.ndim > 2:
            out[key] = value.flip(-1)
    imu_signs = _SIGNS[observations[IMU_KEY].shape[-1]]
    for key, signs in ((IMU_KEY, imu_signs), (JOYSTICK_KEY, JOYSTICK_SIGNS), *further):
        out[key] = observations[key] * observations[key].new_tensor(signs)
    return out
