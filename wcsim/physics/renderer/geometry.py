"""The one geometry that all renderers draw: the standing street in small chunks.

It is painted here, too: a shaded colour per face, and where stripes or windows are (RGB only).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from wcsim.physics.renderer.kernels import (
    ASPHALT,
    GRASS,
    SLABS,
    STRIPES,
    WINDOWS,
    StreetArrays,
    U32Array,
)
from wcsim.physics.renderer.models.paint import (
    AMBIENT,
    DIFFUSE,
    LEAF_RGB,
    MARK_CLASS,
    ROOF_RGB,
    STONE_CLASS,
    STONES_M,
    SUN_W,
    TRUNK_RGB,
    WALL_RGB,
    class_paint_table,
)
from wcsim.types import F32, F64, I32, I64, U8, Bool, ClassId, GroundPaint, StreetMesh
from wcsim.types.street import join_meshes

# A chunk much larger is mostly out of view; one much smaller costs more to cull than to draw.
CHUNK_M = 16.0
WELD_M = 0.02
_STONE_M = 0.16  # a kerb's stone is so wide,
_STONE_LIFT_M = 0.025  # and so far above the ground
_STONES = 4  # to a straight piece of a kerb
_HAIR_M = 1e-4
BAY_M = 2.8
_TRUNK_WIDE_M = 0.6  # a green thing no wider than this is a tree's trunk
_GROUNDS = {  # what the ground is laid with: a grain that becomes finer with the distance
    (ClassId.SIDEWALK,): SLABS,
    (ClassId.ROAD, ClassId.PARKING, ClassId.RAIL_TRACK, ClassId.GROUND): ASPHALT,
    (ClassId.TERRAIN,): GRASS,
}
_WINDOW_WALL_MIN_M = 4.0  # lower walls are sheds and get no windows


class GeometryStore:
    """Immutable triangles of a street in cells of `CHUNK_M`; its marks show in colours alone."""

    def __init__(self, mesh: StreetMesh) -> None:
        rgb, pattern, frame = _paint_street(mesh.vertices_W_m, mesh.faces, mesh.face_class)
        # 1. Sort the faces by the cell of their middle. The sort is stable, so that of equal depths
        # the first drawn stays.
        middle = mesh.vertices_W_m[mesh.faces].mean(axis=1)[:, :2]
        cell = np.floor(middle / CHUNK_M).astype(np.int64)
        cell -= cell.min(axis=0, initial=0)
        key = cell[:, 0] * (cell[:, 1].max(initial=0) + 1) + cell[:, 1]
        order = np.argsort(key, kind="stable")
        starts = np.flatnonzero(np.diff(key[order], prepend=-1))
        chunk_faces = np.append(starts, len(key)).astype(np.int32)

        # 2. A vertex that two chunks share is copied: each chunk is transformed alone, and only
        # when it is in view. Faces count from their chunk's first vertex.
        count = max(len(mesh.vertices_W_m), 1)
        chunk = np.repeat(np.arange(len(chunk_faces) - 1), np.diff(chunk_faces))
        pairs, place = np.unique(chunk[:, None] * count + mesh.faces[order], return_inverse=True)
        vertices = np.ascontiguousarray(mesh.vertices_W_m[pairs % count], np.float32)
        first = np.searchsorted(pairs, np.arange(len(chunk_faces)) * count)
        faces = place.reshape(-1, 3) - first[chunk][:, None]

        # 3. A sphere round each chunk: the middle of its box, and the farthest vertex from there,
        # with room for rounding in float32. It is not the smallest, but takes one pass over the
        # vertices; a larger one only culls less.
        own = first[:-1]
        centre = 0.5 * (np.minimum.reduceat(vertices, own) + np.maximum.reduceat(vertices, own))
        away = np.linalg.norm(vertices - np.repeat(centre, np.diff(first), axis=0), axis=1)
        radius = np.maximum.reduceat(away, own) * 1.0001 + 1e-3
        self.arrays = StreetArrays(
            vertices=vertices,
            faces=np.ascontiguousarray(faces, np.int32),
            face_class=np.ascontiguousarray(mesh.face_class[order]),
            chunk_vertices=first.astype(np.int32),
            chunk_faces=chunk_faces,
            spheres=np.concatenate([centre, radius[:, None]], axis=1, dtype=np.float32),
            rgb=rgb[order],
            pattern=pattern[order],
            frame=frame[order],
        )
        marks = join_meshes((_as_mesh(mesh.paint), _kerb_stones(mesh)))
        self.marks = GeometryStore(marks) if len(marks.faces) else None

    @classmethod
    def joined(cls, parts: Sequence[GeometryStore]) -> GeometryStore:
        """The parts as one; much cheaper than the store of a mesh joined from theirs.

        Raises:
            ValueError: There is no part.
        """
        store = cls.__new__(cls)
        columns = zip(*(part.arrays for part in parts), strict=True)
        store.arrays = StreetArrays._make(
            _end_to_end(column) if name.startswith("chunk") else np.concatenate(column)
            for name, column in zip(StreetArrays._fields, columns, strict=True)
        )
        marks = [part.marks for part in parts if part.marks is not None]
        store.marks = cls.joined(marks) if marks else None
        return store

    def global_faces(self) -> I32:
        """Faces (F, 3) that index the vertices as a whole."""
        start = np.repeat(self.arrays.chunk_vertices[:-1], np.diff(self.arrays.chunk_faces))
        return self.arrays.faces + start[:, None]


def _paint_street(vertices_W_m: F32, faces: I32, face_class: U8) -> tuple[U32Array, U8, F32]:
    """Colour, pattern and frame of (V, 3) vertices and (F, 3) faces, see `StreetArrays`."""
    # 1. Colours, shaded by the normals. A face without area has no normal: zeros instead of a
    # division by zero.
    corners = vertices_W_m[faces].astype(np.float64)  # (F, 3 corners, 3)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    thing = _connected_parts(vertices_W_m, faces, face_class)
    foot, top = _extent(corners[:, :, 2], thing)
    # What is steeper than 60 degrees is a wall, the rest of a building its roof.
    steep = np.abs(normal[:, 2]) < 0.5
    east, north = (np.subtract(*_extent(corners[:, :, axis], thing)[::-1]) for axis in (0, 1))
    thin = np.maximum(east, north) < _TRUNK_WIDE_M
    shade = AMBIENT + DIFFUSE * np.maximum(normal @ SUN_W, 0.0)
    colour = _colours(face_class, corners, thing, steep, thin) * shade[:, None]
    red, green, blue = np.clip(colour, 0, 255).astype(np.uint32).T
    rgb = red | green << 8 | blue << 16

    # 2. Patterns.
    pattern = np.zeros(len(faces), np.uint8)
    windows = (face_class == ClassId.BUILDING) & steep & (top - foot > _WINDOW_WALL_MIN_M)
    pattern[windows] = WINDOWS
    for grounds, kind in _GROUNDS.items():
        pattern[np.isin(face_class, grounds) & ~steep] = kind
    stripes = face_class == ClassId.CROSSWALK
    pattern[stripes] = STRIPES

    # 3. The frame: along the wall, or across the stripes. A wall has whole bays of about BAY_M, so
    # that no corner of a house cuts a window in two; else a bay is 1 m. Both triangles of a wall
    # have the same extent along it, and so the same windows.
    axis = np.c_[-normal[:, 1], normal[:, 0]]
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12)
    axis[stripes] = _walking_axes(vertices_W_m, faces, face_class, thing)[stripes]
    along = np.einsum("fcx,fx->fc", corners[:, :, :2], axis)
    length = np.maximum(np.ptp(along, axis=1), 1e-6)
    bays = np.where(windows, np.maximum(np.rint(length / BAY_M), 1.0) / length, 1.0)
    start = np.where(windows, along.min(axis=1) * bays, 0.0)
    frame = np.concatenate([axis * bays[:, None], np.c_[start, foot]], axis=1, dtype=np.float32)
    return rgb, pattern, frame


def _connected_parts(vertices_W_m: F32, faces: I32, face_class: U8) -> I64:
    """Number (F,) int64, dense from 0, of the connected thing that each face belongs to.

    Such a thing is a building, a crossing or a tree. Faces are connected where they share a corner
    (to WELD_M) and a class.
    """
    if len(faces) == 0:
        return np.zeros(0, np.int64)
    weld = _welded(vertices_W_m)
    _, corner = np.unique(weld[faces] * 256 + face_class[:, None], return_inverse=True)
    corner = corner.reshape(-1, 3)
    label = np.arange(corner.max() + 1)
    while True:
        low = label[corner].min(axis=1)
        new = label.copy()
        for k in range(3):
            np.minimum.at(new, corner[:, k], low)
        new = new[new]  # jump, so that long things settle in few rounds
        if np.array_equal(new, label):
            break
        label = new
    return np.unique(label[corner[:, 0]], return_inverse=True)[1].astype(np.int64)


def _welded(vertices_W_m: F32) -> I64:
    """A number for the place of every vertex (V,); vertices of one WELD_M cell share it."""
    cell = np.rint(vertices_W_m.astype(np.float64) / WELD_M).astype(np.int64)
    cell -= cell.min(axis=0, initial=0)
    # Three numbers as one in a mixed radix: `unique` over rows would take many times as long.
    spans = cell.max(axis=0, initial=0) + 1
    number = (cell[:, 0] * spans[1] + cell[:, 1]) * spans[2] + cell[:, 2]
    return np.unique(number, return_inverse=True)[1].astype(np.int64)


def _extent(at_m: F64, thing: I64) -> tuple[F64, F64]:
    """Least and largest coordinate (F,) of each face's thing, from the faces' corners (F, 3)."""
    count = int(thing.max()) + 1 if len(thing) else 0
    foot, top = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(foot, thing, at_m.min(axis=1))
    np.maximum.at(top, thing, at_m.max(axis=1))
    return foot[thing], top[thing]


def _colours(face_class: U8, corners: F64, thing: I64, steep: Bool, thin: Bool) -> F64:
    """Unshaded colour (F, 3) of every face: by class, and by chance for each building and tree."""
    # 1. A random number for each thing, by the place where its corners (F, 3, 3) begin. To 0.1 m:
    # a rounding of the corners must not repaint a house.
    first = np.full((int(thing.max(initial=-1)) + 1, 2), np.inf)
    np.minimum.at(first, thing, corners[:, :, :2].min(axis=1))
    place = np.rint(first * 10.0).astype(np.int64).astype(np.uint64)
    # A spatial hash by two primes, then Knuth's multiplier, which mixes the high bits well.
    mixed = place[:, 0] * np.uint64(73856093) ^ place[:, 1] * np.uint64(19349663)
    mixed *= np.uint64(2654435761)
    dice = (mixed[thing] >> np.uint64(40)).astype(np.int64)

    # 2. Colours.
    colour = class_paint_table()[face_class]
    building, tree = face_class == ClassId.BUILDING, face_class == ClassId.VEGETATION
    things = (
        (building & steep, WALL_RGB),
        (building & ~steep, ROOF_RGB),
        (tree, LEAF_RGB),
        (tree & thin, TRUNK_RGB),
    )
    for where, choices in things:
        table = np.array(choices, np.float64)
        colour[where] = table[dice[where] % len(table)]
    return colour


def _walking_axes(vertices_W_m: F32, faces: I32, face_class: U8, thing: I64) -> F64:
    """The walking direction (F, 2) in W over the crossing of each face; zeros for other faces.

    It is the mean direction of the edges where the crossing borders on the road; else it is (1, 0).
    """
    place = _welded(vertices_W_m)
    count = int(place.max(initial=0)) + 1
    crossing, road = face_class == ClassId.CROSSWALK, face_class == ClassId.ROAD
    following = np.roll(faces, -1, axis=1)
    start, end = place[faces], place[following]  # (F, 3 edges)
    borders = np.isin(end * count + start, (start * count + end)[road]) & crossing[:, None]
    step = (vertices_W_m[following] - vertices_W_m[faces])[:, :, :2].astype(np.float64)
    pull = step[..., 0] + 1j * step[..., 1]
    # Twice the angle, as an edge has no sign.
    pull = np.where(borders, pull * pull / np.maximum(np.abs(pull), 1e-9), 0.0)
    total = np.zeros(int(thing.max(initial=0)) + 1, np.complex128)
    np.add.at(total, thing, pull.sum(axis=1))
    turn = 0.5 * np.angle(total[thing])
    return np.where(crossing[:, None], np.stack([np.cos(turn), np.sin(turn)], axis=1), 0.0)


def _kerb_stones(mesh: StreetMesh) -> StreetMesh:
    """Strips along the upper edges of kerbs, coloured by height.

    From behind a chair no kerb shows its face. That is two triangles, see `kerb_walls`: one has
    both upper corners and a lower one, below its last; the other has both lower corners, and is
    missing where the kerb runs out. A strip is cut, as a kerb may rise along it.
    """
    # 1. How far the kerb rises at both ends of each face.
    is_kerb = np.isin(mesh.face_class, (ClassId.KERB, ClassId.LOWERED_KERB))
    kerbs = mesh.faces[is_kerb].astype(np.int64)
    corners = mesh.vertices_W_m[kerbs].astype(np.float64)  # (K, 3 corners, 3)
    upper = np.abs(corners[:, 0, :2] - corners[:, 2, :2]).max(axis=1, initial=0.0) < _HAIR_M
    across = np.where(upper, kerbs[:, 1], kerbs[:, 2])
    diagonal = kerbs[:, 0] * max(len(mesh.vertices_W_m), 1) + across
    _, lower, at = np.intersect1d(diagonal[~upper], diagonal[upper], return_indices=True)
    foot, far, near = np.moveaxis(corners[upper], 1, 0)
    rise_m = np.c_[(near - foot)[:, 2], np.zeros(len(near))]
    rise_m[at, 1] = (corners[~upper][lower, 2] - corners[~upper][lower, 1])[:, 2]

    # 2. The stones; the road is on the other side.
    along = far - near
    inward = np.c_[along[:, 1], -along[:, 0], np.zeros(len(along))]
    inward *= _STONE_M / np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), _HAIR_M)
    quads, kinds = [], []
    lift = np.array([0.0, 0.0, _STONE_LIFT_M])
    for begin, end in pairwise(np.linspace(0.0, 1.0, _STONES + 1)):
        height_m = rise_m @ (1.0 - 0.5 * (begin + end), 0.5 * (begin + end))
        one, other = near + begin * along, near + end * along
        quads.append(np.stack([other, one, one + inward, other + inward], axis=1) + lift)
        kinds.append(np.searchsorted(STONES_M, height_m + _HAIR_M, side="right") - 1)
    kind = np.concatenate(kinds)
    shown = kind >= 0
    quads_W_m = np.concatenate(quads)[shown].astype(np.float32)
    paint = GroundPaint(quads_W_m=quads_W_m, mark=kind[shown].astype(np.uint8))
    return _as_mesh(paint, STONE_CLASS)


def _as_mesh(paint: GroundPaint, first_class: int = MARK_CLASS) -> StreetMesh:
    """Marks as a mesh of one chunk, whose classes begin with the first one."""
    count = len(paint.mark)
    corners = np.arange(4 * count, dtype=np.int32).reshape(-1, 4)
    return StreetMesh(
        vertices_W_m=paint.quads_W_m.reshape(-1, 3),
        faces=corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3),
        face_class=np.repeat(paint.mark + first_class, 2).astype(np.uint8),
        chunk_vertices=np.array([0, 4 * count], np.int32),
        chunk_faces=np.array([0, 2 * count], np.int32),
    )


def _end_to_end(starts: Sequence[I32]) -> I32:
    """Starts of chunks, each list ending with its total, as one such list."""
    before = np.cumsum([0, *(part[-1] for part in starts)])
    shifted = [part[:-1] + base for part, base in zip(starts, before[:-1], strict=True)]
    return np.concatenate([*shifted, before[-1:]]).astype(np.int32)
