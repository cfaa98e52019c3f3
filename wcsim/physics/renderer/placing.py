"""Compiled: where the models of the actors stand, and the balls that hold them; once for all pictures of a moment."""

from __future__ import annotations

import numpy as np

from wcsim.core.jit import kernel
from wcsim.types import F32, F64


@kernel
def place_models(p_W_m: F64, yaw: F64, pitch: F64, roll: F64, scale: F64, T_WM: F64) -> None:
    """Unit model box to world: T_WM (n, 3, 4) = place . yaw . pitch (nose up) . roll . size."""
    for i in range(len(yaw)):
        cy, sy, cp, sp = np.cos(yaw[i]), np.sin(yaw[i]), np.cos(pitch[i]), np.sin(pitch[i])
        cr, sr = np.cos(roll[i]), np.sin(roll[i])
        T = T_WM[i]
        T[0, 0], T[0, 1], T[0, 2] = cy * cp, -cy * sp * sr - sy * cr, -cy * sp * cr + sy * sr
        T[1, 0], T[1, 1], T[1, 2] = sy * cp, -sy * sp * sr + cy * cr, -sy * sp * cr - cy * sr
        T[2, 0], T[2, 1], T[2, 2] = sp, cp * sr, cp * cr
        for row in range(3):
            for k in range(3):
                T[row, k] *= scale[i, k]
            T[row, 3] = p_W_m[i, row]


@kernel
def half_diagonal(T: F64) -> float:
    """Half the diagonal of a placed model's box, with room for a stride and for rounding; T (3, 4) its place."""
    total = 0.0
    for row in range(3):
        for k in range(3):
            total += T[row, k] * T[row, k]
    return float(0.54 * np.sqrt(total) + 1e-3)


@kernel
def put_round(T_WM: F64, balls: F32) -> None:
    """Write the ball (x, y, z of W, radius) round each placed model; T_WM (n, 3, 4), balls (n, 4)."""
    for i in range(len(T_WM)):
        for row in range(3):
            balls[i, row] = T_WM[i, row, 3] + 0.5 * T_WM[i, row, 2]
        balls[i, 3] = half_diagonal(T_WM[i])
