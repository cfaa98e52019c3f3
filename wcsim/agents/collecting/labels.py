"""What is learned from an oracle: of every joystick position, whether it ends badly."""

from __future__ import annotations

from typing import Final

import numpy as np

from wcsim.types import F64, U8, Bool

SAFE: Final = 255
STEP_S: Final = 0.05  # of a code


def codes_of(first_s: F64) -> U8:
    """Seconds until it goes wrong (A,), infinity when it ends well, as codes of 0.05 s; 255 is safe.

    >>> codes_of(np.array([0.0, 0.26, np.inf, 40.0])).tolist()
    [0, 5, 255, 254]
    """
    steps = np.where(np.isinf(first_s), SAFE, np.minimum(np.rint(np.minimum(first_s, 1e3) / STEP_S), SAFE - 1))
    codes: U8 = steps.astype(np.uint8)
    return codes


def unsafe_ahead(codes: U8, ends: Bool, ahead: int) -> Bool:
    """(N, A) what is unsafe now, or in one of the next `ahead` steps as long as another position is left.

    Args:
        codes: (N, A) of successive steps, see `codes_of`.
        ends: (N,) with which an episode ended.
        ahead: Steps to look ahead.
    """
    safe = codes == SAFE
    wanted, at = safe.copy(), np.arange(len(codes))
    for _ in range(ahead):
        goes_on = ~ends[at] & (at < len(codes) - 1)
        at = np.where(goes_on, at + 1, at)
        both = wanted & safe[at]
        wanted = np.where(both.any(axis=1, keepdims=True), both, wanted)
    unsafe: Bool = ~wanted
    return unsafe
