"""What a camera shows: its depth image in metres, the classes, and where the pixels look."""

import math
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, Observation
from wcsim.config import CameraConfig
from wcsim.core.frames import deg2rad
from wcsim.supervisor.observation import decode_depth
from wcsim.types import F32, F64, U8

# Of a camera's range; depths from here on are no measurement.
FAR_SHARE: Final = 0.99

Number = TypeVar("Number", np.float32, np.uint8)


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


def sampling_stride_px(camera: CameraConfig) -> int:
    """The step from one sampled pixel to the next, in rows and columns: more in a larger picture.

    >>> cameras = [CameraConfig(width_px=width, height_px=60) for width in (80, 160, 320, 640)]
    >>> [sampling_stride_px(camera) for camera in cameras]
    [1, 1, 2, 4]
    """
    return max(1, round(camera.width_px / 160))


class CameraView:
    """One camera's newest picture: every so many pixels of it, and where they look.

    Args:
        camera: Where it is mounted, as configured.
        prefix: What stands before the keys of its images, see `RunConfig.eyes`.
    """

    def __init__(self, camera: CameraConfig, prefix: str = "") -> None:
        self._prefix, self._range_m = prefix, camera.range_m
        self._stride = sampling_stride_px(camera)
        self._size = (camera.height_px, camera.width_px)
        rays = viewing_rays(camera).reshape(*self._size, 3)[:: self._stride, :: self._stride]
        self.shape = rays.shape[:2]  # of the sampled pixels
        self.rays = np.ascontiguousarray(rays.reshape(-1, 3), np.float32)
        self.eye_B_m = np.array(camera.p_BC_m, np.float64)
        self.near_m, self.far_m = 1.02 * camera.near_m, FAR_SHARE * camera.range_m
        self.depth_m = np.zeros(len(self.rays), np.float32)  # (n,) along the optical axis

    def observe(self, observation: Observation) -> None:
        """Take the depths of a new tick."""
        image = observation[self._prefix + DEPTH_KEY]
        self.depth_m = self._sampled(depth_image_to_metres(image, self._range_m))

    def classes(self, observation: Observation) -> U8:
        """The classes (n,) of the sampled pixels, of an observation with class ids."""
        return self._sampled(observation[self._prefix + CLASS_KEY][-1])

    def _sampled(self, image: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """Every so many pixels of an image, (n,)."""
        pixels = image.reshape(self._size)[:: self._stride, :: self._stride]
        return np.ascontiguousarray(pixels).reshape(-1)


def is_camera_mirror_symmetric(camera: CameraConfig) -> bool:
    """Whether its mirrored picture is that of the mirrored street: it looks ahead from the middle.

    >>> (
    ...     is_camera_mirror_symmetric(CameraConfig()),
    ...     is_camera_mirror_symmetric(CameraConfig(yaw_deg=20.0)),
    ... )
    (True, False)
    """
    return camera.p_BC_m[1] == 0.0 and camera.yaw_deg == 0.0 and camera.roll_deg == 0.0
