"""A task of memory: the first image says which way to go, and the last one alone counts."""

import numpy as np

from tests.agents.chain import TinyTask, tiny_view

LENGTH = 4
CUES = (24, 23)  # a person: left; sky: right
BLANK = 8


class Recall(TinyTask):
    """A cue, blank images, then 1 for a stick to the cue's side and -1 for another; all episodes are LENGTH steps."""

    def _observe(self):
        return tiny_view(CUES[self.cue] if self.step_count == 0 else BLANK, 40 * self.step_count)

    def _begin(self):
        self.cue, self.step_count = int(self.np_random.integers(2)), 0

    def step(self, action):
        self.step_count += 1
        done = self.step_count == LENGTH
        right = self._is_right(action)
        reward = (1.0 if right == bool(self.cue) else -1.0) if done else 0.0
        return self._observe(), reward, done, False, {}


class Clock(Recall):
    """All images are alike; left earns 1/LENGTH until the last step, then right does. Who does not count gets 0.5."""

    def _observe(self):
        return tiny_view(BLANK)

    def step(self, action):
        self.step_count += 1
        last = self.step_count == LENGTH
        right = self._is_right(action)
        return self._observe(), (1.0 if right == last else -1.0) / LENGTH, last, False, {}


class Biased(TinyTask):
    """Left ends at once with 0. Right earns 0 and leads to a second state, where every action ends with N(-0.1, 1)."""

    def __init__(self, seed=0):
        super().__init__()
        self.noise = np.random.default_rng(seed)

    def _observe(self):
        return tiny_view(CUES[int(self.second)])

    def _begin(self):
        self.second = False

    def step(self, action):
        if self.second:
            return self._observe(), float(self.noise.normal(-0.1, 1.0)), True, False, {}
        self.second = self._is_right(action)
        return self._observe(), 0.0, not self.second, False, {}
