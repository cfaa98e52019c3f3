"""Triangle soups made fit for collision: welded, without slivers, cut to what PyBullet takes in one shape."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from wcsim.types import F64

_MAX_VERTICES: Final = 131_072  # B3_MAX_NUM_VERTICES of PyBullet
MAX_FACES: Final = 524_288 // 3  # B3_MAX_NUM_INDICES
WELD_M: Final = 1e-4
_MIN_HEIGHT_M: Final = 1e-4  # a triangle thinner than this is a gap that no wheel can feel


@dataclass(frozen=True, slots=True, kw_only=True)
class Soup:
    """Triangles that share vertices."""

    vertices_m: F64  # (V, 3)
    faces: npt.NDArray[np.int64]  # (F, 3)


def tidy(vertices_m: F64, faces: npt.NDArray[np.int64]) -> Soup:
    """Vertices closer than 0.1 mm become one, triangles without height go, vertices without triangle go.

    Args:
        vertices_m: Vertices (V, 3).
        faces: Vertex indices (F, 3).
    """
    used, local = np.unique(faces, return_inverse=True)
    keys = np.rint(vertices_m[used] / WELD_M).astype(np.int64)
    _, first, weld = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    welded = weld.reshape(-1)[local.reshape(faces.shape)]
    points = vertices_m[used][first]
    keep = _height_m(points, welded) >= _MIN_HEIGHT_M
    return _compact(points, welded[keep])


def split(soup: Soup) -> Iterator[Soup]:
    """The soup in as few pieces as PyBullet's limits allow; one when it fits."""
    if len(soup.vertices_m) <= _MAX_VERTICES and len(soup.faces) <= MAX_FACES:
        if len(soup.faces):
            yield soup
        return
    centre = soup.vertices_m[soup.faces].mean(axis=1)
    axis = int(np.argmax(np.ptp(centre, axis=0)))
    order = np.argsort(centre[:, axis], kind="stable")
    half = len(order) // 2
    for part in (order[:half], order[half:]):
        yield from split(_compact(soup.vertices_m, soup.faces[np.sort(part)]))


def _height_m(points_m: F64, faces: npt.NDArray[np.int64]) -> F64:
    """Smallest height (F,) of each triangle; 0 for a degenerate one."""
    a, b, c = (points_m[faces[:, k]] for k in range(3))
    double_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    return np.asarray(np.divide(double_area, longest, out=np.zeros_like(double_area), where=longest > 0))


def _compact(points_m: F64, faces: npt.NDArray[np.int64]) -> Soup:
    used, local = np.unique(faces, return_inverse=True)
    return Soup(vertices_m=points_m[used], faces=local.reshape(faces.shape))
