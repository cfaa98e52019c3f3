"""Ground, kerbs, buildings and furniture as one StreetMesh, in chunks that can be culled and merged alone."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from wcsim.towns.ground.solid_shapes import Solid, joined
from wcsim.towns.ground.tiles import CHUNK_M
from wcsim.towns.ground.triangulation import GroundMesh
from wcsim.types import F64, I32, Relief, StreetMesh
from wcsim.types.street import FLAT


def build_mesh(
    ground: GroundMesh, walls: tuple[F64, I32, I32], large: list[Solid], small: list[Solid], relief: Relief = FLAT
) -> StreetMesh:
    """One chunk for each ground cell with its kerbs, for each large piece, and for the small pieces of each cell.

    Ground and kerbs are lifted by the relief; the other pieces stand at their height already.
    """
    pieces = [*_ground_pieces(ground, walls, relief), *large, *_by_cell(small)]
    return StreetMesh(
        vertices_W_m=np.concatenate([piece.vertices_W_m for piece in pieces]).astype(np.float32),
        faces=joined(pieces).faces,
        face_class=np.concatenate([piece.face_class for piece in pieces]),
        chunk_vertices=np.cumsum([0, *(len(piece.vertices_W_m) for piece in pieces)]).astype(np.int32),
        chunk_faces=np.cumsum([0, *(len(piece.faces) for piece in pieces)]).astype(np.int32),
    )


def _ground_pieces(ground: GroundMesh, walls: tuple[F64, I32, I32], relief: Relief) -> list[Solid]:
    triangles = np.concatenate([ground.vertices_W_m[ground.faces], walls[0]])  # (T, 3, 3)
    triangles[:, :, 2] += relief.at(triangles)
    classes = np.concatenate([ground.face_class, walls[1]]).astype(np.uint8)
    cells, owner = np.unique(np.concatenate([ground.cell, walls[2]]), axis=0, return_inverse=True)
    order = np.argsort(owner.reshape(-1), kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(owner.reshape(-1), minlength=len(cells)))[:-1])
    return [_indexed(triangles[group], classes[group]) for group in groups]


def _indexed(triangles: F64, classes: np.ndarray) -> Solid:
    """Triangles (T, 3, 3) with shared corners stored once."""
    vertices, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return Solid(vertices_W_m=vertices, faces=index.reshape(-1, 3).astype(np.int32), face_class=classes)


def _by_cell(pieces: list[Solid]) -> list[Solid]:
    groups: dict[tuple[int, int], list[Solid]] = defaultdict(list)
    for piece in pieces:
        x, y = np.floor(piece.vertices_W_m[:, :2].mean(axis=0) / CHUNK_M)
        groups[int(x), int(y)].append(piece)
    return [joined(groups[cell]) for cell in sorted(groups)]
