"""Solid things as triangles: prisms, posts, trees, benches. Triangles are counter-clockwise seen from outside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from shapely import Polygon

from wcsim.towns.plane import cross_z
from wcsim.types import F64, I32, U8


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A closed thing with triangles of one or more classes."""

    vertices_W_m: F64  # (V, 3)
    faces: I32  # (F, 3)
    face_class: U8  # (F,)


def joined(pieces: list[Piece]) -> Piece:
    """Several pieces as one."""
    offsets = np.cumsum([0, *(len(piece.vertices_W_m) for piece in pieces)])
    return Piece(
        vertices_W_m=np.concatenate([piece.vertices_W_m for piece in pieces]),
        faces=np.concatenate([p.faces + offset for p, offset in zip(pieces, offsets, strict=False)]).astype(np.int32),
        face_class=np.concatenate([piece.face_class for piece in pieces]),
    )


def prism(outline: Polygon, low_m: float, high_m: float, class_id: int) -> Piece:
    """An upright prism over a polygon with or without holes: walls and a flat roof, no floor."""
    oriented = shapely.orient_polygons(outline)  # outline counter-clockwise, holes clockwise
    rings = [shapely.get_coordinates(ring)[:-1] for ring in (oriented.exterior, *oriented.interiors)]
    base = np.concatenate(rings)  # (N, 2)
    count = len(base)
    walls: list[I32] = []
    first = 0
    for ring in rings:
        a = first + np.arange(len(ring))
        b = first + np.roll(np.arange(len(ring)), -1)
        walls += [np.stack([a, b, b + count], axis=1), np.stack([a, b + count, a + count], axis=1)]
        first += len(ring)
    roof = _roof(outline, base) + count
    faces = np.concatenate([*walls, roof]).astype(np.int32)
    vertices = np.empty((2 * count, 3))
    vertices[:, :2] = np.tile(base, (2, 1))
    vertices[:, 2] = np.repeat([low_m, high_m], count)
    return Piece(vertices_W_m=vertices, faces=faces, face_class=np.full(len(faces), class_id, np.uint8))


def post(xy_m: F64, radius_m: float, low_m: float, high_m: float, class_id: int, sides: int = 6) -> Piece:
    """An upright regular prism."""
    return prism(Polygon(_ring(xy_m, radius_m, sides)), low_m, high_m, class_id)


def box(xy_m: F64, size_lwh_m: tuple[float, float, float], low_m: float, yaw_rad: float, class_id: int) -> Piece:
    """An upright box turned about its middle."""
    return prism(rectangle(xy_m, size_lwh_m[0], size_lwh_m[1], yaw_rad), low_m, low_m + size_lwh_m[2], class_id)


def rectangle(xy_m: F64, length_m: float, width_m: float, yaw_rad: float) -> Polygon:
    """A rectangle turned about its middle."""
    half = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (length_m, width_m)
    turn = np.array([[np.cos(yaw_rad), np.sin(yaw_rad)], [-np.sin(yaw_rad), np.cos(yaw_rad)]])
    return Polygon(half @ turn + xy_m)


def spindle(xy_m: F64, levels_m: tuple[tuple[float, float], ...], class_id: int, sides: int = 7) -> Piece:
    """Rings of (radius, height) from the bottom up, pointed at both ends where the radius is 0: a tree's crown."""
    vertices: list[F64] = []
    faces: list[tuple[int, int, int]] = []
    below: list[int] = []
    for radius_m, height_m in levels_m:
        ring = _ring(xy_m, radius_m, sides) if radius_m > 0.0 else np.asarray(xy_m)[None]
        start = sum(len(item) for item in vertices)
        vertices.append(np.column_stack([ring, np.full(len(ring), height_m)]))
        here = [start + i % len(ring) for i in range(sides)]
        for i in range(sides if below else 0):
            j = (i + 1) % sides
            faces += [(below[i], below[j], here[j]), (below[i], here[j], here[i])]
        below = here
    table = np.array([face for face in faces if len(set(face)) == 3], dtype=np.int32)
    return Piece(vertices_W_m=np.concatenate(vertices), faces=table, face_class=np.full(len(table), class_id, np.uint8))


def _ring(xy_m: F64, radius_m: float, sides: int) -> F64:
    angle = 2.0 * np.pi * np.arange(sides) / sides
    return np.asarray(xy_m) + radius_m * np.column_stack([np.cos(angle), np.sin(angle)])


def _roof(outline: Polygon, base: F64) -> I32:
    """Triangles (R, 3) over the outline, as indices into its corners."""
    number = {(x, y): i for i, (x, y) in enumerate(base.tolist())}
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(outline))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    turned = cross_z(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) < 0
    corners[turned] = corners[turned][:, ::-1]
    return np.array([[number[x, y] for x, y in corner] for corner in corners.tolist()], dtype=np.int32).reshape(-1, 3)
