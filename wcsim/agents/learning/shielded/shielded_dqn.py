"""Values on top of dangers: Q(s, a) = follow reward + F(s, a) - c * danger(s, a), and a choice among what is safe."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from wcsim.agents.learning.saved_policy import Beside
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.learning.shielded.danger_part import MOST, PART, copy_part, dangers_of_codes
from wcsim.agents.networks.q_network import NetSpec, QNet, SeqQPolicy
from wcsim.agents.policy_api import DANGER_KEY
from wcsim.agents.runs.policy_file import WEIGHTS
from wcsim.core import files
from wcsim.types import F64


@dataclass(frozen=True, slots=True, kw_only=True)
class Shield:
    """How dangers count; plain values, kept in policy.json."""

    weight: float = 1.0  # of a danger of 1, in units of the scaled reward
    threshold: float = 0.3  # what is more dangerous is not chosen


def allowed_argmax(values: F64, danger: F64, threshold: float) -> int:
    """The action of the highest value among those below the threshold, else the least dangerous one.

    >>> allowed_argmax(np.array([3.0, 2.0, 1.0]), np.array([0.9, 0.1, 0.2]), 0.3)
    1
    >>> allowed_argmax(np.array([3.0, 2.0, 1.0]), np.array([0.9, 0.8, 0.4]), 0.3)
    2
    """
    allowed = danger < threshold
    return int(np.argmax(np.where(allowed, values, -np.inf)) if allowed.any() else np.argmin(danger))


class ShieldedQNet(QNet):
    """The learned part is F alone: dangers come with the observation, and nothing here changes them."""

    def __init__(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, spec: NetSpec, shield: Shield
    ) -> None:
        super().__init__(observation_space, action_space, spec)
        self.shield = shield

    def forward(self, observations: PyTorchObs) -> torch.Tensor:
        """Values (B, A), in units of the scaled reward."""
        return super().forward(observations) - self.shield.weight * _dangers(observations)

    def choice(self, values: torch.Tensor, observations: PyTorchObs) -> torch.Tensor:
        """(B,) the best action among the safe ones, the least dangerous where there is none."""
        danger = _dangers(observations)
        allowed = danger < self.shield.threshold
        best = values.masked_fill(~allowed, -torch.inf).argmax(dim=1)
        return torch.where(allowed.any(dim=1), best, danger.argmin(dim=1))

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "shield": self.shield}


def _dangers(observations: PyTorchObs) -> torch.Tensor:
    if not isinstance(observations, dict):
        raise TypeError(f"observations are {type(observations).__name__}; expected a dict of tensors")
    return observations[DANGER_KEY][:, -1, 0].to(torch.float32) / MOST


class ShieldedQPolicy(SeqQPolicy):
    """Online and target network of `ShieldedDQN`."""

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        lr_schedule: Schedule,
        spec: NetSpec | None = None,
        optimizer_kwargs: dict[str, Any] | None = None,
        shield: Shield | None = None,
    ) -> None:
        self.shield = shield or Shield()
        super().__init__(observation_space, action_space, lr_schedule, spec, optimizer_kwargs)

    def _net_of(self, space: spaces.Dict, actions: spaces.Discrete) -> ShieldedQNet:
        return ShieldedQNet(space, actions, self.spec, self.shield)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "shield": self.shield}


class ShieldedDQN(SeqDQN):
    """SeqDQN that explores among the safe actions too; its environment tells dangers (`DangerSense`)."""

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"ShieldedQPolicy": ShieldedQPolicy}

    @property
    def shield(self) -> Shield:
        """How dangers count."""
        net = self.q_net
        return net.shield if isinstance(net, ShieldedQNet) else Shield()

    def predict(
        self,
        observation: npt.NDArray[Any] | dict[str, npt.NDArray[Any]],
        state: tuple[npt.NDArray[Any], ...] | None = None,
        episode_start: npt.NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[Any], tuple[npt.NDArray[Any], ...] | None]:
        """Greedy actions among the safe ones; what is explored is brought to the nearest safe action."""
        actions, state = super().predict(observation, state, episode_start, deterministic)
        if deterministic or not isinstance(observation, dict):
            return actions, state
        points = self.action_points.points
        dangers = dangers_of_codes(observation[DANGER_KEY])[..., -1, 0, :].reshape(-1, len(points))
        near = -np.linalg.norm(points[np.atleast_1d(actions)][:, None] - points, axis=2)
        pairs = zip(near, dangers, strict=True)
        safe = np.array([allowed_argmax(row, danger, self.shield.threshold) for row, danger in pairs])
        return (safe if np.ndim(actions) else safe[0]), state


def shield_beside(model: SeqDQN, part: Path | None) -> Beside | None:
    """What `save_policy` writes beside the values of a `ShieldedDQN`: its danger network, and how dangers count."""
    if part is None or not isinstance(model, ShieldedDQN):
        return None
    shield = asdict(model.shield)

    def write(folder: Path) -> dict[str, Any]:
        copy_part(part, folder / PART)
        return {"shield": {**shield, "danger_sha256": files.sha256(folder / PART / WEIGHTS)}}

    return write
