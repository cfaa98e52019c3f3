"""Where the joystick positions of an action set bring a chair, and how near that is to what is in the way.

Kernels: plain arrays in and out.
"""

from __future__ import annotations

import math

import numpy as np

from wcsim.core.jit import exact_kernel
from wcsim.core.joystick import driven
from wcsim.types import F64

STEP_S, LONGEST_S = 0.1, 3.0


@exact_kernel
def follow(motion: F64, command: F64, limits: F64, dt_s: float) -> None:
    """Move `motion` (3,) v, w, acceleration on by `dt_s` towards a command (2,), within the drive's limits (7,)."""
    motion[0], motion[1], motion[2] = driven(motion[0], motion[1], motion[2], command[0], command[1], limits, dt_s)


@exact_kernel
def advance(state: F64, command: F64, limits: F64, dt_s: float) -> None:
    """Move `state` (6,) x, y, yaw, v, w, acceleration on by `dt_s` towards a command (2,)."""
    v, w = state[3], state[4]
    follow(state[3:], command, limits, dt_s)
    turn = 0.5 * (w + state[4]) * dt_s
    way = 0.5 * (v + state[3]) * dt_s
    state[0] += way * math.cos(state[2] + 0.5 * turn)
    state[1] += way * math.sin(state[2] + 0.5 * turn)
    state[2] += turn


@exact_kernel
def after(motion: F64, waiting: F64, limits: F64, tick_s: float) -> F64:
    """The state (6,) x, y, yaw, v, w, acceleration in B of now, once `waiting` (M, 2) has been obeyed, one a tick."""
    state = np.zeros(6)
    state[3:] = motion
    for command in waiting:
        advance(state, command, limits, tick_s)
    return state


@exact_kernel
def arcs(
    start: F64, later_s: float, hold_s: float, commands: F64, limits: F64, box: F64, points: F64, gap_m: F64
) -> None:
    """Hold each command, then brake to a stop; `gap_m` (K,) becomes the least distance to what is in the way.

    Args:
        start: (6,) x, y, yaw in B of now, speed, turn rate, acceleration, when the command reaches the chair.
        later_s: When that is, from now on.
        hold_s: For how long each command is held.
        commands: (K, 2) joystick positions as the drive takes them.
        limits: (7,) of the drive.
        box: (3,) rear, front, half the width of the chair in B.
        points: (n, 4) what is in the way, in B of now, and how fast it moves over the ground.
        gap_m: Written; below 0 how deep something gets into the chair, infinity that there is nothing.
    """
    now = np.empty(6)
    rest = np.zeros(2)
    for k in range(len(commands)):
        now[:] = start
        gap = np.inf
        for i in range(int(LONGEST_S / STEP_S) + 1):
            gap = min(gap, rectangle_gap(now[0], now[1], now[2], later_s + i * STEP_S, box, points))
            held = i * STEP_S < hold_s - 1e-9
            if not held and now[3] == 0.0 and abs(now[4]) < 1e-3:
                break
            advance(now, commands[k] if held else rest, limits, STEP_S)
        gap_m[k] = gap


@exact_kernel
def touches_after(
    start: F64, later_s: float, command: F64, limits: F64, box: F64, points: F64, margin_m: float, within_s: float
) -> float:
    """Seconds from now on until the chair comes so near to what is in the way when a command (2,) is held; see `arcs`.

    Infinite when it does not within `within_s`.
    """
    now = start.copy()
    at_s = later_s
    while at_s < within_s + 1e-9:
        if rectangle_gap(now[0], now[1], now[2], at_s, box, points) <= margin_m:
            return at_s
        advance(now, command, limits, STEP_S)
        at_s += STEP_S
    return np.inf


@exact_kernel
def rectangle_gap(x: float, y: float, yaw: float, at_s: float, box: F64, points: F64) -> float:
    """Distance from the chair at a pose to the nearest of `points` (n, 4) at a time; see `arcs`.

    Below 0 inside the chair: how deep. So who touches what it sees, or believes it does, can still get away from it.
    """
    cos, sin = math.cos(yaw), math.sin(yaw)
    middle, half = 0.5 * (box[0] + box[1]), 0.5 * (box[1] - box[0])
    least, deepest = np.inf, 0.0
    for i in range(len(points)):
        dx, dy = points[i, 0] + at_s * points[i, 2] - x, points[i, 1] + at_s * points[i, 3] - y
        ahead = abs(dx * cos + dy * sin - middle) - half
        aside = abs(dy * cos - dx * sin) - box[2]
        if ahead < 0.0 and aside < 0.0:
            deepest = min(deepest, max(ahead, aside))
        ahead, aside = max(ahead, 0.0), max(aside, 0.0)
        least = min(least, ahead * ahead + aside * aside)
    return deepest if deepest < 0.0 else math.sqrt(least)
