"""The errors of one camera, made of its configuration and laid over the true pictures."""

from __future__ import annotations

import math

import numpy as np

from wcsim.config import CameraConfig, CameraNoiseConfig, ClassNoiseConfig, DepthNoiseConfig
from wcsim.core import frames
from wcsim.physics.buffers import Images
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.sensors.pixel_noise import (
    ClassNoise,
    DepthNoise,
    child,
    disturb_classes,
    disturb_colours,
    disturb_depth,
    quantiles,
)

DEPTH, CLASSES, RGB = 0, 1, 2  # each picture has a key of its own
FULL_SCALE = 255.0


class CameraNoise:
    """Disturbs the pictures of one camera; keeps nothing between pictures."""

    def __init__(self, camera: CameraConfig, noise: CameraNoiseConfig, pinhole: Pinhole) -> None:
        self._depth = None if noise.depth is None else depth_noise(camera, noise.depth, pinhole)
        self._classes = None if noise.classes is None else class_noise(noise.classes)
        self._sigma = None if noise.rgb is None else sigma_of(noise.rgb.snr_db)

    def lay_over(self, images: Images, key: int) -> None:
        """Turn the true pictures into measured ones, in place; `key` (64 bits) says which."""
        if self._depth is not None:
            disturb_depth(images.depth_m, np.uint64(child(key, DEPTH)), self._depth, quantiles())
        if self._classes is not None:
            disturb_classes(images.class_id, np.uint64(child(key, CLASSES)), self._classes)
        if self._sigma is not None and images.rgb is not None:
            disturb_colours(images.rgb, np.uint64(child(key, RGB)), self._sigma, quantiles())


def camera_noise(camera: CameraConfig, pinhole: Pinhole) -> CameraNoise | None:
    """The errors of a camera, None when its pictures are exact."""
    noise = camera.noise
    if noise is None or (noise.depth is None and noise.classes is None and noise.rgb is None):
        return None
    return CameraNoise(camera, noise, pinhole)


def depth_noise(camera: CameraConfig, depth: DepthNoiseConfig, pinhole: Pinhole) -> DepthNoise:
    """What the kernel needs of a stereo camera."""
    matcher_focal_px = 0.5 * depth.matcher_width_px / math.tan(0.5 * frames.rad(camera.hfov_deg))
    return DepthNoise(
        focal_px=pinhole.focal_px,
        shift_px_m=pinhole.focal_px * depth.baseline_m,
        match_px_m=matcher_focal_px * depth.baseline_m,
        sigma_px=depth.sigma_px,
        step_px=depth.step_px,
        range_m=camera.range_m,
        z_min_m=depth.z_min_m,
        shadow=depth.shadow,
        dropout=depth.dropout,
        grazing_sin=math.sin(frames.rad(depth.grazing_deg)),
        grazing_dropout=depth.grazing_dropout,
        patch_px=depth.patch_px,
    )


def class_noise(classes: ClassNoiseConfig) -> ClassNoise:
    """What the kernel needs of a network that names pixels."""
    return ClassNoise(
        border_px=classes.border_px,
        border_share=classes.border_share,
        grain_px=classes.grain_px,
        dropout=classes.dropout,
        patch_px=classes.patch_px,
    )


def sigma_of(snr_db: float) -> float:
    """Standard deviation of a colour, in steps of 255, at a signal-to-noise ratio of full scale.

    >>> round(sigma_of(40.0), 3)
    2.55
    """
    return float(FULL_SCALE * 10.0 ** (-snr_db / 20.0))
