"""Convex primitives in metres, and the pieces with class and paint that the models of the actors are lists of.

Every primitive is closed and its faces are counter-clockwise seen from outside: the rasteriser may skip back faces.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from wcsim.physics.renderer.models.paint import Paint
from wcsim.types import F64, ClassId

Point = tuple[float, float, float]

LAMP_RADIUS_M = 0.1  # of a traffic light
LAMP_APART_M = 0.26
LAMP_DEPTH_M = 0.05
_SKIN_M = 0.01  # plates and panes float this far above the body, enough for the depth buffer within a camera's range


@dataclass(frozen=True, slots=True)
class Part:
    """One closed convex piece (or a flat decal) of a model."""

    vertices_m: F64  # (V, 3)
    faces: npt.NDArray[np.int64]  # (T, 3) indices into vertices_m, counter-clockwise seen from outside


@dataclass(frozen=True, slots=True)
class BodyPart:
    """A part of a model with its class and paint; faces that look towards `top_along` take the paint `top`."""

    part: Part
    class_id: ClassId
    paint: Paint
    top: Paint | None = None
    top_along: Point = (0.0, 0.0, 1.0)  # unit vector
    top_from: float = 0.9  # least cosine between a face's normal and it


def box(low: Point, high: Point) -> Part:
    """A box between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return _between_rings([(x, y, z0) for x, y in ring], [(x, y, z1) for x, y in ring])


def prism(profile_xz: Sequence[tuple[float, float]], half_width: float, taper: float = 1.0) -> Part:
    """A convex profile in the x-z plane, pushed out along y to +-half_width; `taper` narrows what lies highest."""
    heights = [z for _, z in profile_xz]
    low, high = min(heights), max(heights)

    def half(z: float) -> float:
        return half_width * (1.0 + (taper - 1.0) * (z - low) / (high - low))

    right = [(x, -half(z), z) for x, z in profile_xz]
    left = [(x, half(z), z) for x, z in profile_xz]
    return _between_rings(right, left)


def wheel(x: float, y: float, radius: float, width: float, sides: int) -> Part:
    """A wheel that stands on the ground at (x, y), axle along y."""
    turn = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    grow = 1.0 / np.cos(np.pi / sides)  # the polygon's flat sides, not its corners, stand on the ground
    ring = [(x + grow * radius * np.cos(a), radius * (1.0 + grow * np.sin(a))) for a in turn]
    right = [(px, y - 0.5 * width, max(pz, 0.0)) for px, pz in ring]
    left = [(px, y + 0.5 * width, max(pz, 0.0)) for px, pz in ring]
    return _between_rings(right, left)


def limb(start: Point, end: Point, start_radius: float, end_radius: float, sides: int = 5) -> Part:
    """A tapered rod between two points: arms, legs, tubes of a frame."""
    a, b = np.array(start), np.array(end)
    axis = (b - a) / np.linalg.norm(b - a)
    # Any direction across will do but one along the axis, whose cross product is 0.
    side = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    turns = 2.0 * np.pi * np.arange(sides) / sides
    around = np.outer(np.cos(turns), side) + np.outer(np.sin(turns), other)
    return _between_rings(a + start_radius * around, b + end_radius * around)


def rod(start: Point, end: Point, radius: float = 0.022) -> Part:
    """A tube."""
    return limb(start, end, radius, radius, sides=4)


def barrel(
    low_z: float, high_z: float, low: tuple[float, float], high: tuple[float, float], x: float, lean: float, sides: int
) -> Part:
    """A trunk of some sides; `low` and `high` are half axes (x, y) of its ends, `lean` shifts the upper one in x."""
    turns = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    ring = np.c_[np.cos(turns), np.sin(turns)] / np.cos(np.pi / sides)
    lower = np.c_[x + low[0] * ring[:, 0], low[1] * ring[:, 1], np.full(sides, low_z)]
    upper = np.c_[x + lean + high[0] * ring[:, 0], high[1] * ring[:, 1], np.full(sides, high_z)]
    return _between_rings(lower, upper)


def ball(centre: Point, half_axes: Point, around: int = 6, rings: int = 3) -> Part:
    """An ellipsoid of `rings` rings between two poles."""
    turns = 2.0 * np.pi * np.arange(around) / around
    tilts = np.pi * (np.arange(rings) + 1) / (rings + 1)
    unit = [(np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)) for t in tilts for a in turns]
    unit += [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
    top, bottom = around * rings, around * rings + 1
    faces = []
    for i in range(around):
        j = (i + 1) % around
        faces += [(top, i, j), (bottom, around * (rings - 1) + j, around * (rings - 1) + i)]
        for ring in range(rings - 1):
            p, q = around * ring, around * (ring + 1)
            faces += [(p + i, q + i, q + j), (p + i, q + j, p + j)]
    return _outward(np.array(unit) * half_axes + np.array(centre), faces)


def decal(corners: Sequence[Point]) -> Part:
    """A flat rectangle on the skin of a model, four corners counter-clockwise seen from outside."""
    return Part(np.array(corners, np.float64), np.array([(0, 1, 2), (0, 2, 3)], np.int64))


def plate(x: float, y: float, z: float, half_width: float, half_height: float, facing: int) -> Part:
    """A rectangle across x that faces forward (1) or backward (-1)."""
    x += _SKIN_M * facing
    near, far = y - half_width * facing, y + half_width * facing
    low, high = z - half_height, z + half_height
    return decal([(x, near, low), (x, far, low), (x, far, high), (x, near, high)])


def pane(x0: float, x1: float, y: float, low: float, high: float) -> Part:
    """A rectangle along x on the left (y > 0) or right side of a body."""
    y += math.copysign(_SKIN_M, y)
    start, end = (x1, x0) if y > 0 else (x0, x1)
    return decal([(start, y, low), (end, y, low), (end, y, high), (start, y, high)])


def lamp(z: float) -> Part:
    """A lamp of a traffic light, its middle at a height; it shines along x."""
    return limb((0.0, 0.0, z), (LAMP_DEPTH_M, 0.0, z), LAMP_RADIUS_M, LAMP_RADIUS_M, sides=8)


def _between_rings(first: Any, second: Any) -> Part:
    """The hull between two convex rings of as many corners."""
    n = len(first)
    faces = []
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j, n + j), (i, n + j, n + i)]
    for i in range(1, n - 1):
        faces += [(0, i, i + 1), (n, n + i, n + i + 1)]
    return _outward(np.concatenate([np.asarray(first, np.float64), np.asarray(second, np.float64)]), faces)


def _outward(vertices: F64, faces: Sequence[tuple[int, int, int]]) -> Part:
    """Turn every face of a convex piece so that its normal points away from the middle."""
    index = np.array(faces, np.int64)
    a, b, c = (vertices[index[:, k]] for k in range(3))
    # In a convex piece every face looks away from the middle, so lists of corners may have any order.
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3.0 - vertices.mean(axis=0)) < 0.0
    index[inward] = index[inward][:, [0, 2, 1]]
    return Part(vertices, index)
