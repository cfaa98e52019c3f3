"""A controller of your own, without learning: `wcsim test own_policy:Careful --town monaco --only`."""

import numpy as np

from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set

NEAR = 120  # a code of depth, about 1.7 m; codes run from 1 (0.1 m) to 255 (40 m), logarithmic, and 0 was not measured


class Careful:
    """It does what the user asks for, and creeps and warns when something is near ahead."""

    name = "careful"
    warning = False  # may be left out by who never warns

    def __init__(self, config: RunConfig) -> None:
        self.actions = action_set(config.env.actions)  # `points` are the 81 positions: x to the right, y ahead

    def begin(self) -> None:
        """A test begins: forget everything."""

    def reset(self) -> None:
        """An episode begins."""

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """One of the 81 actions, once a tick."""
        depth = observation["depth"][-1]  # (rows, columns), of the newest picture
        rows, columns = depth.shape
        ahead = depth[rows // 4 : rows // 2, columns // 3 : 2 * columns // 3]
        self.warning = bool(np.mean((ahead > 0) & (ahead < NEAR)) > 0.05)
        return self.actions.nearest(observation["joystick"] * (0.3 if self.warning else 1.0))
