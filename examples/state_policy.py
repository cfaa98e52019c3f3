"""A controller that sees numbers: `wcsim test state_policy:Trained --suite dev2 --only`, after `cleanrl_ppo.py`.

The rows are the world's truth (`env.observation=state`), so it is no rival of a network that sees pictures.
"""

import numpy as np
import torch
from cleanrl_ppo import HOLD, WEIGHTS, Agent, stick

from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set


class Trained:
    """Takes the likeliest choice, and holds it."""

    name = "ppo"
    senses = ("state",)  # the rows in place of pictures
    files = (str(WEIGHTS),)

    def __init__(self, config: RunConfig) -> None:
        torch.set_num_threads(1)
        self.actions, self.agent = action_set(config.env.actions), Agent()
        self.agent.load_state_dict(torch.load(WEIGHTS))

    def begin(self) -> None:
        """A test starts: clear all state."""

    def reset(self) -> None:
        """An episode starts."""
        self.left = 0  # steps for which the choice is still held

    @torch.no_grad()
    def act(self, observation: dict[str, np.ndarray]) -> int:
        """Return one of the 81 actions, the nearest to the stick."""
        seen = torch.from_numpy(observation["state"])[None]
        if self.left == 0:
            self.choice, self.left = self.agent.choices(seen).probs.argmax(1), HOLD
        self.left -= 1
        return self.actions.nearest(stick(seen, self.choice)[0].numpy())
