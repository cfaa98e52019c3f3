"""Plane geometry, also for areas as large as a city: its cost grows with the area alone."""

from typing import Literal

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.types import F64

_FINEST_M = 64.0
BLOCK_M = 400.0
# Blocks overlap. Side by side they would part along cracks as thin as a number's last digit.
_LAP_M = 0.05
WHOLE_M = 1200.0  # areas up to this size are buffered as they are
_ARC = 16  # segments a quarter circle: shapely's own


def cross_z(a: F64, b: F64) -> F64:
    """Upward component (...,) of the cross product of plane vectors (..., 2).

    It is positive when b lies to the left of a.

    >>> float(cross_z(np.array([1.0, 0.0]), np.array([0.0, 2.0])))
    2.0
    """
    area: F64 = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return area


def left_of(way: F64) -> F64:
    """Plane vectors (..., 2) turned a quarter to the left."""
    return np.stack([-way[..., 1], way[..., 0]], axis=-1)


def unit(way: F64) -> F64:
    """A plane vector (2,) of length 1 in the same direction; that of nothing stays nothing."""
    return np.asarray(way / max(1e-6, float(np.hypot(*way))))


def units(ways: F64) -> F64:
    """Plane vectors (n, 2) of length 1 in the same directions; those of nothing stay nothing."""
    return np.asarray(ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9))


def yaw_of(way: F64) -> float:
    """The direction of a plane vector (2,), in rad counter-clockwise from east."""
    return float(np.arctan2(way[1], way[0]))


def distinct(points_m: F64) -> F64:
    """A polyline (K, 2) without points that repeat the one before; it has one at least."""
    return np.asarray(points_m[np.r_[True, np.any(np.diff(points_m, axis=0) != 0.0, axis=1)]])


def arc_of(points_m: F64) -> F64:
    """The length (K,) of a polyline (K, 2) up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))])


def length_of(points_m: F64) -> float:
    """Length in metres of a polyline (K, 2)."""
    return float(np.linalg.norm(np.diff(points_m, axis=0), axis=1).sum())


def valid(area: BaseGeometry) -> BaseGeometry:
    """The same area, mended where it crosses itself.

    Buffers on a grid and fast clips cross themselves, and overlays fail there.
    """
    if area.is_valid:
        return area
    return shapely.make_valid(area, method="structure", keep_collapsed=False)


def polygons_of(area: BaseGeometry, least_m2: float = 0.0) -> list[Polygon]:
    """The polygons in a geometry that are larger than so much, without its lines and points."""
    parts = [part for whole in shapely.get_parts(area) for part in shapely.get_parts(whole)]
    return [part for part in parts if part.geom_type == "Polygon" and part.area > least_m2]


class Patches:
    """An area cut into overlapping squares of several sizes: only small ones are ever clipped."""

    def __init__(self, area: BaseGeometry) -> None:
        self._area = area
        bounds = area.bounds if not area.is_empty else (0.0, 0.0, 1.0, 1.0)
        size_m = max(bounds[2] - bounds[0], bounds[3] - bounds[1], _FINEST_M)
        self._left_m, self._bottom_m = bounds[0], bounds[1]
        self._levels = int(np.ceil(np.log2(size_m / _FINEST_M)))
        self._cut: dict[tuple[int, int, int], BaseGeometry] = {}

    def near(self, bounds: tuple[float, float, float, float]) -> BaseGeometry:
        """The part of the area inside a rectangle (x0, y0, x1, y1); empty where all are NaN."""
        x0, y0, x1, y1 = bounds
        if np.isnan(x0):
            return Polygon()
        size_m = max(x1 - x0, y1 - y0, _FINEST_M)
        level = int(np.ceil(np.log2(size_m / _FINEST_M)))
        edge_m = _FINEST_M * 2.0**level
        col = int((0.5 * (x0 + x1) - self._left_m) // edge_m)
        row = int((0.5 * (y0 + y1) - self._bottom_m) // edge_m)
        return _clipped(self._square(level, col, row), bounds)

    def _square(self, level: int, col: int, row: int) -> BaseGeometry:
        """The area in one square and half a square around it."""
        if level > self._levels:
            return self._area
        key = (level, col, row)
        if key not in self._cut:
            edge_m = _FINEST_M * 2.0**level
            x0, y0 = self._left_m + (col - 0.5) * edge_m, self._bottom_m + (row - 0.5) * edge_m
            around = self._square(level + 1, col // 2, row // 2)
            self._cut[key] = _clipped(around, (x0, y0, x0 + 2.0 * edge_m, y0 + 2.0 * edge_m))
        return self._cut[key]


def buffered(
    area: BaseGeometry,
    distance_m: float,
    *,
    join_style: Literal["round", "mitre"] = "round",
    mitre_limit: float = 5.0,
    quad_segs: int = _ARC,
) -> BaseGeometry:
    """As shapely's own buffer, whose time grows with the square of an area's parts and holes."""

    def buffer(part: BaseGeometry) -> BaseGeometry:
        wide = part.buffer(
            distance_m, quad_segs=quad_segs, join_style=join_style, mitre_limit=mitre_limit
        )
        return valid(wide)

    x0, y0, x1, y1 = area.bounds if not area.is_empty else (0.0, 0.0, 0.0, 0.0)
    if max(x1 - x0, y1 - y0) <= WHOLE_M:
        return buffer(area)
    patches, beside_m = Patches(area), _LAP_M + max(2.0, 8.0 * abs(distance_m))
    reach_m = max(0.0, distance_m) * max(1.0, mitre_limit)
    blocks: list[BaseGeometry] = []
    for x in np.arange(x0 - reach_m, x1 + reach_m, BLOCK_M):
        for y in np.arange(y0 - reach_m, y1 + reach_m, BLOCK_M):
            end_x, end_y = x + BLOCK_M, y + BLOCK_M
            around = (x - beside_m, y - beside_m, end_x + beside_m, end_y + beside_m)
            near = patches.near(around)
            if not near.is_empty:
                blocks.append(_clipped(buffer(near), (x, y, end_x + _LAP_M, end_y + _LAP_M)))
    return shapely.union_all(blocks)


def _clipped(area: BaseGeometry, bounds: tuple[float, float, float, float]) -> BaseGeometry:
    """The part of an area inside a rectangle."""
    # GEOS 3.14's fast clipping fails where an area only touches the rectangle.
    try:
        return valid(shapely.clip_by_rect(area, *bounds))
    except shapely.GEOSException:
        return area.intersection(shapely.box(*bounds))
