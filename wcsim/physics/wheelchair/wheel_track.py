"""Where the wheels of a chair have been in the last seconds, and how fast the chair was."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from wcsim.physics.bullet import pybullet
from wcsim.types import F64

SAMPLE_S: Final = 0.05
KEPT_S: Final = 2.5  # longer than the longest tick and all that is asked of the time before it
_PLACE: Final = 0  # of a link's centre of mass, among what PyBullet says of a link


class WheelTrack:
    """Takes a sample every 0.05 s, whatever the tick and the physics step are.

    Args:
        body: The chair in PyBullet.
        wheels: Its links that are wheels or casters.
        step_s: Physics step.
        client: The engine in PyBullet.
    """

    def __init__(self, body: int, wheels: Iterable[int], step_s: float, client: int) -> None:
        self._body, self._wheels, self._client = body, tuple(wheels), client
        self._every = max(1, round(SAMPLE_S / step_s))
        kept = round(KEPT_S / (self._every * step_s))
        self._p_W_m = np.zeros((kept, len(self._wheels), 3))
        self._speed_mps = np.zeros(kept)
        self.clear()

    def clear(self) -> None:
        """Forget everything: the chair is put to another place."""
        self._steps = self._count = 0

    def after_step(self, speed_mps: float) -> None:
        """Count a physics step, after which the chair goes over the ground at this speed."""
        self._steps += 1
        if self._steps % self._every:
            return
        at = self._count % len(self._speed_mps)
        links = pybullet.getLinkStates(self._body, self._wheels, physicsClientId=self._client)
        self._p_W_m[at] = [link[_PLACE] for link in links]
        self._speed_mps[at] = speed_mps
        self._count += 1

    def samples(self) -> tuple[F64, F64]:
        """Middles of the wheels in W (n, W, 3) and the chair's speed over the ground (n,), the oldest first."""
        kept = len(self._speed_mps)
        if self._count <= kept:
            return self._p_W_m[: self._count].copy(), self._speed_mps[: self._count].copy()
        first = self._count % kept
        return np.roll(self._p_W_m, -first, axis=0), np.roll(self._speed_mps, -first)
