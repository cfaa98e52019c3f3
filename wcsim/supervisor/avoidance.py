"""How the user keeps clear of what was noticed: a lane around it, and a speed that still stops in front of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wcsim.supervisor.path import Path
from wcsim.supervisor.perception import Thing
from wcsim.types import ClassId, Ground

HALF_LENGTH_M = 0.57  # of the chair
HALF_WIDTH_M = 0.31
HORIZON_M = 4.5  # standing things farther along the route are not steered around yet
NEAR_M = 10.0
DART_MPS = 2.0  # nobody steers around what shoots across faster than this
STATIC_MARGIN_M = 0.2
MOVING_MARGIN_M = 0.3
STOP_GAP_M = 0.4  # left in front of the footplate
MEET_S = 3.5  # whom the chair meets later than this is left alone

EDGE_MARGIN_M = 0.12  # between the chair's side and a kerb or wall that it drives along on purpose
ROOM_STEP_M = 0.1
ROOM_STEPS = 16
ROOM_AHEAD_M = 0.5
KERB_STEP_M = 0.04
DEFAULT_ROOM_M = 0.35  # what the user dares without knowing the street


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """The middle of the chair as the user feels it move."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    arc_m: float  # of the middle along the route
    left_m: float  # beside it


def blocked_lanes(path: Path, body: Body, things: Sequence[Thing], desired_mps: float) -> list[tuple[float, float]]:
    """Offsets from the route (low, high; left positive) that would lead into something within the horizon."""
    lanes = []
    for thing in things:
        if math.hypot(thing.x_m - body.x_m, thing.y_m - body.y_m) > NEAR_M:
            continue
        place = path.project(thing.x_m, thing.y_m, body.arc_m)
        ahead = place.arc_m - body.arc_m
        if ahead < -(thing.radius_m + HALF_LENGTH_M + 0.15) or (not thing.moving and ahead > HORIZON_M):
            continue
        heading = path.heading(place.arc_m)
        along = thing.vx_mps * math.cos(heading) + thing.vy_mps * math.sin(heading)
        across = -thing.vx_mps * math.sin(heading) + thing.vy_mps * math.cos(heading)
        meet_s = _meet_s(ahead - HALF_LENGTH_M - thing.radius_m, desired_mps - along) if thing.moving else 0.0
        if meet_s > MEET_S or abs(across) > DART_MPS:
            continue
        margin = MOVING_MARGIN_M if thing.moving else STATIC_MARGIN_M
        half = thing.radius_m + HALF_WIDTH_M + margin
        middle = place.left_m + across * min(meet_s, 2.0)
        lanes.append((middle - half, middle + half))
    return lanes


def choose_lane(blocked: Sequence[tuple[float, float]], room: tuple[float, float], before_m: float) -> float | None:
    """The free offset nearest to the route that also stays near the one of before; None when nothing is free.

    Args:
        blocked: Offsets (low, high) that lead into something.
        room: How far left and right of the route the chair's middle may go, both positive.
        before_m: The offset of the tick before; without it the user would waver between two sides.

    >>> choose_lane([(-0.2, 0.9)], (1.0, 1.0), 0.0)
    -0.2
    >>> choose_lane([(-0.2, 0.9)], (1.0, 0.1), 0.0)
    0.9
    >>> choose_lane([(-5.0, 5.0)], (1.0, 1.0), 0.0) is None
    True
    """
    edges = [edge for lane in blocked for edge in lane]
    free = [
        offset
        for offset in (0.0, *edges)
        if -room[1] <= offset <= room[0] and not any(low < offset < high for low, high in blocked)
    ]
    return min(free, key=lambda offset: abs(offset) + 0.8 * abs(offset - before_m), default=None)


def safe_speed(body: Body, things: Sequence[Thing], brake_mps2: float, reaction_s: float) -> float:
    """The speed from which the user, braking gently after the reaction time, stops behind everything straight ahead."""
    limit = math.inf
    cos, sin = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
    for thing in things:
        along = thing.vx_mps * cos + thing.vy_mps * sin
        for later_s in (0.0, 0.8) if thing.moving else (0.0,):
            dx = thing.x_m + later_s * thing.vx_mps - body.x_m
            dy = thing.y_m + later_s * thing.vy_mps - body.y_m
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            if ahead <= 0.0 or abs(left) > thing.radius_m + HALF_WIDTH_M + 0.08:
                continue
            gap = ahead - thing.radius_m - HALF_LENGTH_M - STOP_GAP_M - reaction_s * max(0.0, body.speed_mps - along)
            own = math.sqrt(2.0 * brake_mps2 * gap) if gap > 0.0 else 0.0
            limit = min(limit, max(0.0, own + (along if thing.moving else 0.0)))
    return limit


def side_room(grid: Ground, path: Path, arc_m: float) -> tuple[float, float]:
    """How far the chair's middle may leave the route to the left and to the right over the next metres.

    Measured on level ground up to the first kerb or solid thing; never less than nothing, at most 1.2 m.
    """
    arcs = np.arange(arc_m, arc_m + HORIZON_M, ROOM_AHEAD_M)
    line = np.array([path.at(arc) for arc in arcs.tolist()])
    headings = np.array([path.heading(arc) for arc in arcs.tolist()])
    left = np.c_[-np.sin(headings), np.cos(headings)]
    rooms = []
    for side in (1.0, -1.0):
        offsets = side * ROOM_STEP_M * np.arange(ROOM_STEPS)
        points = line[:, None] + offsets[:, None] * left[:, None]  # (stations, offsets, 2)
        height = grid.raised_at(points)
        on_road = np.isin(grid.class_at(points), (ClassId.ROAD, ClassId.RAIL_TRACK))
        stops = np.abs(np.diff(height, axis=1, prepend=height[:, :1])) > KERB_STEP_M
        stops |= grid.clearance_at(points) < ROOM_STEP_M
        stops |= on_road & ~on_road[:, :1]
        first = np.where(stops.any(axis=1), stops.argmax(axis=1), ROOM_STEPS)
        rooms.append(max(0.0, float(first.min() - 1) * ROOM_STEP_M - HALF_WIDTH_M - EDGE_MARGIN_M))
    return rooms[0], rooms[1]


def _meet_s(gap_m: float, closing_mps: float) -> float:
    if gap_m <= 0.0:
        return 0.0
    return gap_m / closing_mps if closing_mps > 0.05 else math.inf
