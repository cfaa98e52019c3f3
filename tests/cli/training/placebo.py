"""Policies that help nobody: each gives one random stick when it takes over, and then what its user asks for.

A street with a chair in it goes another way after any touch.
"""

from zlib import crc32

import numpy as np

from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.agents.policy_api import Observation
from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set

NAMES = tuple(f"{__name__}:Placebo{number}" for number in range(1, 6))


class _Placebo:
    name, number = "placebo", 0

    def __init__(self, config: RunConfig) -> None:
        self._actions, self._first = action_set(config.env.actions), True

    def begin(self) -> None: ...

    def reset(self) -> None:
        self._first = True

    def act(self, observation: Observation) -> int:
        if not self._first:
            return self._actions.nearest(observation["joystick"])
        self._first = False
        seen = crc32(np.ascontiguousarray(observation["depth"]).tobytes())
        return int(np.random.default_rng([self.number, seen]).integers(len(self._actions)))


Placebo1, Placebo2, Placebo3, Placebo4, Placebo5 = (type("Placebo", (_Placebo,), {"number": n}) for n in range(1, 6))


class Dwa(_Placebo):
    """`dwa`, but for one random stick when it takes over."""

    name, senses = "dwa-placebo", ("odometry", "gyro")

    def __init__(self, config: RunConfig) -> None:
        super().__init__(config)
        self._rule = make_baseline_policy("dwa", config)

    @property
    def warning(self) -> bool:
        return self._rule.warning

    def reset(self) -> None:
        super().reset()
        self._rule.reset()

    def act(self, observation: Observation) -> int:
        first, action = self._first, self._rule.act(observation)
        return super().act(observation) if first else action
