"""A camera's depth image in metres, and the directions of its pixels."""

import math

import numpy as np

from wcsim.config import CameraConfig
from wcsim.core.frames import deg2rad
from wcsim.supervisor.observation import decode_depth
from wcsim.types import F32, F64, U8


def depth_image_to_metres(image: U8 | F32, range_m: float) -> F32:
    """The newest depth image of either form of observation (window, H, W), in metres, (1, H, W)."""
    image = image[-1:]
    if image.dtype == np.uint8:
        return decode_depth(np.asarray(image, np.uint8), range_m)
    return np.asarray(image * np.float32(range_m), np.float32)


def viewing_rays(camera: CameraConfig) -> F64:
    """(H * W, 3) directions in B per metre of depth along the optical axis, from the top left."""
    height, width = camera.height_px, camera.width_px
    focal_px = width / 2.0 / math.tan(deg2rad(camera.hfov_deg) / 2.0)
    right, down = np.meshgrid(
        (np.arange(width) + 0.5 - width / 2.0) / focal_px,
        (np.arange(height) + 0.5 - height / 2.0) / focal_px,
    )
    pitch, yaw, roll = deg2rad(camera.pitch_deg), deg2rad(camera.yaw_deg), deg2rad(camera.roll_deg)
    right, down = (
        right * math.cos(roll) - down * math.sin(roll),
        right * math.sin(roll) + down * math.cos(roll),
    )
    ahead = math.cos(pitch) + down * math.sin(pitch)
    up = math.sin(pitch) - down * math.cos(pitch)
    x = ahead * math.cos(yaw) + right * math.sin(yaw)
    y = ahead * math.sin(yaw) - right * math.cos(yaw)
    return np.stack([x, y, up], axis=-1).reshape(-1, 3)


def is_camera_mirror_symmetric(camera: CameraConfig) -> bool:
    """Whether its mirrored picture is that of the mirrored street: it looks ahead from the middle.

    >>> (
    ...     is_camera_mirror_symmetric(CameraConfig()),
    ...     is_camera_mirror_symmetric(CameraConfig(yaw_deg=20.0)),
    ... )
    (True, False)
    """
    return camera.p_BC_m[1] == 0.0 and camera.yaw_deg == 0.0 and camera.roll_deg == 0.0
