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

from wcsim.towns.plane import cross_z
from wcsim.towns.surfaces import GRID_M, Surfaces
from wcsim.types import F64, I32, U8, Bool, ClassId

CELL_M = 40.0  # side of a chunk
RAMP_RUN = 12.6  # metres of ramp for one metre of height: 1:12 also where a ring cuts a corner
THIN_M = 0.06  # points are dropped whose triangle with their neighbours is smaller than half of this squared
STEEPEST = 1.0 / 12.0
RING_CHORD = 0.96  # the chords of a ring come this close to the middle of its arc


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """Triangles of the ground, counter-clockwise from above; low and raised ground have vertices of their own."""

    vertices_W_m: F64  # (V, 3)
    faces: I32  # (F, 3)
    face_class: U8  # (F,) ClassId
    low: Bool  # (F,) carriageway and crossings
    cell: I32  # (F, 2) the chunk that a face belongs to


@dataclass(frozen=True, slots=True, kw_only=True)
class Kerbing:
    """Heights of raised ground, and the lines where it comes down to the road."""

    top_m: float
    drop_m: float  # height of a lowered kerb
    dropped: BaseGeometry  # where crossings meet the pavement

    @property
    def ramp_m(self) -> float:
        """Length of a ramp."""
        return RAMP_RUN * max(0.0, self.top_m - self.drop_m)

    def height_m(self, xy_m: F64) -> F64:
        """Height (n,) of raised ground at (n, 2)."""
        if self.dropped.is_empty or self.ramp_m == 0.0 or not len(xy_m):
            return np.full(len(xy_m), self.top_m)
        far_m = shapely.distance(self.dropped, shapely.points(xy_m))
        share = np.clip(far_m / (RING_CHORD * self.ramp_m), 0.0, 1.0)
        height_m: F64 = np.round(self.drop_m + (self.top_m - self.drop_m) * share, 5)
        return height_m


def kerbing_of(surfaces: Surfaces, top_m: float, drop_m: float) -> Kerbing:
    """Kerbs are lowered where the edge of a crossing touches pavement."""
    edge = surfaces.crossing.boundary.intersection(surfaces.pavement.buffer(2 * GRID_M))
    lines = [part for part in shapely.get_parts(edge) if part.geom_type == "LineString" and part.length > 0.1]
    dropped = shapely.MultiLineString(lines)
    shapely.prepare(dropped)
    return Kerbing(top_m=top_m, drop_m=min(drop_m, top_m), dropped=dropped)


def build_ground(surfaces: Surfaces, kerbing: Kerbing) -> Ground:
    """Cut, classify and triangulate the ground."""
    faces = _faces(surfaces, kerbing)
    inside = shapely.point_on_surface(faces)
    classes = classify(surfaces, shapely.get_coordinates(inside))
    kept = classes != ClassId.VOID
    faces, classes = faces[kept], classes[kept]
    triangles, owner = _triangles(faces)
    face_class = classes[owner]
    low = (face_class == ClassId.ROAD) | (face_class == ClassId.CROSSWALK)
    vertices, indices = _index(triangles, low, kerbing)
    vertices[:, 2] = _eased(vertices, indices[~low])
    middle_m = triangles.mean(axis=1)
    return Ground(
        vertices_W_m=vertices,
        faces=indices,
        face_class=face_class,
        low=low,
        cell=np.floor(middle_m / CELL_M).astype(np.int32),
    )


def classify(surfaces: Surfaces, xy_m: F64) -> U8:
    """Ground class (n,) of points (n, 2); VOID outside the town."""
    classes = np.zeros(len(xy_m), dtype=np.uint8)
    for area, class_id in (
        (surfaces.hull, ClassId.TERRAIN),
        (surfaces.pavement, ClassId.SIDEWALK),
        (surfaces.low, ClassId.ROAD),
        (surfaces.crossing, ClassId.CROSSWALK),
    ):
        shapely.prepare(area)
        classes[shapely.contains_xy(area, xy_m)] = class_id
    return classes


def _faces(surfaces: Surfaces, kerbing: Kerbing) -> np.ndarray:
    """Polygons between all boundaries, ramp rings and chunk borders."""
    lines = [surfaces.low.boundary, surfaces.crossing.boundary, surfaces.pavement.boundary, surfaces.hull.boundary]
    if kerbing.ramp_m > 0.0 and not kerbing.dropped.is_empty:
        rings = kerbing.dropped.buffer(kerbing.ramp_m, quad_segs=3).boundary
        lines.append(rings.difference(surfaces.low))
    lines.append(_chunk_borders(surfaces.hull))
    noded = shapely.unary_union(lines, grid_size=GRID_M)
    faces = np.asarray(shapely.get_parts(shapely.polygonize(shapely.get_parts(noded))))
    return np.asarray(shapely.coverage_simplify(faces, THIN_M))


def _chunk_borders(hull: BaseGeometry) -> BaseGeometry:
    x0, y0, x1, y1 = hull.bounds
    xs, ys = (np.arange(np.ceil(a / CELL_M), np.floor(b / CELL_M) + 1) * CELL_M for a, b in ((x0, x1), (y0, y1)))
    lines = [[(x, y0 - 1), (x, y1 + 1)] for x in xs] + [[(x0 - 1, y), (x1 + 1, y)] for y in ys]
    return shapely.MultiLineString(lines).intersection(hull)


def _triangles(faces: np.ndarray) -> tuple[F64, I32]:
    """Triangles (F, 3, 2) counter-clockwise, and the face (F,) that each belongs to."""
    groups = [shapely.get_parts(item) for item in shapely.constrained_delaunay_triangles(faces)]
    owner = np.repeat(np.arange(len(groups), dtype=np.int32), [len(group) for group in groups])
    corners = shapely.get_coordinates(np.concatenate(groups)).reshape(-1, 4, 2)[:, :3]
    twice_area = cross_z(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners[twice_area < 0] = corners[twice_area < 0][:, ::-1]
    kept = np.abs(twice_area) > 0
    return corners[kept], owner[kept]


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
        steep = slope > 1.02 * STEEPEST
        if not steep.any():
            break
        foot = h[steep].min(axis=1, keepdims=True)
        eased = foot + (h[steep] - foot) * (STEEPEST / slope[steep])[:, None]
        np.minimum.at(height_m, faces[steep], eased)
    return np.round(height_m, 5)
