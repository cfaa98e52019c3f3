"""Starts where a chair does not belong: before a kerb, in a gutter, on grass, in a drive."""

import math
from typing import Final

import numpy as np

from wcsim.core.constants import KERB_STEP_M
from wcsim.core.frames import deg2rad
from wcsim.types import F64, ClassId, Ground, StartSpec

WITHIN_M: Final = 60.0  # of the chair that begins anew
CLEAR_M: Final = 0.95  # to what is solid, however the chair turns
FAR_M: Final = (1.5, 5.0)  # from its axle to the step that it faces
ASIDE_DEG: Final = 60.0  # by so much it may face aside of the shortest way to it
FACING_SHARE: Final = 0.75  # the others face anywhere
_WAYS: Final = (ClassId.SIDEWALK, ClassId.KERB, ClassId.LOWERED_KERB)
_TRIES: Final = 1000
_DIRECTIONS: Final = 24
_STEP_M: Final = 0.1


def off_way_start(ground: Ground, near_W_m: F64, rng: np.random.Generator) -> StartSpec | None:
    """A start around a place (2,); None where there is none.

    Mostly it faces the nearest step up or down, from whatever ground, within `FAR_M` of it and with
    nothing solid before it; else it lies on no way of a chair, and faces anywhere.
    """
    goal = (float(near_W_m[0]), float(near_W_m[1]))
    turns = np.arange(_DIRECTIONS) * 2.0 * math.pi / _DIRECTIONS
    along_m = np.arange(_STEP_M, FAR_M[1] + _STEP_M, _STEP_M)
    anywhere = rng.random() >= FACING_SHARE
    for _ in range(_TRIES):
        place = near_W_m[:2] + rng.uniform(-WITHIN_M, WITHIN_M, 2)
        kind = int(ground.class_at(place))
        if (
            kind == ClassId.VOID
            or float(ground.clearance_at(place)) < CLEAR_M
            or (anywhere and kind in _WAYS)
        ):
            continue
        if anywhere:
            yaw_rad = float(rng.uniform(-math.pi, math.pi))
        else:
            ways = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
            line = place + along_m[:, None] * ways[:, None]
            raised_m = ground.raised_at(line)
            steps = np.abs(np.diff(raised_m, axis=1)) > KERB_STEP_M
            first_m = np.where(steps.any(axis=1), along_m[steps.argmax(axis=1)], np.inf)
            nearest = int(first_m.argmin())
            before = along_m < first_m[nearest]
            if (
                not FAR_M[0] < first_m[nearest] < FAR_M[1]
                or (ground.clearance_at(line[nearest, before]) < CLEAR_M).any()
            ):
                continue
            yaw_rad = float(turns[nearest] + rng.uniform(-1.0, 1.0) * deg2rad(ASIDE_DEG))
        return StartSpec(p_W_m=(float(place[0]), float(place[1])), yaw_rad=yaw_rad, goal_W_m=goal)
    return None
