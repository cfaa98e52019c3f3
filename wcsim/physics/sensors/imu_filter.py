"""The compiled part of the inertial sensor: all substeps of a tick in one call."""

from __future__ import annotations

import numpy as np

from wcsim.core.jit import exact_kernel
from wcsim.types import F64

ROW = 15  # numbers of a substep: rotation R_WB row by row, velocity and angular velocity in W
STATE = 9  # velocity of the mount in W, the two stages of the low-pass
RESULT = 12  # see `filter_tick`


@exact_kernel
def filter_tick(
    rows: F64, state: F64, arm_B_m: F64, per_s: float, gravity_mps2: float, felt_mps2: float, alpha: float, low: F64
) -> F64:
    """Specific force, its low-passed peak and the turn rate at the mount.

    Args:
        rows: (n, ROW) the motion after each substep.
        state: (STATE,) carried from tick to tick, updated in place.
        arm_B_m: (3,) from the point whose velocity is given to the mount.
        per_s: Substeps per second.
        gravity_mps2: Gravity in the mean.
        felt_mps2: Gravity in the low-passed signal, 0 to leave it out.
        alpha: Share of a step that each stage of the low-pass goes.
        low: (n, 3) takes the low-passed signal.

    Returns:
        (RESULT,) sums over the substeps: acceleration 0:3, gravity 3:6, turn rate 9:12; peak magnitude 6:9.
    """
    out = np.zeros(RESULT)
    v_W = np.empty(3)
    a_W = np.empty(3)
    for n in range(len(rows)):
        row = rows[n]
        x = row[0] * arm_B_m[0] + row[1] * arm_B_m[1] + row[2] * arm_B_m[2]
        y = row[3] * arm_B_m[0] + row[4] * arm_B_m[1] + row[5] * arm_B_m[2]
        z = row[6] * arm_B_m[0] + row[7] * arm_B_m[1] + row[8] * arm_B_m[2]
        v_W[0] = row[9] + row[13] * z - row[14] * y
        v_W[1] = row[10] + row[14] * x - row[12] * z
        v_W[2] = row[11] + row[12] * y - row[13] * x
        for k in range(3):
            a_W[k] = (v_W[k] - state[k]) * per_s
            state[k] = v_W[k]
        for k in range(3):
            a_B = row[k] * a_W[0] + row[3 + k] * a_W[1] + row[6 + k] * a_W[2]
            state[3 + k] += alpha * (a_B + row[6 + k] * felt_mps2 - state[3 + k])
            state[6 + k] += alpha * (state[3 + k] - state[6 + k])
            low[n, k] = state[6 + k]
            out[k] += a_B
            out[3 + k] += row[6 + k] * gravity_mps2
            out[6 + k] = max(out[6 + k], abs(state[6 + k]))
            out[9 + k] += row[k] * row[12] + row[3 + k] * row[13] + row[6 + k] * row[14]
    return out
