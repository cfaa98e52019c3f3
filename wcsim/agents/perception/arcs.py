"""Where joystick positions bring a chair, and how near that is to what is in the way.

Kernels: plain arrays in and out. A state (6,) is x, y, yaw in B of now, speed, turn rate and
acceleration. An obstacle (5,) is its place in B of now, its velocity over the ground, and the
distance to keep from it.
"""

import math
from typing import Final

import numpy as np

from wcsim.core.jit import compile_exact_kernel
from wcsim.core.joystick import advance_drive
from wcsim.types import F64, Bool

STEP_S: Final = 0.1
LONGEST_S: Final = 3.0
# A point that is nearer already than the distance to keep may get nearer by this.
CLOSER_M: Final = 0.02
# Points farther away than this do not matter.
NEAR_M: Final = 0.6


@compile_exact_kernel
def integrate_drive_motion(motion: F64, command: F64, limits: F64, dt_s: float) -> None:
    """Move `motion` (3,) v, w, acceleration on by `dt_s` towards a command (2,)."""
    motion[0], motion[1], motion[2] = advance_drive(
        motion[0], motion[1], motion[2], command[0], command[1], limits, dt_s
    )


@compile_exact_kernel
def integrate_chair_state(state: F64, command: F64, limits: F64, dt_s: float) -> None:
    """Move a state (6,) on by `dt_s` towards a command (2,)."""
    v, w = state[3], state[4]
    integrate_drive_motion(state[3:], command, limits, dt_s)
    turn = 0.5 * (w + state[4]) * dt_s
    way = 0.5 * (v + state[3]) * dt_s
    state[0] += way * math.cos(state[2] + 0.5 * turn)
    state[1] += way * math.sin(state[2] + 0.5 * turn)
    state[2] += turn


@compile_exact_kernel
def predict_delayed_state(motion: F64, waiting: F64, limits: F64, tick_s: float) -> F64:
    """The state (6,) once the commands `waiting` (M, 2) have been obeyed, one a tick."""
    state = np.zeros(6)
    state[3:] = motion
    for command in waiting:
        integrate_chair_state(state, command, limits, tick_s)
    return state


@compile_exact_kernel
def find_collision_free_commands(
    start: F64,
    later_s: float,
    hold_s: float,
    commands: F64,
    limits: F64,
    box: F64,
    points: F64,
    gap_m: F64,
) -> Bool:
    """Hold each command, then brake to a stop; how near does that bring the chair to obstacles?

    What happens before a command reaches the chair is no fault of the command.

    Args:
        start: (6,) the state when the command reaches the chair.
        later_s: When that is, from now on.
        hold_s: For how long each command is held.
        commands: (K, 2) joystick positions as the drive takes them.
        limits: (8,) of the drive.
        box: (3,) rear, front, half the width of the chair in B.
        points: (n, 5) obstacles.
        gap_m: (K,) written: the least distance, infinity where nothing is within NEAR_M. Where a
            command fails, the arc ends there.

    Returns:
        (K,) which commands keep the distance of every point; one that is nearer already may get
        nearer by `CLOSER_M`.
    """
    bounds_m = _distance_bounds(points, points[:, 4], box)
    free = np.empty(len(commands), np.bool_)
    for k in range(len(commands)):
        gap_m[k], free[k] = _arc(start, later_s, hold_s, commands[k], limits, box, points, bounds_m)
    return free


@compile_exact_kernel
def _distance_bounds(points: F64, margin_m: F64, box: F64) -> F64:
    """(n,) how near each point may come: `margin_m` (n,), or hardly nearer than it is now."""
    bounds_m = np.empty(len(points))
    for i in range(len(points)):
        now_m = _box_gap(points[i, 0], points[i, 1], 1.0, 0.0, box)
        bounds_m[i] = min(margin_m[i], now_m - CLOSER_M)
    return bounds_m


@compile_exact_kernel
def _arc(
    start: F64,
    later_s: float,
    hold_s: float,
    command: F64,
    limits: F64,
    box: F64,
    points: F64,
    bounds_m: F64,
) -> tuple[float, bool]:
    """The least distance on one arc, and whether no point came too near; otherwise the arc ends."""
    now, rest = start.copy(), np.zeros(2)
    least = np.inf
    for i in range(int(LONGEST_S / STEP_S) + 1):
        at_s = later_s + i * STEP_S
        cos, sin = math.cos(now[2]), math.sin(now[2])
        for n in range(len(points)):
            dx = points[n, 0] + at_s * points[n, 2] - now[0]
            dy = points[n, 1] + at_s * points[n, 3] - now[1]
            if max(abs(dx), abs(dy)) > box[1] + NEAR_M:
                continue
            gap = _box_gap(dx, dy, cos, sin, box)
            if gap < NEAR_M:
                least = min(least, gap)
                # A command cannot change where the chair is when it arrives.
                if i > 0 and gap <= bounds_m[n]:
                    return least, False
        # A hair less: rounding of the product must not add a step.
        held = i * STEP_S < hold_s - 1e-9
        if not held and now[3] == 0.0 and abs(now[4]) < 1e-3:
            break
        integrate_chair_state(now, command if held else rest, limits, STEP_S)
    return least, True


@compile_exact_kernel
def time_to_contact_s(
    start: F64,
    later_s: float,
    command: F64,
    limits: F64,
    box: F64,
    points: F64,
    margin_m: float,
    within_s: float,
) -> float:
    """Seconds from now until a held command (2,) brings the chair within `margin_m` of an obstacle.

    It is infinite beyond `within_s`. An obstacle that is so near already, or under the chair in
    memory, counts only when the chair gets nearer still. For the arguments see
    `find_collision_free_commands`.
    """
    now = start.copy()
    bounds_m = _distance_bounds(points, np.full(len(points), margin_m), box)
    at_s = later_s
    while at_s < within_s + 1e-9:
        if (measure_obstacle_gaps(now, at_s, box, points) <= bounds_m).any():
            return at_s
        integrate_chair_state(now, command, limits, STEP_S)
        at_s += STEP_S
    return np.inf


@compile_exact_kernel
def measure_obstacle_gaps(state: F64, at_s: float, box: F64, points: F64) -> F64:
    """(n,) from the chair in a state (6,) to each obstacle at a time; below 0 inside it."""
    cos, sin = math.cos(state[2]), math.sin(state[2])
    gap_m = np.empty(len(points))
    for n in range(len(points)):
        dx = points[n, 0] + at_s * points[n, 2] - state[0]
        dy = points[n, 1] + at_s * points[n, 3] - state[1]
        gap_m[n] = _box_gap(dx, dy, cos, sin, box)
    return gap_m


@compile_exact_kernel
def _box_gap(dx: float, dy: float, cos: float, sin: float, box: F64) -> float:
    """Distance from the chair to a place that far from its axle; below 0 inside it: how deep."""
    ahead = abs(dx * cos + dy * sin - 0.5 * (box[0] + box[1])) - 0.5 * (box[1] - box[0])
    aside = abs(dy * cos - dx * sin) - box[2]
    if ahead < 0.0 and aside < 0.0:
        return float(max(ahead, aside))
    return math.hypot(max(ahead, 0.0), max(aside, 0.0))
