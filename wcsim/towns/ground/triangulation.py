"""The ground as triangles without holes, overlaps or T-junctions.

All boundaries are drawn as lines, cut where they meet, and the faces between them are triangulated without new points;
so two faces that touch share the points of their border. At crossings the pavement falls to the road, along rings of
equal distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from wcsim.towns.ground.kerb_heights import STEEPEST, Kerbing
from wcsim.towns.ground.plane_geometry import WHOLE_M, Patches, buffered, cross_z
from wcsim.towns.ground.surfaces import GRID_M, Surfaces
from wcsim.towns.ground.tiles import CHUNK_M
from wcsim.types import F64, I32, U8, Bool, ClassId, Relief
from wcsim.types.street import FLAT

BLOCK_M = 5 * CHUNK_M  # of a large town that is cut at a time
BESIDE_M = 2.0
THIN_M = 0.06  # points are dropped whose triangle with their neighbours is smaller than half of this squared
LOW_CLASSES = (ClassId.ROAD, ClassId.CROSSWALK, ClassId.RAIL_TRACK)  # at the height of the road


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundMesh:
    """Triangles of the ground, counter-clockwise from above; low and raised ground have vertices of their own."""

    vertices_W_m: F64  # (V, 3)
    faces: I32  # (F, 3)
    face_class: U8  # (F,) ClassId
    low: Bool  # (F,) carriageway and crossings
    cell: I32  # (F, 2) the chunk that a face belongs to


def build_ground(surfaces: Surfaces, kerbing: Kerbing, relief: Relief = FLAT) -> GroundMesh:
    """Cut, classify and triangulate the ground; where the land is not level, no triangle crosses a fold of it."""
    faces = _faces(surfaces, kerbing, relief)
    inside = shapely.point_on_surface(faces)
    classes = _classify(surfaces, shapely.get_coordinates(inside))
    kept = classes != ClassId.VOID
    faces, classes = faces[kept], classes[kept]
    triangles, owner = _triangles(faces)
    face_class = classes[owner]
    low = np.isin(face_class, LOW_CLASSES)
    vertices, indices = _index(triangles, low, kerbing)
    vertices[:, 2] = _eased(vertices, indices[~low])
    middle_m = triangles.mean(axis=1)
    return GroundMesh(
        vertices_W_m=vertices,
        faces=indices,
        face_class=face_class,
        low=low,
        cell=np.floor(middle_m / CHUNK_M).astype(np.int32),
    )


def _classify(surfaces: Surfaces, xy_m: F64) -> U8:
    """Ground class (n,) of points (n, 2); VOID outside the town."""
    classes = np.zeros(len(xy_m), dtype=np.uint8)
    for area, class_id in (
        (surfaces.hull, ClassId.TERRAIN),
        (surfaces.paved, ClassId.GROUND),
        (surfaces.parking, ClassId.PARKING),
        (surfaces.pavement, ClassId.SIDEWALK),
        (surfaces.low, ClassId.ROAD),
        (surfaces.rail, ClassId.RAIL_TRACK),
        (surfaces.crossing, ClassId.CROSSWALK),
        (surfaces.unpainted, ClassId.ROAD),
    ):
        shapely.prepare(area)
        classes[shapely.contains_xy(area, xy_m)] = class_id
    return classes


def _faces(surfaces: Surfaces, kerbing: Kerbing, relief: Relief) -> np.ndarray:
    """Polygons between all boundaries, ramp rings, chunk borders and folds of the land."""
    areas = [surfaces.low, surfaces.crossing, surfaces.pavement, surfaces.rail, surfaces.hull]
    areas += [surfaces.unpainted, surfaces.paved, surfaces.parking]
    lines = [area.boundary for area in areas if not area.is_empty]
    for place in kerbing.lowered:
        lines.append(buffered(place.lines, place.ramp_m, quad_segs=3).boundary.difference(surfaces.low))
    lines.append(_chunk_borders(surfaces.hull))
    if relief is not FLAT:
        lines.append(_folds(surfaces.hull, relief))
    x0, y0, x1, y1 = surfaces.hull.bounds
    if max(x1 - x0, y1 - y0) <= WHOLE_M:
        return np.asarray(shapely.coverage_simplify(_between(lines), THIN_M))
    patches = [Patches(line) for line in lines]
    corners = [
        np.arange(np.floor(low / BLOCK_M), np.ceil(high / BLOCK_M)) * BLOCK_M for low, high in ((x0, x1), (y0, y1))
    ]
    return np.concatenate([_block(patches, x, y) for x in corners[0] for y in corners[1]])


def _block(lines: list[Patches], x: float, y: float) -> np.ndarray:
    """The faces in one square; its border is one of chunks, and neighbours cut it at the same points."""
    around = (x - BESIDE_M, y - BESIDE_M, x + BLOCK_M + BESIDE_M, y + BLOCK_M + BESIDE_M)
    faces = _between([line.near(around) for line in lines])
    inside = np.floor(shapely.get_coordinates(shapely.point_on_surface(faces)) / BLOCK_M) * BLOCK_M
    own = faces[(inside == (x, y)).all(axis=1)] if len(faces) else faces
    return np.asarray(shapely.coverage_simplify(own, THIN_M, simplify_boundary=False)) if len(own) else own


def _between(lines: list[BaseGeometry]) -> np.ndarray:
    """The polygons between lines."""
    noded = shapely.unary_union(lines, grid_size=GRID_M)
    return np.asarray(shapely.get_parts(shapely.polygonize(shapely.get_parts(noded))))


def _chunk_borders(hull: BaseGeometry) -> BaseGeometry:
    x0, y0, x1, y1 = hull.bounds
    xs, ys = (np.arange(np.ceil(a / CHUNK_M), np.floor(b / CHUNK_M) + 1) * CHUNK_M for a, b in ((x0, x1), (y0, y1)))
    lines = [[(x, y0 - 1), (x, y1 + 1)] for x in xs] + [[(x0 - 1, y), (x1 + 1, y)] for y in ys]
    return shapely.MultiLineString(lines).intersection(hull)


def _folds(hull: BaseGeometry, relief: Relief) -> BaseGeometry:
    """The lines along which the land may bend: its lattice, and diagonals from lower left to upper right."""
    rows, cols = relief.z_m.shape
    x0, y0 = relief.origin_W_m
    x1, y1 = x0 + (cols - 1) * relief.cell_m, y0 + (rows - 1) * relief.cell_m
    xs, ys = x0 + relief.cell_m * np.arange(cols), y0 + relief.cell_m * np.arange(rows)
    lines = [[(x, y0), (x, y1)] for x in xs] + [[(x0, y), (x1, y)] for y in ys]
    for shift in range(1 - rows, cols - 1):
        first, last = max(0, shift), min(cols - 1, rows - 1 + shift)
        lines.append([(xs[first], ys[first - shift]), (xs[last], ys[last - shift])])
    return shapely.MultiLineString(lines).intersection(hull)


def _triangles(faces: np.ndarray) -> tuple[F64, I32]:
    """Triangles (F, 3, 2) counter-clockwise, and the face (F,) that each belongs to."""
    parts, owner = shapely.get_parts(shapely.constrained_delaunay_triangles(faces), return_index=True)
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    twice_area = cross_z(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners[twice_area < 0] = corners[twice_area < 0][:, ::-1]
    kept = np.abs(twice_area) > 0
    return corners[kept], owner[kept].astype(np.int32)


def _index(triangles: F64, low: Bool, kerbing: Kerbing) -> tuple[F64, I32]:
    """Shared vertices (V, 3) and faces (F, 3); the raised side of a border has vertices of its own."""
    keys = np.empty((len(triangles), 3, 3), dtype=np.int64)
    keys[:, :, :2] = np.rint(triangles / GRID_M)
    keys[:, :, 2] = ~low[:, None]
    unique, inverse = np.unique(keys.reshape(-1, 3), axis=0, return_inverse=True)
    vertices = np.zeros((len(unique), 3))
    vertices[:, :2] = unique[:, :2] * GRID_M
    raised = unique[:, 2] == 1
    vertices[raised, 2] = kerbing.height_m(vertices[raised, :2])
    return vertices, inverse.reshape(-1, 3).astype(np.int32)


def _eased(vertices: F64, faces: I32) -> F64:
    """Heights (V,) lowered until no face is steeper than a ramp: a thin face may tilt though its corners are right."""
    height_m = vertices[:, 2].copy()
    a, b = (vertices[faces[:, k], :2] - vertices[faces[:, 0], :2] for k in (1, 2))
    twice_area = cross_z(a, b)
    for _ in range(300):
        h = height_m[faces]
        u, w = h[:, 1] - h[:, 0], h[:, 2] - h[:, 0]
        slope = np.hypot(u * b[:, 1] - w * a[:, 1], w * a[:, 0] - u * b[:, 0]) / twice_area
        steep = slope > STEEPEST
        if not steep.any():
            break
        foot = h[steep].min(axis=1, keepdims=True)
        eased = foot + (h[steep] - foot) * (0.98 * STEEPEST / slope[steep])[:, None]
        np.minimum.at(height_m, faces[steep], eased)
    return np.round(height_m, 5)
