"""A segment: some hundred ticks of a world of its own, with several chairs, as one piece of work and one file."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from wcsim.types import F32, U8, Bool

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
    visible: U8  # (N, A) codes of `collecting/labels.py`, of the oracle that knows what the cameras showed
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
