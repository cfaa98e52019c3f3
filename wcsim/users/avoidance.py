"""How the user stays clear of things and of the pavement's edges: lanes, speeds, lateral offsets.

A lane leads around a thing, and a safe speed still stops in front of it. A route may pass a kerb at
little more than half a chair's width, and a person does not: where there is room, the user drives a
little aside of such a route. A ramp whose sides fall away twists under a chair, lifts one of its
wheels and throws it off its line, so people go slowly there.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.core.constants import KERB_STEP_CM
from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F64, U8, ClassId, Ground
from wcsim.users.perception import DetectedObject
from wcsim.users.route_line import RoutePolyline

_HORIZON_M: Final = 4.5  # standing things farther along the route are not steered around yet
_NEAR_M: Final = 10.0
_PASSED_M: Final = 0.15
_STATIC_MARGIN_M: Final = 0.2
_MOVING_MARGIN_M: Final = 0.3
_DART_MPS: Final = 2.0  # what shoots across faster than this is not steered around
_MEET_S: Final = 3.5  # what the chair meets later than this is left alone
_CROSS_S: Final = 2.0  # the longest way across that is taken into account
_CLOSING_MPS: Final = 0.05
_SIDE_GAP_M: Final = 0.08
_STOP_GAP_M: Final = 0.4  # left in front of the footplate
_LATER_S: Final = 0.8  # something that moves is also looked at where it is then
# A change of the lane costs a share of its width: the user would waver between two sides.
_CHANGE_COST: Final = 0.8
_OFF_LANE_M: Final = 0.15
_CHANGE_SPEED: Final = 0.6  # share of the desired speed while the chair changes its lane

_EDGE_MARGIN_M: Final = 0.12  # between the chair's side and an edge that it passes on purpose
_DEFAULT_ROOM_M: Final = 0.35  # how far the user leaves its route without knowing the street
_STATION_M: Final = 0.5
_PIECE: Final = 20  # stations that are looked at together, within one raster of the street
FARTHEST_M: Final = 1.6
_STEP_M: Final = 0.05
_SOLID_DM: Final = 1  # nearer to a wall than this is no place for the middle of a chair
_COMFORT_M: Final = 0.66  # between the middle of the chair and an edge, where there is room
_ROAD: Final = int(ClassId.ROAD)
_RAIL: Final = int(ClassId.RAIL_TRACK)
_WHEEL_M: Final = 0.28  # half the distance between the wheels
_SLOPE_CM: Final = 2  # between wheels or stations, above what the land does
_SPREAD_M: Final = 1.0  # the offset of an edge also holds so far before and behind it


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictedChairPose:
    """The chair's middle as the user feels it move, and how far the chair reaches from there."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    arc_m: float  # of the middle along the route
    left_m: float  # beside it
    half_m: tuple[float, float]  # half the length and width of the chair's box

    def blocked_lanes(
        self, path: RoutePolyline, things: Sequence[DetectedObject], desired_mps: float
    ) -> list[tuple[float, float]]:
        """Offsets (low, high; left positive) that lead into something within the horizon."""
        lanes = []
        half_length_m, half_width_m = self.half_m
        for thing in things:
            if math.hypot(thing.x_m - self.x_m, thing.y_m - self.y_m) > _NEAR_M:
                continue
            place = path.project(thing.x_m, thing.y_m, self.arc_m)
            ahead_m = place.arc_m - self.arc_m
            if ahead_m < -(thing.radius_m + half_length_m + _PASSED_M):
                continue
            if not thing.moving and ahead_m > _HORIZON_M:
                continue
            heading_rad = path.heading(place.arc_m)
            cos, sin = math.cos(heading_rad), math.sin(heading_rad)
            along_mps = thing.vx_mps * cos + thing.vy_mps * sin
            across_mps = -thing.vx_mps * sin + thing.vy_mps * cos
            meet_s = 0.0
            margin_m = _STATIC_MARGIN_M
            if thing.moving:
                gap_m = ahead_m - half_length_m - thing.radius_m
                closing_mps = desired_mps - along_mps
                if gap_m > 0.0:
                    meet_s = gap_m / closing_mps if closing_mps > _CLOSING_MPS else math.inf
                margin_m = _MOVING_MARGIN_M
            if meet_s > _MEET_S or abs(across_mps) > _DART_MPS:
                continue
            half_m = thing.radius_m + half_width_m + margin_m
            middle_m = place.left_m + across_mps * min(meet_s, _CROSS_S)
            lanes.append((middle_m - half_m, middle_m + half_m))
        return lanes

    def safe_speed(
        self, things: Sequence[DetectedObject], brake_mps2: float, reaction_s: float
    ) -> float:
        """The speed from which gentle braking stops behind everything straight ahead.

        The braking starts after the reaction time.
        """
        limit_mps = math.inf
        half_length_m, half_width_m = self.half_m
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        for thing in things:
            along_mps = thing.vx_mps * cos + thing.vy_mps * sin
            reaction_m = reaction_s * max(0.0, self.speed_mps - along_mps)
            for later_s in (0.0, _LATER_S) if thing.moving else (0.0,):
                dx_m = thing.x_m + later_s * thing.vx_mps - self.x_m
                dy_m = thing.y_m + later_s * thing.vy_mps - self.y_m
                ahead_m, left_m = dx_m * cos + dy_m * sin, dy_m * cos - dx_m * sin
                if ahead_m <= 0.0 or abs(left_m) > thing.radius_m + half_width_m + _SIDE_GAP_M:
                    continue
                gap_m = ahead_m - thing.radius_m - half_length_m - _STOP_GAP_M - reaction_m
                safe_mps = math.sqrt(2.0 * brake_mps2 * gap_m) if gap_m > 0.0 else 0.0
                # Behind something that moves on, the chair may go as fast as it does.
                if thing.moving:
                    safe_mps += along_mps
                limit_mps = min(limit_mps, max(0.0, safe_mps))
        return limit_mps


