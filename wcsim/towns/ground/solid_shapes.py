"""Solid things as triangles that are counter-clockwise seen from outside."""

from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely import Polygon

from wcsim.towns.ground.plane_geometry import cross_z
from wcsim.types import F64, I32, U8


@dataclass(frozen=True, slots=True, kw_only=True)
class Solid:
    """A closed thing with triangles of one or more classes."""

    vertices_W_m: F64  # (V, 3)
    faces: I32  # (F, 3)
    face_class: U8  # (F,)


def joined(pieces: list[Solid]) -> Solid:
    """Several pieces as one."""
    offsets = np.cumsum([0, *(len(piece.vertices_W_m) for piece in pieces)])
    faces = [piece.faces + offset for piece, offset in zip(pieces, offsets, strict=False)]
    return Solid(
        vertices_W_m=np.concatenate([piece.vertices_W_m for piece in pieces]),
        faces=np.concatenate(faces).astype(np.int32),
        face_class=np.concatenate([piece.face_class for piece in pieces]),
    )


def moved(piece: Solid, xy_m: F64, yaw_rad: float = 0.0) -> Solid:
    """A piece turned about the z axis of its own frame, whose origin then goes to a point."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    vertices = piece.vertices_W_m.copy()
    vertices[:, :2] = piece.vertices_W_m[:, :2] @ np.array([[c, s], [-s, c]]) + xy_m
    return replace(piece, vertices_W_m=vertices)


def raised(piece: Solid, height_m: float | F64) -> Solid:
    """A piece lifted by one height, or each vertex by its own (V,)."""
    vertices = piece.vertices_W_m.copy()
    vertices[:, 2] += height_m
    return replace(piece, vertices_W_m=vertices)


def scaled(piece: Solid, factors: tuple[float, float, float]) -> Solid:
    """A piece made longer, wider and higher; what reaches into the ground stays as deep."""
    vertices = piece.vertices_W_m * (factors[0], factors[1], 1.0)
    vertices[:, 2] *= np.where(vertices[:, 2] > 0.0, factors[2], 1.0)
    return replace(piece, vertices_W_m=vertices)


def prism(
    outline: Polygon, low_m: float, high_m: float, class_id: int, floor: bool = False
) -> Solid:
    """An upright prism over a polygon with or without holes: walls, a flat roof, maybe a floor."""
    # The solid has to lie on the left of its rings.
    oriented = shapely.orient_polygons(outline)
    outlines = (oriented.exterior, *oriented.interiors)
    rings = [shapely.get_coordinates(ring)[:-1] for ring in outlines]
    number = {(x, y): i for i, (x, y) in enumerate(np.concatenate(rings).tolist())}
    corners, _, _ = triangles_of(outline)
    rows = [[number[x, y] for x, y in corner] for corner in corners.tolist()]
    cover = np.array(rows, np.int32).reshape(-1, 3)
    return _extruded(rings, cover, low_m, high_m, class_id, floor)


def post(
    xy_m: F64,
    radius_m: float,
    low_m: float,
    high_m: float,
    class_id: int,
    sides: int = 6,
    floor: bool = False,
) -> Solid:
    """An upright regular prism."""
    return _convex_prism(_ring(xy_m, radius_m, sides), low_m, high_m, class_id, floor)


def box(
    xy_m: F64,
    size_lwh_m: tuple[float, float, float],
    low_m: float,
    yaw_rad: float,
    class_id: int,
    floor: bool = False,
) -> Solid:
    """An upright box turned about its middle."""
    ring = shapely.get_coordinates(rectangle(xy_m, size_lwh_m[0], size_lwh_m[1], yaw_rad))[:-1]
    return _convex_prism(ring, low_m, low_m + size_lwh_m[2], class_id, floor)


def disc(x_m: float, radius_m: float, thick_m: float, class_id: int, sides: int = 8) -> Solid:
    """A wheel that stands on the ground at (x, 0) and rolls along x."""
    lying = post(np.zeros(2), radius_m, -thick_m / 2, thick_m / 2, class_id, sides, floor=True)
    x, y, z = lying.vertices_W_m.T
    upright = np.column_stack([x + x_m, -z, y + radius_m])  # a quarter turn about x
    return replace(lying, vertices_W_m=upright)


def rectangle(xy_m: F64, length_m: float, width_m: float, yaw_rad: float) -> Polygon:
    """A rectangle turned about its middle."""
    half = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (length_m, width_m)
    turn = np.array([[np.cos(yaw_rad), np.sin(yaw_rad)], [-np.sin(yaw_rad), np.cos(yaw_rad)]])
    return Polygon(half @ turn + xy_m)


def spindle(
    xy_m: F64, levels_m: tuple[tuple[float, float], ...], class_id: int, sides: int = 7
) -> Solid:
    """A tree's crown: rings of (radius, height) from the bottom up, pointed where a radius is 0."""
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
    table = np.array([face for face in faces if len(set(face)) == 3], np.int32)
    return Solid(
        vertices_W_m=np.concatenate(vertices),
        faces=table,
        face_class=np.full(len(table), class_id, np.uint8),
    )


def triangles_of(faces: Polygon | np.ndarray) -> tuple[F64, I32, F64]:
    """The triangles of polygons.

    Returns:
        Corners (F, 3, 2), counter-clockwise; the polygon (F,) of each, and twice its area (F,).
    """
    cut = shapely.constrained_delaunay_triangles(faces)
    parts, owner = shapely.get_parts(cut, return_index=True)
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    twice_area = cross_z(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners[twice_area < 0] = corners[twice_area < 0][:, ::-1]
    return corners, owner.astype(np.int32), np.abs(twice_area)


def _convex_prism(
    ring: F64, low_m: float, high_m: float, class_id: int, floor: bool = False
) -> Solid:
    """A prism over a convex ring (N, 2), counter-clockwise and open; far cheaper than `prism`."""
    middle = np.arange(1, len(ring) - 1, dtype=np.int32)
    cover = np.stack([np.zeros_like(middle), middle, middle + 1], axis=1)
    return _extruded([ring], cover, low_m, high_m, class_id, floor)


def _extruded(
    rings: list[F64], cover: I32, low_m: float, high_m: float, class_id: int, floor: bool
) -> Solid:
    """Walls along rings with the solid on their left, and `cover` (R, 3) over all their corners."""
    base = np.concatenate(rings)
    count = len(base)
    walls: list[I32] = []
    first = 0
    for ring in rings:
        a = first + np.arange(len(ring))
        b = first + np.roll(np.arange(len(ring)), -1)
        walls += [np.stack([a, b, b + count], axis=1), np.stack([a, b + count, a + count], axis=1)]
        first += len(ring)
    ends = [cover + count, cover[:, ::-1]] if floor else [cover + count]
    faces = np.concatenate([*walls, *ends]).astype(np.int32)
    vertices = np.empty((2 * count, 3))
    vertices[:, :2] = np.tile(base, (2, 1))
    vertices[:, 2] = np.repeat([low_m, high_m], count)
    face_class = np.full(len(faces), class_id, np.uint8)
    return Solid(vertices_W_m=vertices, faces=faces, face_class=face_class)


def _ring(xy_m: F64, radius_m: float, sides: int) -> F64:
    angle = 2.0 * np.pi * np.arange(sides) / sides
    return np.asarray(xy_m) + radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
