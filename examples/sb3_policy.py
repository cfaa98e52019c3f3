"""A model of Stable-Baselines3 among the rows of a suite: `wcsim test sb3_policy:Sb3Policy --suite dev --only`."""

import numpy as np
from stable_baselines3 import DQN

from wcsim.config import RunConfig


class Sb3Policy:
    """The `dqn.zip` that stock_sb3.py leaves here (for ppo.zip import PPO); loading a zip runs what is in it."""

    name = "sb3"
    files = ("dqn.zip",)  # what it reads: a suite that goes on drives anew when that is another

    def __init__(self, config: RunConfig) -> None:
        self.model = DQN.load(self.files[0], device="cpu")

    def begin(self) -> None:
        """A test begins."""

    def reset(self) -> None:
        """An episode begins; a model without a state has nothing to forget."""

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """One of the 81 actions for one observation."""
        return int(self.model.predict(observation, deterministic=True)[0])