class LateralOffsetPlanner:
    """The lateral offset at which a user drives along one route."""

    def __init__(self, path: RoutePolyline, ground: Ground | None) -> None:
        """Start on the route. Without a ground the user stays near it and sees no edge."""
        self.offset_m = 0.0  # beside the route, left positive
        self._path = path
        self._edges = None if ground is None else PavementWidthScanner(ground, path)

    def slope_ahead(self, arc_m: float, ahead_m: float) -> float:
        """As `PavementWidthScanner.slope_ahead`; infinity without a ground."""
        return math.inf if self._edges is None else self._edges.slope_ahead(arc_m, ahead_m)

    def change_lane(
        self,
        body: PredictedChairPose,
        things: Sequence[DetectedObject],
        desired_mps: float,
        goal_m: float,
    ) -> float:
        """Set the offset for the way to the place `goal_m`; the speed that it allows."""
        home_m = 0.0 if self._edges is None else self._edges.offset_at(goal_m)
        blocked = body.blocked_lanes(self._path, things, desired_mps)
        if not blocked:
            self.offset_m = home_m
            return math.inf
        room_m = (_DEFAULT_ROOM_M, _DEFAULT_ROOM_M)
        if self._edges is not None:
            left_m, right_m = self._edges.room(body.arc_m, _HORIZON_M)
            beside_m = body.half_m[1] + _EDGE_MARGIN_M
            room_m = (left_m - beside_m, right_m - beside_m)
        lane_m = choose_lateral_offset(blocked, room_m, self.offset_m, home_m)
        if lane_m is None:
            return _CHANGE_SPEED * desired_mps
        self.offset_m = lane_m
        is_off = abs(body.left_m - lane_m) > _OFF_LANE_M
        return _CHANGE_SPEED * desired_mps if is_off else math.inf


def choose_lateral_offset(
    blocked: Sequence[tuple[float, float]],
    room: tuple[float, float],
    before_m: float,
    home_m: float = 0.0,
) -> float | None:
    """The free offset nearest to the usual one and to the last one; None when nothing is free.

    Args:
        blocked: Offsets (low, high) that lead into something.
        room: How far left and right of the route the chair's middle may go; negative where the
            route is at the edge.
        before_m: The offset of the tick before.
        home_m: The offset where nothing is in the way.

    >>> choose_lateral_offset([(-0.2, 0.9)], (1.0, 1.0), 0.0)
    -0.2
    >>> choose_lateral_offset([(-0.2, 0.9)], (1.0, 0.1), 0.0)
    0.9
    >>> choose_lateral_offset([(-5.0, 5.0)], (1.0, 1.0), 0.0) is None
    True
    """
    edges = [edge for lane in blocked for edge in lane if -room[1] <= edge <= room[0]]
    free = [
        offset
        for offset in (home_m, *edges)
        if not any(low < offset < high for low, high in blocked)
    ]

    def cost(offset: float) -> float:
        return abs(offset - home_m) + _CHANGE_COST * abs(offset - before_m)

    return min(free, key=cost, default=None)


