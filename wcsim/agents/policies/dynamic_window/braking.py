"""Which joystick positions can be held for a while, and then braked before they meet something."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wcsim.agents.policies.dynamic_window.arcs import arcs
from wcsim.agents.policies.dynamic_window.backing import backs_blindly
from wcsim.agents.policies.dynamic_window.surroundings import StreetSense
from wcsim.types import F64, Bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Caution:
    """How early, and how widely, a driver is kept from what is in the way."""

    hold_s: float = 0.3  # each joystick position is held for so long before it is braked
    margin_m: float = 0.07  # kept all around: half a cell, and what the reckoning is off
    comfort_m: float = 0.25  # passing closer than this costs up to _COMFORT_COST


LAST_MOMENT = Caution(hold_s=0.1, margin_m=0.03, comfort_m=0.1)
EARLY = Caution(hold_s=1.0, margin_m=0.2, comfort_m=0.5)


def caution(level: float) -> Caution:
    """That of a level of assistance from 0 (LAST_MOMENT) over 1 (the usual one) to 2 (EARLY)."""
    low, high, share = (LAST_MOMENT, Caution(), level) if level < 1.0 else (Caution(), EARLY, level - 1.0)
    mixed = {key: (1.0 - share) * getattr(low, key) + share * getattr(high, key) for key in Caution.__slots__}
    return Caution(**mixed)


def brakes_in_time(around: StreetSense, care: Caution, start: F64, later_s: float, points: F64) -> tuple[Bool, F64]:
    """Of each action, whether it can be braked in time and does not back into what nobody has seen; how near it passes.

    Args:
        around: The street, as of the newest observation.
        care: How early, and how widely.
        start: (6,) the state in which an action begins, see `StreetSense.start`.
        later_s: When that is.
        points: (n, 5) what is in the way, `StreetSense.in_the_way` of the margin of `care`.

    Returns:
        (A,) whether it can, and (A,) the gap in metres.
    """
    commands, limits, box = around.commands, around.limits, around.box_B_m
    gap_m, blind = np.empty(len(commands)), np.empty(len(commands), np.bool_)
    free: Bool = arcs(start, later_s, care.hold_s, commands, limits, box, points, gap_m)
    backs_blindly(start, care.hold_s, commands, limits, box, around.memory.cells, around.ego.pose_O, blind)
    return free & ~blind, gap_m
