"""The one geometry that all renderers draw: the standing street in small chunks, and the models of the actors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from wcsim.physics.renderer.models.catalog import ActorTemplates, actor_templates
from wcsim.physics.renderer.models.paint import MARK_CLASS
from wcsim.physics.renderer.street_paint import SurfacePaint, paint_street
from wcsim.types import F32, I32, U8, GroundPaint, StreetMesh

CHUNK_M = 16.0  # a chunk much larger is mostly outside the view, one much smaller costs more to cull than to draw


class GeometryStore:
    """Immutable triangles of a street, regrouped into cells of `chunk_m`, and of the actor templates.

    Faces of chunk c are `chunk_faces[c]:chunk_faces[c + 1]`; they index the chunk's own vertices from its first one on.
    """

    def __init__(self, mesh: StreetMesh, chunk_m: float = CHUNK_M) -> None:
        paint = paint_street(mesh.vertices_W_m, mesh.faces, mesh.face_class)
        order, self.chunk_faces = _by_cell(mesh, chunk_m)
        self.vertices_W_m, self.faces, self.chunk_vertices = _own_vertices(mesh, order, self.chunk_faces)
        self.face_class: U8 = np.ascontiguousarray(mesh.face_class[order])  # (F,)
        self.paint = SurfacePaint(rgb=paint.rgb[order], pattern=paint.pattern[order], frame=paint.frame[order])
        self.spheres_W_m = _spheres(self.vertices_W_m, self.chunk_vertices)  # (C, 4) x, y, z, radius
        self.templates: ActorTemplates = actor_templates()
        self.marks = GeometryStore(_as_mesh(mesh.paint)) if len(mesh.paint.mark) else None  # drawn in colours alone

    @classmethod
    def joined(cls, parts: Sequence[GeometryStore]) -> GeometryStore:
        """The parts as one; much cheaper than the store of a mesh joined from theirs. Raises ValueError without any."""
        store = cls.__new__(cls)
        store.vertices_W_m = np.concatenate([part.vertices_W_m for part in parts])
        store.faces = np.concatenate([part.faces for part in parts])
        store.face_class = np.concatenate([part.face_class for part in parts])
        store.chunk_vertices = _end_to_end([part.chunk_vertices for part in parts])
        store.chunk_faces = _end_to_end([part.chunk_faces for part in parts])
        store.paint = SurfacePaint(
            rgb=np.concatenate([part.paint.rgb for part in parts]),
            pattern=np.concatenate([part.paint.pattern for part in parts]),
            frame=np.concatenate([part.paint.frame for part in parts]),
        )
        store.spheres_W_m = np.concatenate([part.spheres_W_m for part in parts])
        store.templates = actor_templates()
        marks = [part.marks for part in parts if part.marks is not None]
        store.marks = cls.joined(marks) if marks else None
        return store

    @property
    def chunk_count(self) -> int:
        """Number of chunks."""
        return len(self.chunk_faces) - 1

    def global_faces(self) -> I32:
        """Faces (F, 3) that index `vertices_W_m` as a whole."""
        start = np.repeat(self.chunk_vertices[:-1], np.diff(self.chunk_faces))
        return np.asarray(self.faces + start[:, None], np.int32)


def _as_mesh(paint: GroundPaint) -> StreetMesh:
    """Marks as a mesh of one chunk, whose classes are `paint.mark_class`."""
    count = len(paint.mark)
    corners = np.arange(4 * count, dtype=np.int32).reshape(-1, 4)
    return StreetMesh(
        vertices_W_m=paint.quads_W_m.reshape(-1, 3),
        faces=corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3),
        face_class=np.repeat(paint.mark + MARK_CLASS, 2).astype(np.uint8),
        chunk_vertices=np.array([0, 4 * count], np.int32),
        chunk_faces=np.array([0, 2 * count], np.int32),
    )


def _end_to_end(starts: Sequence[I32]) -> I32:
    """Starts of chunks, each list ending with its total, as one such list."""
    before = np.cumsum([0, *(part[-1] for part in starts)])
    shifted = [part[:-1] + base for part, base in zip(starts, before[:-1], strict=True)]
    return np.concatenate([*shifted, before[-1:]]).astype(np.int32)


def _by_cell(mesh: StreetMesh, chunk_m: float) -> tuple[npt.NDArray[np.int64], I32]:
    """Order (F,) that sorts the faces by cell of their middle, and the start of each cell in it (C + 1,)."""
    middle = mesh.vertices_W_m[mesh.faces].mean(axis=1)[:, :2]
    cell = np.floor(middle / chunk_m).astype(np.int64)
    cell -= cell.min(axis=0, initial=0)
    key = cell[:, 0] * (cell[:, 1].max(initial=0) + 1) + cell[:, 1]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    return order, np.append(starts, len(key)).astype(np.int32)


def _own_vertices(mesh: StreetMesh, order: npt.NDArray[np.int64], chunk_faces: I32) -> tuple[F32, I32, I32]:
    """Vertices chunk by chunk (shared ones copied), faces that count from the chunk's first vertex, vertex starts."""
    count = max(len(mesh.vertices_W_m), 1)
    chunk = np.repeat(np.arange(len(chunk_faces) - 1), np.diff(chunk_faces))
    pairs, place = np.unique(chunk[:, None] * count + mesh.faces[order], return_inverse=True)
    starts = np.searchsorted(pairs, np.arange(len(chunk_faces)) * count)
    faces = place.reshape(-1, 3) - starts[chunk][:, None]
    vertices = np.ascontiguousarray(mesh.vertices_W_m[pairs % count], np.float32)
    return vertices, np.ascontiguousarray(faces, np.int32), starts.astype(np.int32)


def _spheres(vertices: F32, starts: I32) -> F32:
    """Bounding sphere (C, 4) of each chunk: middle of its box and the farthest vertex from there."""
    if len(starts) < 2:
        return np.zeros((0, 4), np.float32)
    first = starts[:-1]
    centre = 0.5 * (np.minimum.reduceat(vertices, first) + np.maximum.reduceat(vertices, first))
    away = np.linalg.norm(vertices - np.repeat(centre, np.diff(starts), axis=0), axis=1)
    radius = np.maximum.reduceat(away, first) * 1.0001 + 1e-3  # room for float32 rounding
    return np.concatenate([centre, radius[:, None]], axis=1, dtype=np.float32)