class PavementWidthScanner:
    """How far the street goes on beside a route, looked at in pieces as the user comes near."""

    def __init__(self, ground: Ground, path: RoutePolyline) -> None:
        self._ground = ground
        self._path = path
        self._room_m = np.zeros((0, 2))  # (stations, left and right)
        self._offset_m = np.zeros(0)  # (stations,)
        self._slopes = np.zeros(0, np.bool_)  # (stations,)

    def offset_at(self, arc_m: float) -> float:
        """How far beside the route to drive at a place (m, left positive)."""
        self._look_up_to(max(0.0, arc_m) + 2.0 * _SPREAD_M + _STATION_M)
        last = len(self._offset_m) - 1
        at = min(max(arc_m / _STATION_M, 0.0), last - 1e-9)
        low = int(at)
        share = at - low
        high = min(low + 1, last)
        return float((1.0 - share) * self._offset_m[low] + share * self._offset_m[high])

    def room(self, arc_m: float, ahead_m: float) -> tuple[float, float]:
        """How far the ground goes on over the next metres, left and right, at most 1.6 m."""
        self._look_up_to(max(0.0, arc_m) + ahead_m)
        first = max(0, int(arc_m / _STATION_M))
        last = max(1, math.ceil((arc_m + ahead_m) / _STATION_M))
        room_m = self._room_m[min(first, len(self._room_m) - 1) : last]
        left_m, right_m = room_m.min(axis=0).tolist()
        return left_m, right_m

    def slope_ahead(self, arc_m: float, ahead_m: float) -> float:
        """How far it is to a slope; 0 on it, infinity without one over the next metres."""
        self._look_up_to(max(0.0, arc_m) + ahead_m)
        first = max(0, int(arc_m / _STATION_M))
        found = np.flatnonzero(self._slopes[first : math.ceil((arc_m + ahead_m) / _STATION_M) + 1])
        return max(0.0, float(first + found[0]) * _STATION_M - arc_m) if len(found) else math.inf

    def _look_up_to(self, arc_m: float) -> None:
        """Look at the street up to a place, piece by piece."""
        last = min(math.ceil(arc_m / _STATION_M), math.ceil(self._path.length_m / _STATION_M))
        if last < len(self._room_m):
            return
        while len(self._room_m) <= last:
            arcs_m = _STATION_M * (len(self._room_m) + np.arange(_PIECE))
            line = np.array([self._path.at(arc) for arc in arcs_m.tolist()])
            headings = np.array([self._path.heading(arc) for arc in arcs_m.tolist()])
            left = np.c_[-np.sin(headings), np.cos(headings)]
            grid = self._ground.around(line[_PIECE // 2])
            room_m = _measure_room(
                line,
                left,
                grid.height_cm,
                grid.clearance_dm,
                grid.ground_class,
                np.array(grid.origin_W_m, np.float64),
                grid.cell_m,
            )
            self._room_m = np.concatenate([self._room_m, room_m])
            # A chair tilts by the ground under its two wheels and between them.
            tracks = line + _WHEEL_M * np.stack([left, np.zeros_like(left), -left])
            height_cm = grid.height_cm[grid.cells(tracks)].astype(np.int64)  # (3, _PIECE)
            along_cm = np.abs(np.diff(height_cm, axis=1, append=height_cm[:, -1:])).max(axis=0)
            slopes = (along_cm >= _SLOPE_CM) | (np.ptp(height_cm, axis=0) >= _SLOPE_CM)
            self._slopes = np.concatenate([self._slopes, slopes])
        self._offset_m = smooth_offsets(comfortable_offsets(self._room_m))


def comfortable_offsets(room_m: F64) -> F64:
    """(N,) offset to the left for room (N, 2) left and right: off an edge, or between two.

    >>> comfortable_offsets(np.array([[1.6, 1.6], [1.6, 0.4], [0.8, 0.4]])).round(2).tolist()
    [0.0, 0.26, 0.2]
    """
    left, right = room_m[:, 0], room_m[:, 1]
    away = np.maximum(_COMFORT_M - right, 0.0) - np.maximum(_COMFORT_M - left, 0.0)
    return np.where(left + right < 2.0 * _COMFORT_M, 0.5 * (left - right), away)


def smooth_offsets(offset_m: F64) -> F64:
    """(N,) offsets that are reached a little before the place that needs them, without a jump."""
    reach = round(_SPREAD_M / _STATION_M)
    padded = np.pad(offset_m, 2 * reach, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    largest = np.take_along_axis(windows, np.abs(windows).argmax(axis=1)[:, None], axis=1)[:, 0]
    windows = np.lib.stride_tricks.sliding_window_view(largest, 2 * reach + 1)
    return np.asarray(windows.mean(axis=1), np.float64)


@compile_exact_kernel
def _measure_room(
    line: F64,
    left: F64,
    height_cm: U8,
    clearance_dm: U8,
    ground_class: U8,
    origin_m: F64,
    cell_m: float,
) -> F64:
    """(N, 2) metres from each point of a line to the first kerb, wall or road, left and right."""
    rows, cols = height_cm.shape
    room = np.empty((len(line), 2))
    for i in range(len(line)):
        for side in range(2):
            sign = 1.0 - 2.0 * side
            before_cm, on_road = -1, False
            room[i, side] = FARTHEST_M
            for step in range(int(FARTHEST_M / _STEP_M) + 1):
                x = line[i, 0] + sign * step * _STEP_M * left[i, 0]
                y = line[i, 1] + sign * step * _STEP_M * left[i, 1]
                col = min(max(math.floor((x - origin_m[0]) / cell_m), 0), cols - 1)
                row = min(max(math.floor((y - origin_m[1]) / cell_m), 0), rows - 1)
                here_cm = int(height_cm[row, col])
                road_here = ground_class[row, col] == _ROAD or ground_class[row, col] == _RAIL
                kerb = before_cm >= 0 and abs(here_cm - before_cm) > KERB_STEP_CM
                if (
                    kerb
                    or clearance_dm[row, col] < _SOLID_DM
                    or (road_here and step > 0 and not on_road)
                ):
                    room[i, side] = step * _STEP_M
                    break
                if step == 0:
                    on_road = road_here
                before_cm = here_cm
    return room
