"""Where to go, drawn into pictures: the way as dots on the ground, the destination as a flag."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from wcsim.physics.renderer.base import Pinhole
from wcsim.types import F32, F64, U8, Route
from wcsim.types.street import Ground

_AHEAD_M: Final = 30.0
_EVERY_M: Final = 0.9
_OVER_M: Final = 0.06  # so high above the ground, or it would lie in it
_DOT_M: Final = 0.13  # radius
_POLE_M: Final = 2.4
_BEHIND_M: Final = 0.35  # so much nearer a thing hides a dot
WAY_RGB, GOAL_RGB, RIM_RGB, CHAIR_RGB = (0, 122, 94), (196, 30, 58), (255, 255, 255), (16, 92, 184)


def ground_points(route: Route, done_m: float, grid: Ground) -> F64:
    """Points (n, 3) of the way on the ground ahead; the last is the destination, however far.

    Args:
        route: The way.
        done_m: How far along it the chair is.
        grid: The ground's heights.
    """
    length_m = float(route.arc_m[-1])
    first_m = math.ceil((done_m + 1.2) / _EVERY_M) * _EVERY_M  # on a raster: dots lie still while the chair drives
    arcs_m = np.append(np.arange(first_m, min(done_m + _AHEAD_M, length_m), _EVERY_M), length_m)
    xy = np.column_stack([np.interp(arcs_m, route.arc_m, route.points_W_m[:, axis]) for axis in (0, 1)])
    return np.column_stack([xy, np.asarray(grid.height_at(xy), np.float64) + _OVER_M])


def mark_way(image: U8, depth_m: F32, camera: Pinhole, T_CW: F64, points_W_m: F64) -> U8:
    """Draw the way into a picture, behind what stands before it; the picture itself is returned.

    Args:
        image: (H, W, 3) RGB, written to.
        depth_m: (H, W) of the same picture.
        camera: That took it.
        T_CW: (3, 4) world to camera frame.
        points_W_m: (n, 3) see `ground_points`.
    """
    for point in points_W_m[:-1][::-1]:
        seen = _seen(point, camera, T_CW, depth_m)
        if seen is not None:
            u, v, far_m = seen
            radius = max(2, round(camera.focal_px * _DOT_M / far_m))
            axes = (radius, max(1, round(radius * 0.45)))
            cv2.ellipse(image, (u, v), axes, 0.0, 0.0, 360.0, WAY_RGB, cv2.FILLED, cv2.LINE_AA)
            cv2.ellipse(image, (u, v), axes, 0.0, 0.0, 360.0, RIM_RGB, 1, cv2.LINE_AA)
    foot, top = points_W_m[-1], points_W_m[-1] + (0.0, 0.0, _POLE_M)
    seen, above = _seen(foot, camera, T_CW, depth_m), _pixel(top, camera, T_CW)
    if seen is not None and above is not None:
        u, v, _ = above
        size = max(6, abs(seen[1] - v) // 3)
        cv2.line(image, seen[:2], (u, v), RIM_RGB, max(2, size // 6), cv2.LINE_AA)
        flag = np.array([(u, v), (u + round(1.4 * size), v + size // 2), (u, v + size)], np.int32)
        cv2.fillPoly(image, [flag], GOAL_RGB, cv2.LINE_AA)
        cv2.polylines(image, [flag], True, RIM_RGB, 1, cv2.LINE_AA)
    return image


def mark_chair(chart: U8, yaw_rad: float) -> U8:
    """Draw the chair into the middle of a map (S, S, 3) as an arrow, larger than it is; the map is returned."""
    middle, (ahead, left) = 0.5 * chart.shape[0], (math.cos(yaw_rad), math.sin(yaw_rad))
    corners = [(11.0, 0.0), (-8.0, 7.0), (-4.0, 0.0), (-8.0, -7.0)]
    arrow = [(middle + a * ahead - b * left, middle - a * left - b * ahead) for a, b in corners]
    cv2.fillPoly(chart, [np.array(arrow, np.int32)], CHAIR_RGB, cv2.LINE_AA)
    cv2.polylines(chart, [np.array(arrow, np.int32)], True, RIM_RGB, 2, cv2.LINE_AA)
    return chart


def mark_goal(chart: U8, goal_m: F64, span_m: float) -> U8:
    """Draw the destination into a map (S, S, 3), north up with the chair in the middle; one beyond it at the edge.

    Args:
        chart: Written to, and returned.
        goal_m: (2,) from the chair, x east and y north.
        span_m: From edge to edge.
    """
    size = chart.shape[0]
    scale, reach = size / span_m, 0.5 * size - 12.0
    away = np.array([goal_m[0], -goal_m[1]]) * scale
    far = float(np.abs(away).max())
    inside = far <= reach
    u, v = (0.5 * size + (away if inside else away * (reach / far))).round().astype(int).tolist()
    if inside:
        cv2.line(chart, (u, v), (u, v - 16), RIM_RGB, 2, cv2.LINE_AA)
    flag = np.array([(u, v - 16), (u + 12, v - 11), (u, v - 6)] if inside else _arrow(u, v, away), np.int32)
    cv2.fillPoly(chart, [flag], GOAL_RGB, cv2.LINE_AA)
    cv2.polylines(chart, [flag], True, RIM_RGB, 1, cv2.LINE_AA)
    return chart


def _arrow(u: int, v: int, along: F64) -> list[tuple[float, float]]:
    x, y = along / np.hypot(*along)
    return [(u + 9 * x, v + 9 * y), (u - 6 * x - 7 * y, v - 6 * y + 7 * x), (u - 6 * x + 7 * y, v - 6 * y - 7 * x)]


def _pixel(point_W_m: F64, camera: Pinhole, T_CW: F64) -> tuple[int, int, float] | None:
    """Column, row and depth of a point; None behind the camera."""
    x, y, z = (T_CW[:, :3] @ point_W_m + T_CW[:, 3]).tolist()
    if z < 0.3:
        return None
    u = 0.5 * camera.width_px + camera.focal_px * x / z
    v = 0.5 * camera.height_px + camera.focal_px * y / z
    return (round(u), round(v), z) if abs(u) < 1e4 and abs(v) < 1e4 else None


def _seen(point_W_m: F64, camera: Pinhole, T_CW: F64, depth_m: F32) -> tuple[int, int, float] | None:
    """The same, for a point that is in the picture with nothing before it."""
    found = _pixel(point_W_m, camera, T_CW)
    if found is None or not (0 <= found[0] < camera.width_px and 0 <= found[1] < camera.height_px):
        return None
    return found if depth_m[found[1], found[0]] > found[2] - _BEHIND_M * (1.0 + 0.05 * found[2]) else None
