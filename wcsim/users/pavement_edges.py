"""Where a pavement ends on both sides of a route, how far to keep from there, and where its ground begins to slope.

A route may pass a kerb at little more than half a chair's width, and a person does not: where there is room, the user
drives a little aside of such a route. A ramp whose sides fall away twists under a chair, lifts one of its wheels and
throws it off its line, so people go slowly there.
"""

from __future__ import annotations

import math

import numpy as np

from wcsim.core.constants import KERB_STEP_CM
from wcsim.core.jit import exact_kernel
from wcsim.types import F64, U8, ClassId, Ground
from wcsim.users.route_line import Path

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
        first, last = max(0, int(arc_m / _STATION_M)), max(1, math.ceil((arc_m + ahead_m) / _STATION_M))
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
            room = _rooms(line, left, grid.height_cm, grid.clearance_dm, grid.ground_class, origin_m, grid.cell_m)
            self._room = np.concatenate([self._room, room])
            aside_m = _WHEEL_M * np.stack([left, np.zeros_like(left), -left])  # (3, _PIECE, 2)
            height_cm = grid.height_cm[grid.cells(line + aside_m)].astype(np.int64)  # (3, _PIECE)
            along = np.abs(np.diff(height_cm, axis=1, append=height_cm[:, -1:])).max(axis=0)
            self._slopes = np.concatenate([self._slopes, (along >= SLOPE_CM) | (np.ptp(height_cm, axis=0) >= SLOPE_CM)])
        self._aside = spread(wanted_aside(self._room))


def wanted_aside(room_m: F64) -> F64:
    """(N,) offset to the left for room (N, 2) left and right: clear of an edge, or halfway between two.

    >>> wanted_aside(np.array([[1.6, 1.6], [1.6, 0.4], [0.8, 0.4]])).round(2).tolist()
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
    return np.asarray(np.lib.stride_tricks.sliding_window_view(largest, 2 * reach + 1).mean(axis=1), np.float64)


@exact_kernel
def _rooms(
    line: F64, left: F64, height_cm: U8, clearance_dm: U8, ground_class: U8, origin_m: F64, cell_m: float
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
                if kerb or clearance_dm[row, col] < SOLID_DM or (road_here and step > 0 and not on_road):
                    room[i, side] = step * STEP_M
                    break
                if step == 0:
                    on_road = road_here
                before_cm = here_cm
    return room
