"""Keeps walls out of the view: where one stands before the chair, the picture's camera comes higher, or nearer."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from wcsim.drive.drawing.orbit import AIM_M, HIGHEST_RAD, Orbit, stand
from wcsim.physics.buffers import new_images
from wcsim.physics.renderer.base import Pinhole, Renderer
from wcsim.physics.renderer.instances import actor_instances
from wcsim.physics.sensors.camera_geometry import look_at
from wcsim.types import F64

_PX: Final = 9
_LOOK = Pinhole(width_px=_PX, height_px=_PX, focal_px=6.0 * _PX, near_m=0.05, range_m=60.0)  # a cone as wide as a chair
_MARGIN_M: Final = 0.3  # before a wall
_ROOM_M: Final = 3.5  # from so far away a chair is seen whole, with some street around it
_LEAST_M: Final = 1.2
_TILTS_RAD: Final = tuple(math.radians(step) for step in range(0, 75, 12))  # above the one that was asked for
_LAG_S: Final = 0.3


class Arm:
    """Holds the camera's place between two pictures, so that it glides.

    Args:
        renderer: Of the street.
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer, self._nobody = renderer, actor_instances(())
        self._images = new_images(_PX, _PX, rgb=False)
        self._asked: Orbit | None = None
        self._tilt_rad, self._share = 0.0, 1.0  # more than asked; of the distance that was asked

    def held(self, p_WB_m: F64, yaw_rad: float, asked: Orbit, dt_s: float) -> Orbit:
        """The orbit from which the chair is seen, as near as can be to the one that was asked for.

        Args:
            p_WB_m: (3,) where the chair stands.
            yaw_rad: The heading that the camera takes for the chair's.
            asked: By the person; where that has changed, the camera is there at once.
            dt_s: Since the last picture; `math.inf` to be there at once.
        """
        found = self._fitting(p_WB_m, yaw_rad, asked)
        part = 1.0 - math.exp(-dt_s / _LAG_S) if asked == self._asked else 1.0
        self._asked = asked
        self._tilt_rad += part * (found.tilt_rad - asked.tilt_rad - self._tilt_rad)
        self._share += part * (found.distance_m / asked.distance_m - self._share)
        tilt_rad = min(asked.tilt_rad + self._tilt_rad, HIGHEST_RAD)
        return replace(asked, tilt_rad=tilt_rad, distance_m=asked.distance_m * self._share)

    def _fitting(self, p_WB_m: F64, yaw_rad: float, asked: Orbit) -> Orbit:
        best, most_m = asked, -1.0
        for more_rad in _TILTS_RAD:
            orbit = replace(asked, tilt_rad=min(asked.tilt_rad + more_rad, HIGHEST_RAD))
            room_m = self._room_m(p_WB_m, yaw_rad, orbit)
            if room_m > most_m + _MARGIN_M:
                best, most_m = orbit, room_m
            if most_m >= min(asked.distance_m, _ROOM_M):
                break
        return replace(best, distance_m=min(asked.distance_m, max(most_m, _LEAST_M)))

    def _room_m(self, p_WB_m: F64, yaw_rad: float, orbit: Orbit) -> float:
        """From above the chair towards the camera: how far it is to what hides half of the chair, less a margin."""
        aim_W_m = p_WB_m + np.array([0.0, 0.0, AIM_M])
        T_CW = look_at(aim_W_m, stand(p_WB_m, yaw_rad, orbit))
        self._renderer.render(_LOOK, T_CW, self._nobody, self._images)
        depth_m = self._images.depth_m
        met = depth_m[(depth_m > 0.0) & (depth_m < _LOOK.range_m)]
        if 2 * met.size <= depth_m.size:
            return _LOOK.range_m
        return float(np.sort(met)[depth_m.size // 2]) - _MARGIN_M
