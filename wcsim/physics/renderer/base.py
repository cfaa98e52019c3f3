"""What every renderer offers: draw the street and the actors of one moment into given buffers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from wcsim.physics.buffers import Images
from wcsim.physics.renderer.instances import Instances
from wcsim.types import F64, Bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Pinhole:
    """An ideal camera; its axis goes through the middle of the image, pixel (u, v) is seen at (u + 0.5, v + 0.5)."""

    width_px: int
    height_px: int
    focal_px: float
    near_m: float
    range_m: float


class Renderer(Protocol):
    """A renderer over one `GeometryStore`."""

    def render(self, camera: Pinhole, T_CW: F64, instances: Instances, out: Images, shown: Bool | None = None) -> None:
        """Draw into `out` what a camera sees.

        Args:
            camera: the camera; `out` must have its size.
            T_CW: (3, 4) world to camera frame, x right, y down, z forward.
            instances: the actors and wheelchairs to draw with the street.
            out: the buffers, written in place, of the camera's size, as `new_images` makes them.
            shown: (n,) which of the instances are there for this camera; all of them when None.
        """
