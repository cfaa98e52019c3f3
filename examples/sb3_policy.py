"""A model of Stable-Baselines3 as a policy of wcsim: `wcsim test sb3_policy:Sb3Policy --suite dev2 --only`."""

import numpy as np
from stable_baselines3 import DQN

from wcsim.config import RunConfig


class Sb3Policy:
    """The `dqn.zip` of stock_sb3.py (for ppo.zip, import PPO). Loading a zip file runs its code."""

    name = "sb3"
    files = ("dqn.zip",)  # its input files: a resumed suite starts again if they change

    def __init__(self, config: RunConfig) -> None:
        self.model = DQN.load(self.files[0], device="cpu")

    def begin(self) -> None:
        """A test starts."""

    def reset(self) -> None:
        """An episode starts; this model has no state."""

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """Return one of the 81 actions for one observation."""
        return int(self.model.predict(observation, deterministic=True)[0])
