"""The images of the last few ticks in one observation, for networks that see how things move."""

from __future__ import annotations

from collections import deque

import gymnasium
import numpy as np

from wcsim.agents import policy_api
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, RGB_KEY
from wcsim.errors import PolicyError
from wcsim.supervisor.observation import Observation

IMAGE_KEYS = (CLASS_KEY, DEPTH_KEY, RGB_KEY)  # of the compact forms


class FrameWindow:
    """Puts the last `frames` images of an episode into its observations, the newest last.

    The first image of an episode fills the window. IMU and joystick stay those of now. With one frame, observations of
    any form go through as they are.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._kept: deque[Observation] = deque(maxlen=frames)

    def reset(self) -> None:
        """Forget everything: the next observation begins an episode."""
        self._kept.clear()

    def add(self, observation: Observation) -> Observation:
        """The observation with its window, (frames, H, W) in fresh arrays, from one with (1, H, W); colours thrice."""
        if self._frames == 1:
            return observation
        missing = max(self._frames - len(self._kept), 1)  # all of them once, then one each time
        self._kept.extend([observation] * missing)
        images = {key: np.concatenate([old[key] for old in self._kept]) for key in IMAGE_KEYS if key in observation}
        return {**observation, **images}


def windowed_space(space: gymnasium.spaces.Dict, frames: int) -> gymnasium.spaces.Dict:
    """The space of the observations that `FrameWindow` makes of the compact ones in `space`."""
    if frames == 1:
        return space
    parts = dict(space.spaces)
    for key in parts.keys() & set(IMAGE_KEYS):
        planes, *size = space[key].shape or ()
        shape = (frames * planes, *size)
        parts[key] = gymnasium.spaces.Box(0, 255, shape, np.uint8)
    return gymnasium.spaces.Dict(parts)


def newest(observation: policy_api.Observation, frames: int) -> policy_api.Observation:
    """The observation with the newest `frames` images of its window, as views.

    Raises PolicyError when the window holds fewer.
    """
    held = len(observation[DEPTH_KEY])
    if held < frames:
        raise PolicyError(
            f"an observation holds {held} images, this policy was trained on {frames}; expected at least as many: "
            f"set env.window={frames}"
        )
    if held == frames:
        return observation
    # An image may have several planes: colours have three for each moment.
    planes = {key: len(observation[key]) // held for key in IMAGE_KEYS if key in observation}
    return {key: value[-frames * planes[key] :] if key in planes else value for key, value in observation.items()}
