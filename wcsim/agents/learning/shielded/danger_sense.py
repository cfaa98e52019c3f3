"""Dangers beside what is seen: the network is asked once a tick, while driving, and the replay keeps what it said."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.danger.saved import load_net, require_same_senses
from wcsim.agents.envs.episode_view import delay_ticks
from wcsim.agents.learning.shielded.danger_part import MOST, PART, codes_of_dangers
from wcsim.agents.policy_api import DANGER_KEY, DEPTH_KEY, Observation
from wcsim.config import RunConfig
from wcsim.errors import PolicyError
from wcsim.types import U8

Env = gymnasium.Env[Any, Any]


def with_dangers(make_env: Callable[[], Env], config: RunConfig, part: Path) -> Callable[[], Env]:
    """The environment with dangers beside what is seen.

    Raises:
        PolicyError: The network cannot be loaded, or sees with another camera.
    """
    require_same_senses(part, part.name, config)
    return lambda: DangerSense(make_env(), config, part)


class DangerSense(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Adds `danger`, (window, 1, A) uint8, to the observations of an environment with one chair."""

    def __init__(self, env: Env, config: RunConfig, part: Path) -> None:
        super().__init__(env)
        inner = env.observation_space
        if not isinstance(inner, spaces.Dict):
            raise PolicyError(f"observation space is {inner}; expected wcsim's Dict: set env.observation=compact")
        self._config, (self._net, self._rule) = config, load_net(part, config.learn.network)
        self._frames, count = (inner[DEPTH_KEY].shape or (1,))[0], len(self._net.points)
        self._kept: deque[U8] = deque(maxlen=self._frames)
        box = spaces.Box(0, MOST, (self._frames, 1, count), np.uint8)
        self.observation_space = spaces.Dict({**inner.spaces, DANGER_KEY: box})
        self._drivers: dict[int, DangerPolicy] = {}  # by the delay of the commands
        self._driver: DangerPolicy

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; nothing of the one before is remembered."""
        seen, info = self.env.reset(seed=seed, options=options)
        delay = delay_ticks(self._config, info.get("drawn"))
        if delay not in self._drivers:
            self._drivers[delay] = DangerPolicy(PART, self._net, self._config, self._rule, delay)
        self._driver = self._drivers[delay]
        self._driver.reset()
        self._kept.clear()
        return self._with_dangers(seen), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One step; the danger network is told what is done."""
        self._driver.sent(int(action))
        seen, reward, terminated, truncated, info = self.env.step(action)
        return self._with_dangers(seen), reward, terminated, truncated, info

    def _with_dangers(self, seen: Observation) -> dict[str, Any]:
        codes = codes_of_dangers(self._driver.dangers(seen))
        missing = max(self._frames - len(self._kept), 1)  # the first ones fill the window, as with pictures
        self._kept.extend([codes] * missing)
        return {**seen, DANGER_KEY: np.stack(list(self._kept))[:, None]}
