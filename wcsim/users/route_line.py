"""A route as a line to drive along: where a point is on it, how fast its corners can be taken."""

import math
from bisect import bisect_left, bisect_right
from typing import Final, NamedTuple

import numpy as np

from wcsim.core.jit import compile_exact_kernel
from wcsim.errors import ConfigError
from wcsim.types import F64, Route

_CORNER_WINDOW_M: Final = 0.6  # turns within this distance of each other are one corner
_GENTLE_TURN_RAD: Final = 0.15
_HINT_BACK_M: Final = 3.0
_HINT_AHEAD_M: Final = 8.0
_LOST_M: Final = 3.0  # farther from the hinted stretch than this, the whole route is searched
_SAME_M: Final = 1e-6


class _RoutePoint(NamedTuple):
    """A point seen from the route."""

    arc_m: float  # along the route
    left_m: float  # beside it, left positive


class RoutePolyline:
    """A route prepared for quick queries; immutable."""

    def __init__(self, route: Route) -> None:
        """Raises ConfigError when the route has no point."""
        points = np.asarray(route.points_W_m, np.float64)
        if len(points) == 0:
            raise ConfigError(
                "the route has no points; expected at least one: draw another destination"
            )
        steps = np.hypot(*np.diff(points, axis=0).T) if len(points) > 1 else np.zeros(0)
        points = points[np.r_[True, steps > _SAME_M]]
        # A route to where the chair stands: the direction does not matter.
        if len(points) == 1:
            points = np.vstack([points, points + np.array([1e-3, 0.0])])
        self._points = points
        along = np.diff(points, axis=0)
        self._lengths = np.hypot(along[:, 0], along[:, 1])
        self._unit = along / self._lengths[:, None]
        self._arc: list[float] = np.r_[0.0, np.cumsum(self._lengths)].tolist()
        self._headings = np.arctan2(along[:, 1], along[:, 0])
        # (arc, angle turned around there) of every bend worth slowing down for, in order
        self._corners: list[tuple[float, float]] = []
        turns = np.diff(self._headings)
        turns = np.abs((turns + np.pi) % (2.0 * np.pi) - np.pi)
        at = np.array(self._arc[1:-1])
        for arc_m, turn in zip(at.tolist(), turns.tolist(), strict=True):
            sharpness = float(turns[np.abs(at - arc_m) <= 0.5 * _CORNER_WINDOW_M].sum())
            if turn > 1e-3 and sharpness > _GENTLE_TURN_RAD:
                self._corners.append((arc_m, sharpness))

    @property
    def length_m(self) -> float:
        """The length of the whole route."""
        return self._arc[-1]

    def project(self, x_m: float, y_m: float, hint_m: float) -> _RoutePoint:
        """The nearest place on the route, near `hint_m` first: a route may cross itself."""
        first = self._segment(hint_m - _HINT_BACK_M)
        last = max(first + 1, bisect_left(self._arc, hint_m + _HINT_AHEAD_M))
        place, distance = self._nearest(x_m, y_m, first, last)
        return place if distance <= _LOST_M else self._nearest(x_m, y_m, 0, len(self._unit))[0]

    def at(self, arc_m: float, left_m: float = 0.0) -> tuple[float, float]:
        """The point (x, y) at a place; beyond both ends the line goes on straight."""
        i = self._segment(arc_m)
        (x, y), (ux, uy) = self._points[i].tolist(), self._unit[i].tolist()
        ahead = arc_m - self._arc[i]
        return x + ahead * ux - left_m * uy, y + ahead * uy + left_m * ux

    def heading(self, arc_m: float) -> float:
        """The direction of the route at a place, radians."""
        return float(self._headings[self._segment(arc_m)])

    def speed_limit(
        self, arc_m: float, turn_radps: float, brake_mps2: float, ahead_m: float
    ) -> float:
        """How fast to go at `arc_m` to take every corner within `ahead_m` at `turn_radps`."""
        limit_mps = math.inf
        first = bisect_left(self._corners, (arc_m - _CORNER_WINDOW_M, -math.inf))
        for corner_m, sharpness_rad in self._corners[first:]:
            if corner_m > arc_m + ahead_m:
                break
            corner_mps = turn_radps * _CORNER_WINDOW_M / sharpness_rad
            brake_m = max(0.0, corner_m - arc_m - _CORNER_WINDOW_M)
            limit_mps = min(limit_mps, math.sqrt(corner_mps**2 + 2.0 * brake_mps2 * brake_m))
        return limit_mps

    def _segment(self, arc_m: float) -> int:
        return min(max(bisect_right(self._arc, arc_m) - 1, 0), len(self._unit) - 1)

    def _nearest(self, x_m: float, y_m: float, first: int, last: int) -> tuple[_RoutePoint, float]:
        i, ahead_m, left_m, off_m = _nearest(
            self._points, self._unit, self._lengths, x_m, y_m, first, last
        )
        return _RoutePoint(self._arc[i] + ahead_m, left_m), off_m


@compile_exact_kernel
def _nearest(
    points: F64, unit: F64, lengths: F64, x_m: float, y_m: float, first: int, last: int
) -> tuple[int, float, float, float]:
    """Segment, distance along it, to its left, and off it, of the point nearest to (x, y)."""
    best, best_ahead_m, best_left_m, best_m = first, 0.0, 0.0, np.inf
    for i in range(first, min(last, len(unit))):
        dx, dy = x_m - points[i, 0], y_m - points[i, 1]
        ahead_m = min(max(dx * unit[i, 0] + dy * unit[i, 1], 0.0), lengths[i])
        off_m = math.hypot(dx - ahead_m * unit[i, 0], dy - ahead_m * unit[i, 1])
        if off_m < best_m:
            best, best_ahead_m, best_m = i, ahead_m, off_m
            best_left_m = math.copysign(off_m, unit[i, 0] * dy - unit[i, 1] * dx)
    return best, best_ahead_m, best_left_m, best_m
