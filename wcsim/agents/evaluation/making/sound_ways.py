"""Which ways a test may ask for: over carriageways on crossings alone, with room to wait before each of their lights.

netconvert lays walking areas of crowded junctions over lanes, and some refuges are shorter than a chair. Whoever drives
there is on a carriageway beside its crossing, or passes a red light because nobody can wait before it: what is counted
then says something about the map and nothing about a policy.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from wcsim.bridge.reaction.commands import ROADWAY
from wcsim.types import Outline, Route, Street
from wcsim.users.crossing import KERB_GAP_M, Crossing, crossings

BESIDE_M: Final = 1.0  # of road in one go beside the crossings: a kerb that runs aslant
_STEP_M: Final = 0.25


def is_sound(street: Street, route: Route, outline: Outline) -> bool:
    """Whether a test may send a chair of this outline along a route."""
    over = crossings(route, street.walk)
    return _has_refuges(over, outline) and _road_beside_m(street, route, over) <= BESIDE_M


def _has_refuges(over: Sequence[Crossing], outline: Outline) -> bool:
    """Whether before each light that follows on another crossing there is room for a chair that waits."""
    room_m = outline.length_m + KERB_GAP_M
    return all(not then.tls_id or then.start_m - before.end_m > room_m for before, then in pairwise(over))


def _road_beside_m(street: Street, route: Route, over: Sequence[Crossing]) -> float:
    """The longest stretch of carriageway on a route, m, that is on none of its crossings."""
    arc_m = np.arange(0.0, route.arc_m[-1], _STEP_M)
    x_m, y_m = (np.interp(arc_m, route.arc_m, route.points_W_m[:, axis]).tolist() for axis in (0, 1))
    longest = now = 0
    for at_m, x, y in zip(arc_m.tolist(), x_m, y_m, strict=True):
        crossed = any(item.start_m <= at_m <= item.end_m for item in over)
        now = 0 if crossed or street.grid.class_here(x, y) not in ROADWAY else now + 1
        longest = max(longest, now)
    return longest * _STEP_M
