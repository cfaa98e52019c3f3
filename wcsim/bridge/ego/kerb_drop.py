"""Whether a wheel fell off a kerb: a crash of its own, though no part of the chair but wheels may touch anything."""

from __future__ import annotations

from typing import Final

import numpy as np

from wcsim.core.constants import KERB_STEP_M
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
    sank = _sank(p_W_m[:, :, 2], speed_mps)
    if not sank.any():
        return False
    return bool((sank & _after_edge(ground.raised_at(p_W_m))).any())


def _sank(z_m: F64, speed_mps: F64) -> Bool:
    """(n, W) where a wheel is that much lower than within 0.3 s before, when the chair was fast."""
    sank = np.zeros(z_m.shape, np.bool_)
    for back in range(1, round(WITHIN_S / SAMPLE_S) + 1):
        moving = speed_mps[:-back, None] > FASTER_MPS
        sank[back:] |= moving & (z_m[:-back] - z_m[back:] > KERB_STEP_M)
    return sank


def _after_edge(raised_m: F64) -> Bool:
    """(n, W) where a wheel went down an edge of the ground within the last second."""
    edge = np.zeros(raised_m.shape, np.bool_)
    for back in range(1, _SOFT + 1):
        edge[back:] |= raised_m[:-back] - raised_m[back:] > KERB_STEP_M + _HAIR_M
    after = edge.copy()
    for back in range(1, round(AFTER_EDGE_S / SAMPLE_S) + 1):
        after[back:] |= edge[:-back]
    return after
