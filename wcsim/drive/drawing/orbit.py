"""Where the picture's camera stands: on a sphere around the chair, behind it unless it was turned."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wcsim.physics.sensors.camera_geometry import look_at
from wcsim.types import F64

_NEAREST_M, _FARTHEST_M = 2.0, 40.0
_LOWEST_RAD, HIGHEST_RAD = math.radians(4.0), math.radians(88.0)
AIM_M = 0.9  # above the ground: the middle of who sits in the chair
_AHEAD_SHARE = 0.35  # of the distance: the camera aims so far ahead of the chair while it looks from behind
_LAG_S = 0.5  # the camera comes after a turn of the chair so slowly, which spares the stomach


@dataclass(frozen=True, slots=True, kw_only=True)
class Orbit:
    """How a person has turned the camera."""

    turn_rad: float = 0.0  # around the chair, 0 from behind, positive to its left side
    tilt_rad: float = math.radians(22.0)  # above the horizon
    distance_m: float = 6.0


def clamped(turn_rad: float, tilt_rad: float, distance_m: float) -> Orbit:
    """An orbit within its bounds.

    >>> clamped(7.0, 9.0, 0.1).distance_m, round(clamped(7.0, 0.1, 3.0).turn_rad, 3)
    (2.0, 0.717)
    """
    return Orbit(
        turn_rad=math.remainder(turn_rad, 2.0 * math.pi),
        tilt_rad=min(max(tilt_rad, _LOWEST_RAD), HIGHEST_RAD),
        distance_m=min(max(distance_m, _NEAREST_M), _FARTHEST_M),
    )


def eased(yaw_rad: float, wanted_rad: float, dt_s: float) -> float:
    """The camera's yaw `dt_s` later, on its way to that of the chair.

    >>> round(eased(0.0, 1.0, 10.0), 3), round(eased(3.1, -3.1, 0.1), 3)
    (1.0, 3.115)
    """
    gap = math.remainder(wanted_rad - yaw_rad, 2.0 * math.pi)
    return math.remainder(yaw_rad + gap * (1.0 - math.exp(-dt_s / _LAG_S)), 2.0 * math.pi)


def eye(p_WB_m: F64, yaw_rad: float, orbit: Orbit) -> F64:
    """World to camera frame (3, 4) of the camera that looks at a chair at p (3,), whose heading is taken for `yaw_rad`.

    >>> import numpy as np
    >>> T_CW = eye(np.zeros(3), 0.0, Orbit(distance_m=6.0))
    >>> bool((T_CW[:, :3] @ np.array([0.0, 0.0, AIM_M]) + T_CW[:, 3])[2] > 0.0)
    True
    """
    x_m, y_m, z_m = (float(value) for value in p_WB_m)
    flat_m = orbit.distance_m * math.cos(orbit.tilt_rad)
    ahead_m = _AHEAD_SHARE * flat_m * max(0.0, math.cos(orbit.turn_rad))
    aim = (x_m + ahead_m * math.cos(yaw_rad), y_m + ahead_m * math.sin(yaw_rad), z_m + AIM_M)
    return look_at(stand(p_WB_m, yaw_rad, orbit), aim)


def stand(p_WB_m: F64, yaw_rad: float, orbit: Orbit) -> tuple[float, float, float]:
    """Where that camera stands in W.

    >>> import numpy as np
    >>> [round(value, 3) for value in stand(np.zeros(3), 0.0, Orbit(tilt_rad=0.0, distance_m=6.0))]
    [-6.0, 0.0, 0.9]
    """
    x_m, y_m, z_m = (float(value) for value in p_WB_m)
    from_rad = yaw_rad + math.pi - orbit.turn_rad
    flat_m = orbit.distance_m * math.cos(orbit.tilt_rad)
    return (
        x_m + flat_m * math.cos(from_rad),
        y_m + flat_m * math.sin(from_rad),
        z_m + AIM_M + orbit.distance_m * math.sin(orbit.tilt_rad),
    )
