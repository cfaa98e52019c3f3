"""What every renderer offers: draw the street and the actors of one moment into given buffers."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from wcsim.errors import ConfigError
from wcsim.physics.buffers import Images
from wcsim.physics.renderer.instances import Instances
from wcsim.types import F64, Bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Pinhole:
    """An ideal camera; its axis is in the image's middle, pixel (u, v) is seen at (u, v) + 0.5."""

    width_px: int
    height_px: int
    focal_px: float
    near_m: float
    range_m: float


class Renderer(Protocol):
    """A renderer over one `GeometryStore`."""

    def render(
        self,
        camera: Pinhole,
        T_CW: F64,
        instances: Instances,
        out: Images,
        shown: Bool | None = None,
    ) -> None:
        """Draw into `out` what a camera sees.

        Args:
            camera: the camera; `out` must have its size.
            T_CW: (3, 4) world to camera frame, x right, y down, z forward.
            instances: the actors and wheelchairs to draw with the street.
            out: the buffers, written in place.
            shown: (n,) which of the instances are there for this camera; all of them when None.

        Raises:
            ConfigError: when a buffer has another size or type, or cannot be written.
        """


def check_images(camera: Pinhole, out: Images) -> None:
    """Raise ConfigError when `out` cannot take the images of `camera`."""
    shape = (camera.height_px, camera.width_px)
    _check("depth_m", out.depth_m, shape, np.dtype(np.float32))
    _check("class_id", out.class_id, shape, np.dtype(np.uint8))
    if out.rgb is not None:
        _check("rgb", out.rgb, (*shape, 3), np.dtype(np.uint8))
    if out.instance is not None:
        _check("instance", out.instance, shape, np.dtype(np.int32))


def _check(
    name: str, array: npt.NDArray[Any], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> None:
    usable = bool(array.flags.carray)
    if array.shape != shape or array.dtype != dtype or not usable:
        raise ConfigError(
            f"image buffer {name} is {array.dtype} {array.shape}, writable and C-contiguous: "
            f"{usable}; expected a writable C-contiguous {dtype} {shape}: make it with new_images()"
        )
