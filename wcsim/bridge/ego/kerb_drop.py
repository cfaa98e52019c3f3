"""Whether a wheel fell off a kerb: a crash of its own, though no part of the chair but wheels may touch anything."""

from __future__ import annotations

from typing import Final

import numpy as np

from wcsim.core.constants import KERB_STEP_M
from wcsim.core.jit import exact_kernel
from wcsim.physics.wheelchair.wheel_track import SAMPLE_S
from wcsim.types import F64, Bool, Ground

WITHIN_S: Final = 0.3  # a wheel that sinks for longer is let down
FASTER_MPS: Final = 0.3  # a slower chair feels its way down
AFTER_EDGE_S: Final = 1.0  # a slow wheel rolls over the edge of a kerb for so long before it falls
_SOFT: Final = 2  # samples that the edge of a kerb takes, which the raster's cells may cut in two
_HAIR_M: Final = 1e-6  # heights of the raster are whole centimetres


def fell(p_W_m: F64, speed_mps: F64, ground: Ground) -> bool:
    """Whether a wheel fell off a kerb while the chair was moving.

    It sank more than a wheel takes, within 0.3 s, and just before it had rolled over an edge of the ground as high as
    that. The edge tells a fall from a wheel that bounces, and from a ramp that a fast chair rolls down; the heights are
    those above the land, so that steep land is no edge.

    Args:
        p_W_m: Middles of the wheels (n, W, 3), a sample every `SAMPLE_S`, the oldest first.
        speed_mps: The chair's speed over the ground (n,).
        ground: The street from above.
    """
    sank = np.zeros(p_W_m.shape[:2], np.bool_)
    if not _sank(p_W_m, speed_mps, round(WITHIN_S / SAMPLE_S), sank):
        return False
    return bool((sank & _after_edge(ground.raised_at(p_W_m))).any())


@exact_kernel
def _sank(p_W_m: F64, speed_mps: F64, window: int, sank: Bool) -> bool:
    """Note in `sank` (n, W) where a wheel is that much lower than in the samples before, when the chair was fast."""
    found = False
    for at in range(len(speed_mps)):
        for before in range(max(0, at - window), at):
            if speed_mps[before] > FASTER_MPS:
                for wheel in range(p_W_m.shape[1]):
                    if p_W_m[before, wheel, 2] - p_W_m[at, wheel, 2] > KERB_STEP_M:
                        sank[at, wheel] = found = True
    return found


def _after_edge(raised_m: F64) -> Bool:
    """(n, W) where a wheel went down an edge of the ground within the last second."""
    edge = np.zeros(raised_m.shape, np.bool_)
    for back in range(1, _SOFT + 1):
        edge[back:] |= raised_m[:-back] - raised_m[back:] > KERB_STEP_M + _HAIR_M
    after = edge.copy()
    for back in range(1, round(AFTER_EDGE_S / SAMPLE_S) + 1):
        after[back:] |= edge[:-back]
    return after
