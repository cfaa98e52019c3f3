"""How the user keeps clear of what was noticed and of the edges of the pavement: lanes, speeds, offsets from the route.

A lane leads around a thing, and a speed still stops in front of it. A route may pass a kerb at little more than half a
chair's width, and a person does not: where there is room, the user drives a little aside of such a route. A ramp whose
sides fall away twists under a chair, lifts one of its wheels and throws it off its line, so people go slowly there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wcsim.core.constants import KERB_STEP_CM
from wcsim.core.jit import exact_kernel
from wcsim.types import F64, U8, ClassId, Ground
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
_STATION_M = 0.5
_PIECE = 20  # stations that are looked at together, within one raster of the street
FARTHEST_M = 1.6
STEP_M = 0.05
SOLID_DM = 1  # nearer to a wall than this is no place for the middle of a chair
COMFORT_M = 0.66  # between the middle of the chair and an edge, where there is room
ROAD, RAIL = int(ClassId.ROAD), int(ClassId.RAIL_TRACK)
_WHEEL_M = 0.28  # half the distance between the wheels
SLOPE_CM = 2  # from one wheel to another or from station to station, above what the land does
_SPREAD_M = 1.0  # before and behind an edge the user keeps the distance as well


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
        self, path: Path, things: Sequence[NoticedObject], desired_mps: float
    ) -> list[tuple[float, float]]:
        """Offsets from the route (low, high; left positive) that would lead into something within the horizon."""
        lanes = []
        half_length_m, half_width_m = self.half_m
        for thing in things:
            if math.hypot(thing.x_m - self.x_m, thing.y_m - self.y_m) > NEAR_M:
                continue
            place = path.project(thing.x_m, thing.y_m, self.arc_m)
            ahead = place.arc_m - self.arc_m
            if ahead < -(thing.radius_m + half_length_m + 0.15) or (
                not thing.moving and ahead > HORIZON_M
            ):
                continue
            heading = path.heading(place.arc_m)
            along = thing.vx_mps * math.cos(heading) + thing.vy_mps * math.sin(heading)
            across = -thing.vx_mps * math.sin(heading) + thing.vy_mps * math.cos(heading)
            meet_s = (
                _meet_s(ahead - half_length_m - thing.radius_m, desired_mps - along)
                if thing.moving
                else 0.0
            )
            if meet_s > _MEET_S or abs(across) > _DART_MPS:
                continue
            margin = _MOVING_MARGIN_M if thing.moving else _STATIC_MARGIN_M
            half = thing.radius_m + half_width_m + margin
            middle = place.left_m + across * min(meet_s, 2.0)
            lanes.append((middle - half, middle + half))
        return lanes

    def safe_speed(
        self, things: Sequence[NoticedObject], brake_mps2: float, reaction_s: float
    ) -> float:
        """The speed from which who brakes gently, after the reaction time, stops behind everything straight ahead."""
        limit = math.inf
        half_length_m, half_width_m = self.half_m
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        for thing in things:
            along = thing.vx_mps * cos + thing.vy_mps * sin
            for later_s in (0.0, 0.8) if thing.moving else (0.0,):
                dx = thing.x_m + later_s * thing.vx_mps - self.x_m
                dy = thing.y_m + later_s * thing.vy_mps - self.y_m
                ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
                if ahead <= 0.0 or abs(left) > thing.radius_m + half_width_m + 0.08:
                    continue
                gap = (
                    ahead
                    - thing.radius_m
                    - half_length_m
                    - _STOP_GAP_M
                    - reaction_s * max(0.0, self.speed_mps - along)
                )
                own = math.sqrt(2.0 * brake_mps2 * gap) if gap > 0.0 else 0.0
                limit = min(limit, max(0.0, own + (along if thing.moving else 0.0)))
        return limit


def choose_lane(
    blocked: Sequence[tuple[float, float]],
    room: tuple[float, float],
    before_m: float,
    home_m: float = 0.0,
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
    free = [
        offset
        for offset in (home_m, *edges)
        if not any(low < offset < high for low, high in blocked)
    ]
    return min(
        free, key=lambda offset: abs(offset - home_m) + 0.8 * abs(offset - before_m), default=None
    )


def _meet_s(gap_m: float, closing_mps: float) -> float:
    if gap_m <= 0.0:
        return 0.0
    return gap_m / closing_mps if closing_mps > 0.05 else math.inf


class Edges:
    """How far the street goes on to the left and right of a route, looked at piece by piece as the user comes near."""

    def __init__(self, ground: Ground, path: Path) -> None:
        self._ground = ground
        self._path = path
        self._room = np.zeros((0, 2))  # (stations, left and right)
        self._aside = np.zeros(0)
        self._slopes = np.zeros(0, np.bool_)

    def aside(self, arc_m: float) -> float:
        """How far beside the route to drive at a place (m, left positive)."""
        self._see(max(0.0, arc_m) + 2.0 * _SPREAD_M + _STATION_M)
        last = len(self._aside) - 1
        at = min(max(arc_m / _STATION_M, 0.0), last - 1e-9)
        low = int(at)
        share = at - low
        return float((1.0 - share) * self._aside[low] + share * self._aside[min(low + 1, last)])

    def room(self, arc_m: float, ahead_m: float) -> tuple[float, float]:
        """How far the ground goes on beside the route over the next metres, left and right, at most 1.6 m."""
        self._see(max(0.0, arc_m) + ahead_m)
        first, last = (
            max(0, int(arc_m / _STATION_M)),
            max(1, math.ceil((arc_m + ahead_m) / _STATION_M)),
        )
        left_m, right_m = self._room[min(first, len(self._room) - 1) : last].min(axis=0).tolist()
        return left_m, right_m

    def slope_ahead(self, arc_m: float, ahead_m: float) -> float:
        """How far it is to where the ground slopes; 0 on it, infinity when it does not over the next metres."""
        self._see(max(0.0, arc_m) + ahead_m)
        first = max(0, int(arc_m / _STATION_M))
        found = np.flatnonzero(self._slopes[first : math.ceil((arc_m + ahead_m) / _STATION_M) + 1])
        return max(0.0, float(first + found[0]) * _STATION_M - arc_m) if len(found) else math.inf

    def _see(self, to_m: float) -> None:
        """Look at the street up to a place."""
        wanted = min(math.ceil(to_m / _STATION_M), math.ceil(self._path.length_m / _STATION_M)) + 1
        if wanted <= len(self._room):
            return
        while len(self._room) < wanted:
            arcs_m = _STATION_M * (len(self._room) + np.arange(_PIECE))
            line = np.array([self._path.at(arc) for arc in arcs_m.tolist()])
            headings = np.array([self._path.heading(arc) for arc in arcs_m.tolist()])
            left = np.c_[-np.sin(headings), np.cos(headings)]
            grid = self._ground.around(line[_PIECE // 2])
            origin_m = np.array(grid.origin_W_m, np.float64)
            room = _rooms(
                line,
                left,
                grid.height_cm,
                grid.clearance_dm,
                grid.ground_class,
                origin_m,
                grid.cell_m,
            )
            self._room = np.concatenate([self._room, room])
            aside_m = _WHEEL_M * np.stack([left, np.zeros_like(left), -left])  # (3, _PIECE, 2)
            height_cm = grid.height_cm[grid.cells(line + aside_m)].astype(np.int64)  # (3, _PIECE)
            along = np.abs(np.diff(height_cm, axis=1, append=height_cm[:, -1:])).max(axis=0)
            self._slopes = np.concatenate(
                [self._slopes, (along >= SLOPE_CM) | (np.ptp(height_cm, axis=0) >= SLOPE_CM)]
            )
        self._aside = spread(_wanted_aside(self._room))


def _wanted_aside(room_m: F64) -> F64:
    """(N,) offset to the left for room (N, 2) left and right: clear of an edge, or halfway between two.

    >>> _wanted_aside(np.array([[1.6, 1.6], [1.6, 0.4], [0.8, 0.4]])).round(2).tolist()
    [0.0, 0.26, 0.2]
    """
    left, right = room_m[:, 0], room_m[:, 1]
    away = np.maximum(COMFORT_M - right, 0.0) - np.maximum(COMFORT_M - left, 0.0)
    return np.where(left + right < 2.0 * COMFORT_M, 0.5 * (left - right), away)


def spread(aside_m: F64) -> F64:
    """(N,) offsets that are reached a little before the place that asks for them, without a jump."""
    reach = round(_SPREAD_M / _STATION_M)
    padded = np.pad(aside_m, 2 * reach, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    largest = np.take_along_axis(windows, np.abs(windows).argmax(axis=1)[:, None], axis=1)[:, 0]
    return np.asarray(
        np.lib.stride_tricks.sliding_window_view(largest, 2 * reach + 1).mean(axis=1), np.float64
    )


@exact_kernel
def _rooms(
    line: F64,
    left: F64,
    height_cm: U8,
    clearance_dm: U8,
    ground_class: U8,
    origin_m: F64,
    cell_m: float,
) -> F64:
    """(N, 2) metres from each point of a line to the first kerb, wall or road on its left and right."""
    rows, cols = height_cm.shape
    room = np.empty((len(line), 2))
    for i in range(len(line)):
        for side in range(2):
            sign = 1.0 - 2.0 * side
            before_cm, on_road = -1, False
            room[i, side] = FARTHEST_M
            for step in range(int(FARTHEST_M / STEP_M) + 1):
                x = line[i, 0] + sign * step * STEP_M * left[i, 0]
                y = line[i, 1] + sign * step * STEP_M * left[i, 1]
                col = min(max(math.floor((x - origin_m[0]) / cell_m), 0), cols - 1)
                row = min(max(math.floor((y - origin_m[1]) / cell_m), 0), rows - 1)
                here_cm = int(height_cm[row, col])
                road_here = ground_class[row, col] == ROAD or ground_class[row, col] == RAIL
                kerb = before_cm >= 0 and abs(here_cm - before_cm) > KERB_STEP_CM
                if (
                    kerb
                    or clearance_dm[row, col] < SOLID_DM
                    or (road_here and step > 0 and not on_road)
                ):
                    room[i, side] = step * STEP_M
                    break
                if step == 0:
                    on_road = road_here
                before_cm = here_cm
    return room
