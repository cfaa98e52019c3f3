"""Is the way that the joystick asks for free, as far as one depth image shows?"""

from __future__ import annotations

import math

import numpy as np

from wcsim.agents.policy_api import DEPTH_KEY, IMU_KEY, Observation
from wcsim.config import CameraConfig, ChairConfig
from wcsim.core.frames import rad
from wcsim.supervisor.observation import decode_depth
from wcsim.types import F32, F64, U8, Bool, Outline

MARGIN_M = 0.19  # on each side
CLEAR_M = 0.3  # to keep in front when standing
_REACTION_S = 0.4  # one tick of delay, the drive's ramp
STEP_M = 0.15  # higher than this is in the way, deeper than this is a drop: twice what the casters climb
HEAD_M = 1.6  # what hangs higher passes above
_SLOPE_PER_M = 0.03  # uneven ground and depth steps grow with the distance
_PIXEL_SHARE = 4e-4  # of the image, and at least _MIN_PIXELS: less is noise
_MIN_PIXELS = 2
_STRAIGHT_RADPS = 0.05


class CorridorWatch:
    """Looks along the swept corridor of a joystick position. Keeps the viewing rays of one camera."""

    def __init__(self, camera: CameraConfig, chair: ChairConfig, outline: Outline) -> None:
        self._rays = viewing_rays(camera)
        self._eye_B_m = np.array(camera.p_BC_m, dtype=np.float64)  # (3,)
        self._range_m, self._chair, self._outline = camera.range_m, chair, outline
        self._few = max(_MIN_PIXELS, round(_PIXEL_SHARE * len(self._rays)))

    def blocked(self, observation: Observation, x: float, y: float, ahead_s: float = 0.0) -> bool:
        """Whether a joystick at (x right, y > 0 forward) would run into something before the chair could stand.

        With `ahead_s` before it could when it begins to brake so much later.
        """
        depth_m = depth_metres(observation[DEPTH_KEY], self._range_m).reshape(-1).astype(np.float64)
        points = self._eye_B_m + self._rays * depth_m[:, None]  # (H * W, 3) in B
        roll, pitch = math.pi * float(observation[IMU_KEY][3]), 0.5 * math.pi * float(observation[IMU_KEY][4])
        speed, turn = y * self._chair.v_max_mps, -x * self._chair.yaw_rate_max_radps
        stop_m = speed * (_REACTION_S + ahead_s) + speed * speed / (2.0 * self._chair.decel_mps2)
        reach_m = stop_m + self._outline.front_x_m + CLEAR_M
        seen = (depth_m > 0.0) & (depth_m < 0.99 * self._range_m)  # 0: nothing was measured
        low, high = _heights(points, roll, pitch)
        solid = seen & (low > _limit_m(points)) & (high < HEAD_M)
        if self._enough(solid & _in_corridor(points, speed, turn, reach_m, self._outline)):
            return True
        # Rays that would meet level ground within the corridor, but go on below it.
        down = self._rays[:, 2] < -1e-3
        fall = np.where(down, -self._eye_B_m[2] / np.where(down, self._rays[:, 2], -1.0), 0.0)
        ground = self._eye_B_m + self._rays * fall[:, None]
        deep = down & (high < -_limit_m(ground))
        return self._enough(deep & _in_corridor(ground, speed, turn, reach_m, self._outline))

    def _enough(self, pixels: Bool) -> bool:
        return int(np.count_nonzero(pixels)) >= self._few


def _limit_m(points_B_m: F64) -> F64:
    """(K,) how high or deep something must be at these places to be in the way, or a drop."""
    return np.asarray(STEP_M + _SLOPE_PER_M * np.hypot(points_B_m[:, 0], points_B_m[:, 1]), np.float64)


def depth_metres(image: U8 | F32, range_m: float) -> F32:
    """The newest depth image of either form of observation (window, H, W), in metres, (1, H, W)."""
    image = image[-1:]
    if image.dtype == np.uint8:
        return decode_depth(np.asarray(image, np.uint8), range_m)
    return np.asarray(image * np.float32(range_m), np.float32)


def viewing_rays(camera: CameraConfig) -> F64:
    """Directions in B per metre of depth (along the optical axis), (H * W, 3), row by row from the top left."""
    height, width = camera.height_px, camera.width_px
    focal_px = width / 2.0 / math.tan(rad(camera.hfov_deg) / 2.0)
    right, down = np.meshgrid(
        (np.arange(width) + 0.5 - width / 2.0) / focal_px, (np.arange(height) + 0.5 - height / 2.0) / focal_px
    )
    pitch, yaw, roll = rad(camera.pitch_deg), rad(camera.yaw_deg), rad(camera.roll_deg)
    right, down = right * math.cos(roll) - down * math.sin(roll), right * math.sin(roll) + down * math.cos(roll)
    ahead = math.cos(pitch) + down * math.sin(pitch)
    up = math.sin(pitch) - down * math.cos(pitch)
    x = ahead * math.cos(yaw) + right * math.sin(yaw)
    y = ahead * math.sin(yaw) - right * math.cos(yaw)
    return np.stack([x, y, up], axis=-1).reshape(-1, 3)


def sees_in_a_mirror(camera: CameraConfig) -> bool:
    """Whether its picture with left and right exchanged is that of the mirrored street: it looks ahead from the middle.

    >>> sees_in_a_mirror(CameraConfig()), sees_in_a_mirror(CameraConfig(yaw_deg=20.0))
    (True, False)
    """
    return camera.p_BC_m[1] == 0.0 and camera.yaw_deg == 0.0 and camera.roll_deg == 0.0


def _heights(points_B_m: F64, roll_rad: float, pitch_rad: float) -> tuple[F64, F64]:
    """Smaller and larger of two heights of each point: above the chair's own plane, and above a level plane below it.

    On a ramp the first is right, just before or after it the second; something counts only when both agree.
    """
    own = points_B_m[:, 2]
    level = (
        math.sin(pitch_rad) * points_B_m[:, 0]
        + math.cos(pitch_rad) * math.sin(roll_rad) * points_B_m[:, 1]
        + math.cos(pitch_rad) * math.cos(roll_rad) * points_B_m[:, 2]
    )
    return np.minimum(own, level), np.maximum(own, level)


def _in_corridor(points_B_m: F64, speed_mps: float, turn_radps: float, reach_m: float, outline: Outline) -> Bool:
    """Points over which the chair passes on the arc of (speed, turn), up to `reach_m` ahead of its axle; (K,) bool."""
    x, y = points_B_m[:, 0], points_B_m[:, 1]
    half = 0.5 * outline.width_m + MARGIN_M
    if abs(turn_radps) < _STRAIGHT_RADPS:
        return np.asarray((np.abs(y) < half) & (x > 0.0) & (x < reach_m), dtype=np.bool_)
    radius = speed_mps / turn_radps  # centre of the arc at (0, radius), left positive
    aside = np.abs(np.hypot(x, y - radius) - abs(radius))
    angle = np.arctan2(x, (radius - y) * np.sign(radius))
    along = np.where(angle > 0.0, angle, 0.0) * abs(radius)
    # On a tight arc the footplate swings wide of the axle's path, so the straight box ahead of the chair counts too.
    box = (np.abs(y) < half) & (x > 0.0) & (x < outline.front_x_m + CLEAR_M)
    return np.asarray(box | ((aside < half) & (angle > 0.0) & (along < reach_m)), dtype=np.bool_)
