"""Kerbs: upright faces where raised ground stands beside the road."""

from __future__ import annotations

import numpy as np

from wcsim.core.constants import KERB_STEP_M
from wcsim.towns.ground.triangulation import GroundMesh
from wcsim.types import F64, I32, ClassId

_HAIR_M = 1e-6


def kerb_walls(ground: GroundMesh) -> tuple[F64, I32, I32]:
    """Wall triangles (T, 3, 3), counter-clockwise seen from the road, their class (T,) and chunk (T, 2).

    The corners are those of the ground's own vertices, so nothing gapes; where both sides are level there is no wall.
    """
    road = _borders(ground, ground.low)
    bank = _borders(ground, ~ground.low)
    key_road, key_bank = _key(ground, road[:, :2]), _key(ground, bank[:, [1, 0]])  # the other side runs the other way
    _, at_road, at_bank = np.intersect1d(key_road, key_bank, assume_unique=False, return_indices=True)
    foot = ground.vertices_W_m[road[at_road, :2]]  # (K, 2, 3), the road's edge with the road on its left
    top = ground.vertices_W_m[bank[at_bank][:, [1, 0]]]
    rise_m = top[:, :, 2] - foot[:, :, 2]
    walls = rise_m.max(axis=1) > 0.0
    foot, top, rise_m, cell = foot[walls], top[walls], rise_m[walls], ground.cell[road[at_road, 2]][walls]
    first = np.stack([foot[:, 1], foot[:, 0], top[:, 0]], axis=1)
    second = np.stack([foot[:, 1], top[:, 0], top[:, 1]], axis=1)
    kind = np.where(rise_m.max(axis=1) <= KERB_STEP_M + _HAIR_M, ClassId.LOWERED_KERB, ClassId.KERB).astype(np.int32)
    flat = np.concatenate([rise_m[:, 0] <= 0.0, rise_m[:, 1] <= 0.0])  # a wall that runs out is one triangle
    triangles = np.concatenate([first, second])[~flat]
    return triangles, np.concatenate([kind, kind])[~flat], np.concatenate([cell, cell])[~flat]


def _borders(ground: GroundMesh, chosen: np.ndarray) -> I32:
    """Directed edges (E, 3) of the chosen faces that no other chosen face shares: start, end, face."""
    faces = ground.faces[chosen]
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    owner = np.repeat(np.flatnonzero(chosen), 3)
    size = len(ground.vertices_W_m)
    forward = edges[:, 0].astype(np.int64) * size + edges[:, 1]
    backward = edges[:, 1].astype(np.int64) * size + edges[:, 0]
    alone = ~np.isin(forward, backward)
    return np.column_stack([edges[alone], owner[alone]]).astype(np.int32)


def _key(ground: GroundMesh, edges: I32) -> I32:
    """One number for each directed edge, from where its ends lie in the plane."""
    xy_cm = np.rint(ground.vertices_W_m[:, :2] * 100.0).astype(np.int64)
    _, place = np.unique(xy_cm, axis=0, return_inverse=True)
    place = place.reshape(-1).astype(np.int64)
    return place[edges[:, 0]] * (int(place.max()) + 1) + place[edges[:, 1]]
