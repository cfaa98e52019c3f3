"""What chance alone changes: one random stick at the start, or a rule with other noise in its camera.

The first ones then give what their user asks for. A street with a chair in it goes another way after any touch.
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
        seen = crc32(observation["depth"].tobytes())
        return int(np.random.default_rng([self.number, seen]).integers(len(self._actions)))


Placebo1, Placebo2, Placebo3, Placebo4, Placebo5 = (type("Placebo", (_Placebo,), {"number": n}) for n in range(1, 6))


class Dwa:
    """`dwa`, whose camera loses other pixels: one more in a hundred, as its noise does."""

    name, senses = "dwa-placebo", ("odometry", "gyro")

    def __init__(self, config: RunConfig) -> None:
        self._rule = make_baseline_policy("dwa", config)

    def begin(self) -> None: ...

    @property
    def warning(self) -> bool:
        return self._rule.warning

    def reset(self) -> None:
        self._rule.reset()

    def act(self, observation: Observation) -> int:
        depth = observation["depth"]
        lost = np.random.default_rng(crc32(depth.tobytes())).random(depth.shape) < 0.01
        return self._rule.act({**observation, "depth": np.where(lost, np.uint8(0), depth)})
