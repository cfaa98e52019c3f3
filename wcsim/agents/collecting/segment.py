"""A segment: some hundred ticks of a world of its own, with several chairs, as one piece of work and one file."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from wcsim.types import F32, F64, U8, Bool

FOLLOW, ORACLE, NETWORK, RECKLESS = range(4)
"""Who chose an action: the user alone, the blinded oracle, the network, the user's stick gone astray."""
DRIVERS: Final = ("follow", "oracle", "network", "reckless")


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentKey:
    """Which piece of a run's driving it is; everything random in it follows from this and the run's seed."""

    run: int  # its seed
    round: int
    index: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segment:
    """Steps of several chairs, sorted by chair and step; row n tells what was seen, then what was done about it."""

    depth: U8  # (N, H, W) newest image, see `supervisor/observation.py`
    seg: U8  # (N, H, W)
    imu: F32  # (N, I)
    odometry: F32  # (N, 2)
    stick: F32  # (N, 2) the user's
    wish: F32  # (N, 2) the stick that was answered: the user's, or one gone astray
    action: U8  # (N,) executed
    driver: U8  # (N,) see DRIVERS
    visible: U8  # (N, A) see `codes_of`, of the oracle that knows what the cameras showed
    truth: U8  # (N, A) the same of the oracle that knows all
    reward: F32  # (N,) what the step brought
    crashed: Bool  # (N,) the step ended in a crash
    ended: Bool  # (N,) it was the last one of its episode here
    delay: U8  # (N,) ticks from a command to the chair that obeys it

    def __len__(self) -> int:
        """How many steps."""
        return len(self.action)

    def arrays(self) -> dict[str, np.ndarray]:
        """All columns by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def joined(segments: list[Segment]) -> Segment:
    """The steps of several segments, one after the other. Raises ValueError for none."""
    if not segments:
        raise ValueError("no segments to join; expected one at least")
    columns = {name: np.concatenate([part.arrays()[name] for part in segments]) for name in segments[0].arrays()}
    return Segment(**columns)


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
