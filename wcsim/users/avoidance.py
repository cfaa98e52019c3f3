"""How the user keeps clear of what was noticed: a lane around it, and a speed that still stops in front of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from wcsim.users.perception import NoticedObject
from wcsim.users.route_line import Path

HORIZON_M = 4.5  # standing things farther along the route are not steered around yet
NEAR_M = 10.0
_DART_MPS = 2.0  # nobody steers around what shoots across faster than this
_STATIC_MARGIN_M = 0.2
_MOVING_MARGIN_M = 0.3
_STOP_GAP_M = 0.4  # left in front of the footplate
_MEET_S = 3.5  # whom the chair meets later than this is left alone

EDGE_MARGIN_M = 0.12  # between the chair's side and a kerb or wall that it drives along on purpose
DEFAULT_ROOM_M = 0.35  # what the user dares without knowing the street


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """The middle of the chair as the user feels it move, and how far the chair reaches from there."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    arc_m: float  # of the middle along the route
    left_m: float  # beside it
    half_m: tuple[float, float]  # half the length and width of the chair's box


def blocked_lanes(
    path: Path, body: Body, things: Sequence[NoticedObject], desired_mps: float
) -> list[tuple[float, float]]:
    """Offsets from the route (low, high; left positive) that would lead into something within the horizon."""
    lanes = []
    half_length_m, half_width_m = body.half_m
    for thing in things:
        if math.hypot(thing.x_m - body.x_m, thing.y_m - body.y_m) > NEAR_M:
            continue
        place = path.project(thing.x_m, thing.y_m, body.arc_m)
        ahead = place.arc_m - body.arc_m
        if ahead < -(thing.radius_m + half_length_m + 0.15) or (not thing.moving and ahead > HORIZON_M):
            continue
        heading = path.heading(place.arc_m)
        along = thing.vx_mps * math.cos(heading) + thing.vy_mps * math.sin(heading)
        across = -thing.vx_mps * math.sin(heading) + thing.vy_mps * math.cos(heading)
        meet_s = _meet_s(ahead - half_length_m - thing.radius_m, desired_mps - along) if thing.moving else 0.0
        if meet_s > _MEET_S or abs(across) > _DART_MPS:
            continue
        margin = _MOVING_MARGIN_M if thing.moving else _STATIC_MARGIN_M
        half = thing.radius_m + half_width_m + margin
        middle = place.left_m + across * min(meet_s, 2.0)
        lanes.append((middle - half, middle + half))
    return lanes


def choose_lane(
    blocked: Sequence[tuple[float, float]], room: tuple[float, float], before_m: float, home_m: float = 0.0
) -> float | None:
    """The free offset nearest to the usual one that also stays near the one of before; None when nothing is free.

    Args:
        blocked: Offsets (low, high) that lead into something.
        room: How far left and right of the route the chair's middle may go; negative where the route is at the edge.
        before_m: The offset of the tick before; without it the user would waver between two sides.
        home_m: The offset where nothing is in the way.

    >>> choose_lane([(-0.2, 0.9)], (1.0, 1.0), 0.0)
    -0.2
    >>> choose_lane([(-0.2, 0.9)], (1.0, 0.1), 0.0)
    0.9
    >>> choose_lane([(-5.0, 5.0)], (1.0, 1.0), 0.0) is None
    True
    """
    edges = [edge for lane in blocked for edge in lane if -room[1] <= edge <= room[0]]
    free = [offset for offset in (home_m, *edges) if not any(low < offset < high for low, high in blocked)]
    return min(free, key=lambda offset: abs(offset - home_m) + 0.8 * abs(offset - before_m), default=None)


def safe_speed(body: Body, things: Sequence[NoticedObject], brake_mps2: float, reaction_s: float) -> float:
    """The speed from which the user, braking gently after the reaction time, stops behind everything straight ahead."""
    limit = math.inf
    half_length_m, half_width_m = body.half_m
    cos, sin = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
    for thing in things:
        along = thing.vx_mps * cos + thing.vy_mps * sin
        for later_s in (0.0, 0.8) if thing.moving else (0.0,):
            dx = thing.x_m + later_s * thing.vx_mps - body.x_m
            dy = thing.y_m + later_s * thing.vy_mps - body.y_m
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            if ahead <= 0.0 or abs(left) > thing.radius_m + half_width_m + 0.08:
                continue
            gap = ahead - thing.radius_m - half_length_m - _STOP_GAP_M - reaction_s * max(0.0, body.speed_mps - along)
            own = math.sqrt(2.0 * brake_mps2 * gap) if gap > 0.0 else 0.0
            limit = min(limit, max(0.0, own + (along if thing.moving else 0.0)))
    return limit


def _meet_s(gap_m: float, closing_mps: float) -> float:
    if gap_m <= 0.0:
        return 0.0
    return gap_m / closing_mps if closing_mps > 0.05 else math.inf
