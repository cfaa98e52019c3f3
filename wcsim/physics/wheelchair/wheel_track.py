"""Where the wheels of a chair were in the last seconds, and whether one fell off a kerb.

Such a fall is a crash of its own, though nothing but wheels may have touched anything.
"""

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from wcsim.core.constants import KERB_STEP_M
from wcsim.core.jit import compile_exact_kernel
from wcsim.physics.bullet import Bullet
from wcsim.types import F64, Bool, Ground

SAMPLE_S: Final = 0.05
KEPT_S: Final = 2.5  # longer than the longest tick with the time before it that is looked at
WITHIN_S: Final = 0.3  # a wheel that sinks for longer is let down
FASTER_MPS: Final = 0.3  # a slower chair feels its way down
AFTER_EDGE_S: Final = 1.0  # a slow wheel rolls over the edge of a kerb for so long before it falls
_PLACE: Final = 0  # of a link's centre of mass, in PyBullet's state of a link
_SOFT: Final = 2  # samples that the edge of a kerb takes, which the raster's cells may cut in two
_HAIR_M: Final = 1e-6  # heights of the raster are whole centimetres


class WheelTrack:
    """Takes a sample every 0.05 s, whatever the tick and the physics step are.

    Args:
        body: The chair in PyBullet.
        wheels: Its links that are wheels or casters.
        step_s: Physics step.
        bullet: Where it is.
    """

    def __init__(self, body: int, wheels: Iterable[int], step_s: float, bullet: Bullet) -> None:
        self._body = body
        self._wheels = tuple(wheels)
        self._bullet = bullet
        self.set_step(step_s)
        self._size = round(KEPT_S / (self._every * step_s))
        # Each sample is written twice, so that the last `_size` ones are always in one piece.
        self._p_W_m = np.zeros((2 * self._size, len(self._wheels), 3))
        self._speed_mps = np.zeros(2 * self._size)
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
        links = self._bullet.getLinkStates(self._body, self._wheels)
        self._add([link[_PLACE] for link in links], math.hypot(v_W_mps[0], v_W_mps[1]))

    def take(self, p_W_m: F64, speed_mps: F64) -> None:
        """Count the steps of a whole tick, after each the middles (n, W, 3) and the speed (n,)."""
        for wheels_W_m, speed in zip(p_W_m, speed_mps.tolist(), strict=True):
            self._steps += 1
            if self._steps % self._every == 0:
                self._add(wheels_W_m, speed)

    def _add(self, p_W_m: ArrayLike, speed_mps: float) -> None:
        at = self._count % self._size
        for row in (at, at + self._size):
            self._p_W_m[row] = p_W_m
            self._speed_mps[row] = speed_mps
        self._count += 1

    def samples(self) -> tuple[F64, F64]:
        """Middles of the wheels in W (n, W, 3) and the chair's speed over the ground (n,).

        The oldest are first. They are views, and change with the next sample.
        """
        first = self._count % self._size if self._count > self._size else 0
        last = first + min(self._count, self._size)
        return self._p_W_m[first:last], self._speed_mps[first:last]


def fell(p_W_m: F64, speed_mps: F64, ground: Ground) -> bool:
    """Whether a wheel fell off a kerb while the chair was moving.

    It sank more than a wheel takes, within 0.3 s, and just before it had rolled over an edge of the
    ground as high as that. A wheel that bounces meets no edge, nor does a fast chair on a ramp. The
    heights are those above the land, so that steep land is no edge.

    Args:
        p_W_m: Middles of the wheels (n, W, 3), a sample every `SAMPLE_S`, the oldest first.
        speed_mps: The chair's speed over the ground (n,).
        ground: The street from above.
    """
    sank = np.zeros(p_W_m.shape[:2], np.bool_)
    # Heights of the raster are looked up only where a wheel sank, which is hardly ever.
    if not _sank(p_W_m, speed_mps, round(WITHIN_S / SAMPLE_S), sank):
        return False
    # Where a wheel went down an edge of the ground, and in the second after it.
    raised_m = ground.raised_at(p_W_m)
    edge = np.zeros(raised_m.shape, np.bool_)
    for back in range(1, _SOFT + 1):
        edge[back:] |= raised_m[:-back] - raised_m[back:] > KERB_STEP_M + _HAIR_M
    after = edge.copy()
    for back in range(1, round(AFTER_EDGE_S / SAMPLE_S) + 1):
        after[back:] |= edge[:-back]
    return bool((sank & after).any())


@compile_exact_kernel
def _sank(p_W_m: F64, speed_mps: F64, window: int, sank: Bool) -> bool:
    """Note in `sank` (n, W) where a wheel is lower by that than before, when the chair was fast."""
    found = False
    for at in range(len(speed_mps)):
        for before in range(max(0, at - window), at):
            # The speed before the drop counts: after a fall the chair may stand.
            if speed_mps[before] > FASTER_MPS:
                for wheel in range(p_W_m.shape[1]):
                    if p_W_m[before, wheel, 2] - p_W_m[at, wheel, 2] > KERB_STEP_M:
                        sank[at, wheel] = found = True
    return found
