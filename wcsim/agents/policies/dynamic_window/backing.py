"""Backwards the chair does not look: it backs up over ground that it has seen or stood on, and hardly farther."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from wcsim.agents.policies.dynamic_window.arcs import LONGEST_S, STEP_S, advance
from wcsim.agents.policies.dynamic_window.street_memory import is_known
from wcsim.core.jit import exact_kernel
from wcsim.types import F64, Bool

I64 = npt.NDArray[np.int64]


@exact_kernel
def backs_blindly(
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
