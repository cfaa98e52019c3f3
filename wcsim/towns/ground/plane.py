"""Small pieces of plane geometry."""

from __future__ import annotations

import numpy as np

from wcsim.types import F64


def cross_z(a: F64, b: F64) -> F64:
    """Upward component (...,) of the cross product of plane vectors (..., 2); positive when b lies to the left of a.

    >>> float(cross_z(np.array([1.0, 0.0]), np.array([0.0, 2.0])))
    2.0
    """
    area: F64 = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return area


def length_of(points_m: F64) -> float:
    """Length in metres of a polyline (K, 2)."""
    return float(np.linalg.norm(np.diff(points_m, axis=0), axis=1).sum())
