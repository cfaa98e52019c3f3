"""Times the rasteriser against TinyRenderer on the same pictures, in the same minute, in CPU time.

It also counts how many pixels agree: with TinyRenderer at that renderer's own sample points, and with Embree's ray
casts at pixel centres where that is installed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.camera.embree import RayOracle, depth_agrees, has_embree
from wcsim.errors import ConfigError
from wcsim.physics.buffers import Images, new_images
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import Instances
from wcsim.physics.renderer.raster import RasterRenderer, warm_up
from wcsim.physics.renderer.tiny_renderer import TinyRenderer, corner_shift
from wcsim.types import F32, F64, U8

_RASTER_SHOTS = 5  # pictures of the rasteriser for one of TinyRenderer: one alone is too short for the clock


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Share of the pixels on which the rasteriser and a reference agree."""

    same_class: float
    same_depth: float  # to 2 cm or 1 %


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedPicture:
    """One pose: CPU milliseconds a picture, the median of all rounds, and agreement."""

    ms: float  # rasteriser, depth and class
    rgb_ms: float  # rasteriser with colours
    tiny_ms: float
    tiny: Agreement
    embree: Agreement | None  # None without embreex


@dataclass(frozen=True, slots=True, kw_only=True)
class RendererComparison:
    """Pictures pooled: medians of the times, means of the agreements."""

    ms_median: float
    rgb_extra_ms: float
    tiny_ms_median: float
    tiny: Agreement
    embree: Agreement | None
    pictures: int

    @property
    def ratio_vs_tiny(self) -> float:
        """How many times faster the rasteriser is, by medians."""
        return self.tiny_ms_median / self.ms_median


def compare_renderers(
    store: GeometryStore, camera: Pinhole, poses: Sequence[F64], instances: Instances, rounds: int = 3
) -> tuple[ComparedPicture, ...]:
    """Draw every pose with both renderers in turn, `rounds` times.

    Args:
        store: the geometry of both.
        camera: the camera.
        poses: world to camera matrices (3, 4), see `wcsim.physics.sensors.camera_geometry.look_along`.
        instances: the actors.
        rounds: how often each pose is drawn.

    Raises:
        ConfigError: when there is no pose or no round.
    """
    if not poses or rounds < 1:
        raise ConfigError(f"a comparison got {len(poses)} poses and {rounds} rounds; expected at least one of each")
    raster = RasterRenderer(store)
    warm_up(raster)
    oracle = RayOracle(store, instances) if has_embree() else None
    with TinyRenderer(store) as tiny:
        tiny.render(camera, poses[0], instances, _plain(camera))  # makes the bodies of the actors
        times = [[_times(raster, tiny, camera, T_CW, instances) for T_CW in poses] for _ in range(rounds)]
        return tuple(
            ComparedPicture(
                ms=float(ms),
                rgb_ms=float(rgb_ms),
                tiny_ms=float(tiny_ms),
                tiny=_against_tiny(raster, tiny, camera, T_CW, instances),
                embree=None if oracle is None else _against_rays(raster, oracle, camera, T_CW, instances),
            )
            for T_CW, (ms, rgb_ms, tiny_ms) in zip(poses, np.median(times, axis=0), strict=True)
        )


def pooled(pictures: Sequence[ComparedPicture]) -> RendererComparison:
    """All of them in one. Raises ConfigError when there is none."""
    if not pictures:
        raise ConfigError("no picture to compare; expected at least one")
    rays = [picture.embree for picture in pictures if picture.embree is not None]
    return RendererComparison(
        ms_median=float(np.median([picture.ms for picture in pictures])),
        rgb_extra_ms=float(np.median([picture.rgb_ms - picture.ms for picture in pictures])),
        tiny_ms_median=float(np.median([picture.tiny_ms for picture in pictures])),
        tiny=_mean([picture.tiny for picture in pictures]),
        embree=_mean(rays) if rays else None,
        pictures=len(pictures),
    )


def _cpu_ms(work: Callable[[], object], times: int) -> float:
    """CPU milliseconds of this process for one call of `work`, mean of `times` calls."""
    start = time.process_time()
    for _ in range(times):
        work()
    return (time.process_time() - start) * 1e3 / times


def _times(
    raster: RasterRenderer, tiny: TinyRenderer, camera: Pinhole, T_CW: F64, instances: Instances
) -> tuple[float, float, float]:
    """Milliseconds of the rasteriser, of the rasteriser with colours, and of TinyRenderer."""
    plain, colour = _plain(camera), new_images(camera.width_px, camera.height_px, rgb=True)
    tiny_ms = _cpu_ms(partial(tiny.render, camera, T_CW, instances, plain), 1)
    plain_ms = _cpu_ms(partial(raster.render, camera, T_CW, instances, plain), _RASTER_SHOTS)
    colour_ms = _cpu_ms(partial(raster.render, camera, T_CW, instances, colour), _RASTER_SHOTS)
    return plain_ms, colour_ms, tiny_ms


def _against_tiny(
    raster: RasterRenderer, tiny: TinyRenderer, camera: Pinhole, T_CW: F64, instances: Instances
) -> Agreement:
    mine, other = _plain(camera), _plain(camera)
    raster.render(camera, corner_shift(T_CW, camera.focal_px), instances, mine)
    tiny.render(camera, T_CW, instances, other)
    return _agreement(mine, other.depth_m, other.class_id)


def _against_rays(
    raster: RasterRenderer, oracle: RayOracle, camera: Pinhole, T_CW: F64, instances: Instances
) -> Agreement:
    mine = _plain(camera)
    raster.render(camera, T_CW, instances, mine)
    return _agreement(mine, *oracle.image(camera, T_CW))


def _agreement(mine: Images, depth_m: F32, class_id: U8) -> Agreement:
    return Agreement(
        same_class=float(np.mean(mine.class_id == class_id)),
        same_depth=float(np.mean(depth_agrees(mine.depth_m, depth_m))),
    )


def _mean(parts: Sequence[Agreement]) -> Agreement:
    return Agreement(
        same_class=float(np.mean([part.same_class for part in parts])),
        same_depth=float(np.mean([part.same_depth for part in parts])),
    )


def _plain(camera: Pinhole) -> Images:
    return new_images(camera.width_px, camera.height_px, rgb=False)
