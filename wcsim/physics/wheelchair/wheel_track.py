"""Where the wheels of a chair have been in the last seconds, and how fast the chair was."""

from __future__ import annotations

import math
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
        self.set_step(step_s)
        self._kept = round(KEPT_S / (self._every * step_s))
        # each sample is written twice, so that the last `_kept` ones always lie in one piece
        self._p_W_m = np.zeros((2 * self._kept, len(self._wheels), 3))
        self._speed_mps = np.zeros(2 * self._kept)
        self.clear()

    def set_step(self, step_s: float) -> None:
        """Take the physics steps to be so long from now on."""
        self._every = max(1, round(SAMPLE_S / step_s))
        self._steps = 0

    def clear(self) -> None:
        """Forget everything: the chair is put to another place."""
        self._steps = self._count = 0

    def after_step(self, v_W_mps: tuple[float, float, float]) -> None:
        """Count a physics step, after which the chair moves at this velocity."""
        self._steps += 1
        if self._steps % self._every:
            return
        links = pybullet.getLinkStates(self._body, self._wheels, physicsClientId=self._client)
        places_W_m = [link[_PLACE] for link in links]
        at = self._count % self._kept
        for row in (at, at + self._kept):
            self._p_W_m[row] = places_W_m
            self._speed_mps[row] = math.hypot(v_W_mps[0], v_W_mps[1])
        self._count += 1

    def samples(self) -> tuple[F64, F64]:
        """Middles of the wheels in W (n, W, 3) and the chair's speed over the ground (n,), the oldest first.

        They are views, and change with the next sample.
        """
        first = self._count % self._kept if self._count > self._kept else 0
        last = first + min(self._count, self._kept)
        return self._p_W_m[first:last], self._speed_mps[first:last]
