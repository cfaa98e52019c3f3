"""Times the rasteriser against TinyRenderer on the same pictures, in the same minute, in CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from wcsim.errors import ConfigError
from wcsim.physics.renderer.base import Pinhole, new_images
from wcsim.physics.renderer.instances import Instances
from wcsim.physics.renderer.raster import RasterRenderer, warm_up
from wcsim.physics.renderer.store import GeometryStore
from wcsim.physics.renderer.tiny import TinyRenderer, corner_shift
from wcsim.types import F64

RASTER_SHOTS = 5  # pictures of the rasteriser for one of TinyRenderer: one alone is too short for the clock


@dataclass(frozen=True, slots=True, kw_only=True)
class RendererComparison:
    """CPU milliseconds a picture, and how far the two agree at the same sample points."""

    ms_median: float  # rasteriser, depth and class
    ms_min: float
    rgb_ms_median: float  # rasteriser with colours
    tiny_ms_median: float
    tiny_ms_min: float
    class_agreement: float  # mean share of pixels
    depth_agreement: float  # mean share of pixels, to 2 cm or 1 %
    pictures: int

    @property
    def ratio_vs_tiny(self) -> float:
        """How many times faster the rasteriser is, by medians."""
        return self.tiny_ms_median / self.ms_median


def compare_renderers(
    store: GeometryStore, camera: Pinhole, poses: Sequence[F64], instances: Instances, rounds: int = 3
) -> RendererComparison:
    """Draw every pose with both renderers in turn, `rounds` times.

    Args:
        store: the geometry of both.
        camera: the camera.
        poses: world to camera matrices (3, 4), see `wcsim.physics.camera.look_along`.
        instances: the actors.
        rounds: how often each pose is drawn.

    Raises:
        ConfigError: when there is no pose or no round.
    """
    if not poses or rounds < 1:
        raise ConfigError(f"a comparison got {len(poses)} poses and {rounds} rounds; expected at least one of each")
    raster = RasterRenderer(store)
    warm_up(raster)
    plain = new_images(camera.width_px, camera.height_px, rgb=False)
    colour = new_images(camera.width_px, camera.height_px, rgb=True)
    other = new_images(camera.width_px, camera.height_px, rgb=False)
    times, same = [], []
    with TinyRenderer(store) as tiny:
        tiny.render(camera, poses[0], instances, other)  # makes the bodies of the actors
        for _ in range(rounds):
            for T_CW in poses:
                tiny_ms = cpu_ms(partial(tiny.render, camera, T_CW, instances, other), 1)
                plain_ms = cpu_ms(partial(raster.render, camera, T_CW, instances, plain), RASTER_SHOTS)
                colour_ms = cpu_ms(partial(raster.render, camera, T_CW, instances, colour), RASTER_SHOTS)
                times.append((plain_ms, colour_ms, tiny_ms))
                raster.render(camera, corner_shift(T_CW, camera.focal_px), instances, plain)
                close = np.abs(plain.depth_m - other.depth_m) <= np.maximum(0.02, 0.01 * other.depth_m)
                same.append((np.mean(plain.class_id == other.class_id), np.mean(close)))
    taken, agreement = np.array(times), np.mean(same, axis=0)
    return RendererComparison(
        ms_median=float(np.median(taken[:, 0])),
        ms_min=float(taken[:, 0].min()),
        rgb_ms_median=float(np.median(taken[:, 1])),
        tiny_ms_median=float(np.median(taken[:, 2])),
        tiny_ms_min=float(taken[:, 2].min()),
        class_agreement=float(agreement[0]),
        depth_agreement=float(agreement[1]),
        pictures=len(times),
    )


def cpu_ms(work: Callable[[], object], times: int) -> float:
    """CPU milliseconds of this process for one call of `work`, mean of `times` calls."""
    start = time.process_time()
    for _ in range(times):
        work()
    return (time.process_time() - start) * 1e3 / times
