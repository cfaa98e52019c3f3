"""A policy that holds a danger network and the values that were learned on top of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.danger.rule import LEVELS
from wcsim.agents.danger.saved import load_danger
from wcsim.agents.learning.saved_policy import NetPolicy
from wcsim.agents.learning.shielded.danger_part import PART, codes_of_dangers, dangers_of_codes
from wcsim.agents.learning.shielded.shielded_dqn import allowed_argmax
from wcsim.agents.policy_api import Observation, require_level
from wcsim.agents.runs.policy_file import WEIGHTS
from wcsim.config import RunConfig
from wcsim.config.run_file import ShieldFile
from wcsim.core import files
from wcsim.core.reading import shown
from wcsim.errors import PolicyError
from wcsim.types import Bool


class ShieldedPolicy(NetPolicy):
    """Acts greedily among what its danger network allows.

    Args:
        values: The network of values; its `net` alone knows no dangers.
        part: The danger network.
        shield: How dangers count.
        threshold: What is more dangerous is not chosen.
    """

    def __init__(self, values: NetPolicy, part: DangerPolicy, shield: ShieldFile, threshold: float) -> None:
        super().__init__(values.net, values.name, values.file)
        self._part, self._shield, self.level = part, shield, threshold
        self.senses, self.levels = part.senses, LEVELS
        self.unsafe: Bool = part.unsafe  # (A,) above the threshold at the last choice

    @property
    def warning(self) -> bool:
        """Whether the user's own stick is about to end badly."""
        return self._part.warning

    def set_delay(self, ticks: int) -> None:
        """From the next `reset` on a command reaches the chair so many ticks late."""
        self._part.set_delay(ticks)

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self._part.reset()

    def set_level(self, level: float) -> None:
        """Take another threshold of danger from now on. Raises PolicyError for one out of bounds."""
        require_level(level, LEVELS)
        self.level = level

    def act(self, observation: Observation) -> int:
        """The action of the highest value among the safe ones, else the least dangerous one."""
        action = self.choose(observation)
        self.sent(action)
        return action

    def sent(self, action: int) -> None:
        """Say which action is carried out."""
        self._part.sent(action)

    def choose(self, observation: Observation) -> int:
        """The same as `act`, while another action may still be sent."""
        self._part.choose(observation)
        danger = dangers_of_codes(codes_of_dangers(self._part.told))  # as they were in training
        values = self.values(observation).astype(np.float64) - self._shield.weight * danger
        self.unsafe = danger >= self.level
        return allowed_argmax(values, danger, self.level)


def shielded(
    path: Path, values: NetPolicy, config: RunConfig, level: float | None, network: str | None = None
) -> NetPolicy:
    """The policy of a folder with its danger network; `values` as they are where it has none.

    Args:
        path: Of the folder.
        values: As `load_policy` has loaded them.
        config: Of the run in which it drives.
        level: Of assistance, a threshold of danger; None for the policy's own.
        network: Somebody's own class that the danger network may look with, see `load_net`.

    Raises:
        PolicyError: The danger network cannot be loaded, is not the one of the training, or sees with another camera.
    """
    shield, part = values.file.shield, path / PART
    if shield is None:
        return values
    danger = load_danger(part, values.name, config, level, network)
    if files.sha256(part / WEIGHTS) != shield.danger_sha256:
        raise PolicyError(
            f"{shown(part)} is not the danger network that {shown(values.name)!r} learned with; copy the "
            "whole policy folder again"
        )
    return ShieldedPolicy(values, danger, shield, shield.threshold if level is None else level)
