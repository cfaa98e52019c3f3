"""A hand-written controller: `wcsim test own_policy:Careful --town monaco --only`."""

import numpy as np

from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set

NEAR = 120  # depth code of about 1.7 m; codes are logarithmic from 1 (0.1 m) to 255 (40 m), 0 means not measured


class Careful:
    """Follows the user's stick; slows down and warns if something is near ahead."""

    name = "careful"
    warning = False  # optional: only for policies that warn

    def __init__(self, config: RunConfig) -> None:
        self.actions = action_set(config.env.actions)  # `points` are the 81 positions: x to the right, y ahead

    def begin(self) -> None:
        """A test starts: clear all state."""

    def reset(self) -> None:
        """An episode starts."""

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """Return one of the 81 actions, once per tick."""
        depth = observation["depth"][-1]  # (rows, columns), of the newest picture
        rows, columns = depth.shape
        ahead = depth[rows // 4 : rows // 2, columns // 3 : 2 * columns // 3]
        self.warning = bool(np.mean((ahead > 0) & (ahead < NEAR)) > 0.05)
        return self.actions.nearest(observation["joystick"] * (0.3 if self.warning else 1.0))
