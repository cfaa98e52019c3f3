"""A chain whose values can be computed by hand, seen through wcsim's observation."""

import gymnasium as gym
import numpy as np

from tests.support.samples import ACTIONS
from wcsim.supervisor.observation import make_observation_space

LENGTH, SIDE = 5, 8
CLASSES = (8, 11, 21, 23, 24)  # one class fills the image of each state


def tiny_view(class_id, depth=0):
    """An observation whose image one class fills."""
    image = np.full((1, SIDE, SIDE), class_id, np.uint8)
    vectors = {"imu": np.zeros(5, np.float32), "joystick": np.zeros(2, np.float32)}
    return {"seg": image, "depth": np.full_like(image, depth), **vectors}


class TinyTask(gym.Env):
    """A task with the usual actions that is seen in tiny images."""

    def __init__(self):
        self.actions = ACTIONS
        self.observation_space = make_observation_space("compact", SIDE, SIDE)
        self.action_space = gym.spaces.Discrete(len(self.actions))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._begin()
        return self._observe(), {}

    def _is_right(self, action):
        return bool(self.actions.points[int(action)][0] > 0)


class Chain(TinyTask):
    """Stick forward (y > 0) goes on and earns 1 at the end; anything else ends the episode with 0.3 at once."""

    def __init__(self, limit=50):
        super().__init__()
        self.limit = limit

    def _observe(self):
        return tiny_view(CLASSES[min(self.state, LENGTH - 1)])

    def _begin(self):
        self.state = int(self.np_random.integers(LENGTH))

    def step(self, action):
        onward = self.actions.points[int(action)][1] > 0
        self.state += int(onward)
        at_end = self.state >= LENGTH
        reward = 1.0 if at_end else (0.0 if onward else 0.3)
        return self._observe(), reward, at_end or not onward, False, {}


def chain_values(gamma, n_step=1, onward=1.0):
    """Value of going on in each state, (LENGTH,); giving up is worth 0.3 everywhere.

    Of returns over `n_step` steps, whose later ones are driven by somebody who goes on with the chance `onward`.
    """
    values = np.zeros(LENGTH)

    def after(state, steps):
        if steps == 0:
            return max(values[state], 0.3)
        further = 1.0 if state == LENGTH - 1 else gamma * after(state + 1, steps - 1)
        return onward * further + (1.0 - onward) * 0.3

    for state in reversed(range(LENGTH)):
        values[state] = 1.0 if state == LENGTH - 1 else gamma * after(state + 1, n_step - 1)
    return values
