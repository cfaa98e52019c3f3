"""The action-value network (encoder, head, known follow reward) and its policy object for SB3."""

from typing import Any, Final, cast

import numpy.typing as npt
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from stable_baselines3.dqn.policies import DQNPolicy
from torch import Tensor, nn

from wcsim.agents.networks.encoder import ObservationEncoder, Tensors, vector_size_from_space
from wcsim.agents.policy_api import JOYSTICK_KEY
from wcsim.config.run_file import NetSpec
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.rewards import DISTANCE_TOLERANCE

# The learned part starts this small, so that the known part decides from step 0.
_SMALL_INIT: Final = 0.05

Array = npt.NDArray[Any]
Seen = Array | dict[str, Array]
States = tuple[Array, ...]


class QNet(BasePolicy):
    """Values of all actions.

    With head `residual`: Q(s, a) = scaled follow reward(joystick, a) + F(s, a). What following
    pays is known of every action. So F is learned from the rest of the reward alone.
    """

    def __init__(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, spec: NetSpec
    ) -> None:
        super().__init__(observation_space, action_space, normalize_images=False)
        self.spec = spec
        self.encoder = ObservationEncoder(
            observation_space, spec.network, spec.classes, spec.stateful
        )
        count = int(action_space.n)
        inputs = self.encoder.features_dim + vector_size_from_space(observation_space)
        self.trunk = nn.Sequential(nn.Linear(inputs, spec.hidden), nn.ReLU())
        self.advantage = nn.Linear(spec.hidden, count)
        self.value = nn.Linear(spec.hidden, 1) if spec.dueling else None
        if spec.head == "residual":
            with torch.no_grad():
                self.advantage.weight.mul_(_SMALL_INIT)
                self.advantage.bias.zero_()
        points = torch.as_tensor(action_set(spec.actions).points, dtype=torch.float32)
        self.register_buffer("_points", points, persistent=False)  # (A, 2)

    def forward(self, observations: PyTorchObs) -> Tensor:
        """Values (B, A), in units of the scaled reward."""
        if not isinstance(observations, dict):
            raise TypeError(
                f"observations are {type(observations).__name__}; expected a dict of tensors"
            )
        return self._values(self.encoder(observations), observations)

    def begin(self, count: int) -> Tensor:
        """The state (B, S) at the start of so many episodes; S is 0 without a state."""
        return torch.zeros(count, self.encoder.state_size, device=self.device)

    def step(self, observations: Tensors, state: Tensor) -> tuple[Tensor, Tensor]:
        """Values (B, A) of one tick, and the state (B, S) after it."""
        values, after = self.unroll(
            {key: value[:, None] for key, value in observations.items()}, state
        )
        return values[:, 0], after

    def unroll(self, observations: Tensors, state: Tensor) -> tuple[Tensor, Tensor]:
        """Values (B, T, A) of T ticks in a row, and the state (B, S) after them.

        Observations are (B, T, ...), the state (B, S) is that before them.
        """
        shape = next(iter(observations.values())).shape[:2]
        flat = {key: value.flatten(0, 1) for key, value in observations.items()}
        if not self.spec.stateful:
            return torch.unflatten(self(flat), 0, shape), state
        features, after = self.encoder.unroll(observations, state)
        return torch.unflatten(self._values(features.flatten(0, 1), flat), 0, shape), after

    def _values(self, seen: Tensor, observations: Tensors) -> Tensor:
        hidden = self.trunk(torch.cat([seen, self.encoder.vector(observations)], dim=1))
        q = self.advantage(hidden)
        if self.value is not None:
            q = self.value(hidden) + q - q.mean(dim=1, keepdim=True)
        if self.spec.head == "residual":
            q = q + self.follow_reward(observations[JOYSTICK_KEY])
        return torch.as_tensor(q)

    def learned(self, values: Tensor, observations: Tensors) -> Tensor:
        """The part of values (..., A) that is learned: all, or F."""
        if self.spec.head != "residual":
            return values
        joysticks_xy = observations[JOYSTICK_KEY].reshape(-1, 2)
        return values - self.follow_reward(joysticks_xy).view_as(values)

    def distances(self, joysticks_xy: Tensor) -> Tensor:
        """Joystick distance of every action, (B, 2) -> (B, A)."""
        gap = joysticks_xy[:, None, :] - torch.as_tensor(self._points)[None]
        return (gap * gap).sum(dim=-1).sqrt()

    def follow_reward(self, joysticks_xy: Tensor) -> Tensor:
        """Base reward or joystick penalty of every action, scaled, (B, 2) -> (B, A)."""
        prior = self.spec.prior
        distance = self.distances(joysticks_xy)
        window = prior.max_distance - prior.max_follow_distance
        intensity = ((distance - prior.max_follow_distance) / window).clamp(0.0, 1.0)
        near = distance <= prior.max_follow_distance + DISTANCE_TOLERANCE
        reward = torch.where(
            near, torch.full_like(distance, prior.base), -prior.penalty * intensity
        )
        return prior.reward_scale * reward

    def _predict(self, observation: PyTorchObs, deterministic: bool = True) -> Tensor:
        return torch.as_tensor(self(observation)).argmax(dim=1)


class SeqQPolicy(DQNPolicy):
    """Online and target network for `SeqDQN`, in the form that SB3's `predict` expects."""

    q_net: QNet  # type: ignore[assignment]

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        lr_schedule: Schedule,
        spec: NetSpec | None = None,
        optimizer_kwargs: dict[str, Any] | None = None,
    ) -> None:
        self.spec = spec or NetSpec()
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            features_extractor_class=ObservationEncoder,
            normalize_images=False,
            optimizer_kwargs=optimizer_kwargs if optimizer_kwargs is not None else {"eps": 1.5e-4},
        )

    def predict(
        self,
        observation: Seen,
        state: States | None = None,
        episode_start: Array | None = None,
        deterministic: bool = False,
    ) -> tuple[Array, States | None]:
        """Greedy actions; a network with a state takes it and returns the next one, ((N, S),)."""
        if not self.spec.stateful:
            return super().predict(observation, state, episode_start, deterministic)
        self.set_training_mode(False)
        tensors, many = self.obs_to_tensor(observation)
        seen = cast(Tensors, tensors)
        before = self.q_net.begin(len(seen[JOYSTICK_KEY]))
        if state is not None:
            before = torch.tensor(state[0], device=self.device)
            if episode_start is not None:
                before[torch.as_tensor(episode_start, dtype=torch.bool)] = 0.0
        with torch.no_grad():
            values, after = self.q_net.step(seen, before)
        actions = values.argmax(dim=1).cpu().numpy()
        return actions if many else actions[0], (after.cpu().numpy(),)

    def make_q_net(self) -> QNet:  # type: ignore[override]
        """A fresh network of this policy's specification."""
        return QNet(self.observation_space, self.action_space, self.spec).to(self.device)  # type: ignore[arg-type]
