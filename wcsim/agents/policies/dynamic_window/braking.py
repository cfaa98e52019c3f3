"""Which joystick positions can be held for a while, and then braked before they meet something.

Backwards the chair does not look: it backs up over ground that it has seen or stood on, and hardly farther.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wcsim.agents.policies.dynamic_window.arcs import LONGEST_S, STEP_S, advance, arcs
from wcsim.agents.policies.dynamic_window.street_memory import is_known
from wcsim.agents.policies.dynamic_window.surroundings import StreetSense
from wcsim.core.jit import exact_kernel
from wcsim.types import F64, I64, Bool


@exact_kernel
def _backs_blindly(
    start: F64, hold_s: float, commands: F64, limits: F64, box: F64, cells: I64, pose_O: F64, blind: Bool
) -> None:
    """Say in `blind` (K,) which commands bring the chair's rear, backwards, onto ground that it does not know.

    Args:
        start: (6,) see `arcs`.
        hold_s: For how long each command is held, before the chair brakes.
        commands: (K, 2) joystick positions as the drive takes them.
        limits: (7,) of the drive.
        box: (3,) rear, front, half the width of the chair in B.
        cells: Of `StreetMemory`.
        pose_O: (3,) of the chair now.
        blind: Written.
    """
    rest, now = np.zeros(2), np.empty(6)
    for k in range(len(commands)):
        blind[k] = False
        if commands[k, 1] >= 0.0:
            continue
        now[:] = start
        for i in range(int(LONGEST_S / STEP_S)):
            held = i * STEP_S < hold_s - 1e-9
            if not held and now[3] == 0.0:
                break
            advance(now, commands[k] if held else rest, limits, STEP_S)
            if now[3] < 0.0 and not _rear_is_known(now, box, cells, pose_O):
                blind[k] = True
                break


@exact_kernel
def _rear_is_known(now: F64, box: F64, cells: I64, pose: F64) -> bool:
    cos, sin = math.cos(now[2]), math.sin(now[2])
    for side in (-1.0, 0.0, 1.0):
        x = now[0] + cos * box[0] - sin * side * box[2]
        y = now[1] + sin * box[0] + cos * side * box[2]
        turned_x = pose[0] + math.cos(pose[2]) * x - math.sin(pose[2]) * y
        if not is_known(cells, turned_x, pose[1] + math.sin(pose[2]) * x + math.cos(pose[2]) * y):
            return False
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class _Caution:
    """How early, and how widely, a driver is kept from what is in the way."""

    hold_s: float = 0.3  # each joystick position is held for so long before it is braked
    margin_m: float = 0.07  # kept all around: half a cell, and what the reckoning is off
    comfort_m: float = 0.25  # passing closer than this costs up to _COMFORT_COST


LAST_MOMENT = _Caution(hold_s=0.1, margin_m=0.03, comfort_m=0.1)
EARLY = _Caution(hold_s=1.0, margin_m=0.2, comfort_m=0.5)


def caution(level: float) -> _Caution:
    """That of a level of assistance from 0 (LAST_MOMENT) over 1 (the usual one) to 2 (EARLY)."""
    low, high, share = (LAST_MOMENT, _Caution(), level) if level < 1.0 else (_Caution(), EARLY, level - 1.0)
    mixed = {key: (1.0 - share) * getattr(low, key) + share * getattr(high, key) for key in _Caution.__slots__}
    return _Caution(**mixed)


def brakes_in_time(around: StreetSense, care: _Caution, start: F64, later_s: float, points: F64) -> tuple[Bool, F64]:
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
    _backs_blindly(start, care.hold_s, commands, limits, box, around.memory.cells, around.ego.pose_O, blind)
    return free & ~blind, gap_m
