"""The buffers of pictures, and where a seat gets its own: cameras, renderers and links share them.

A client that joins has its pictures in such buffers, and loads no renderer for it.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wcsim.types import F32, I32, U8


@dataclass(frozen=True, slots=True, kw_only=True)
class Images:
    """The buffers a renderer writes in place, C-contiguous and writable."""

    depth_m: F32  # (H, W) distance along the optical axis, range_m where nothing is hit
    class_id: U8  # (H, W) ClassId, SKY where nothing is hit
    # Drawn only where there is a buffer.
    rgb: U8 | None = None  # (H, W, 3)
    instance: I32 | None = None  # (H, W) row of the instance, -1 for street and sky


SeatBuffers = tuple[Images, ...]
"""Where the images of one seat go, one entry a camera in the rig's order."""


class ImageSink(Protocol):
    """Where the images of all seats go, such as memory that other processes see."""

    def buffers(self, seat: int, first: bool) -> SeatBuffers:
        """The buffers for the next images of a seat.

        With `first` they are for the first frame of an episode. It may be taken in the same tick as
        the last frame of the episode before, and must leave that one as it is.
        """


def new_images(width_px: int, height_px: int, rgb: bool, instance: bool = False) -> Images:
    """Fresh buffers for a camera of this size."""
    return Images(
        depth_m=np.zeros((height_px, width_px), np.float32),
        class_id=np.zeros((height_px, width_px), np.uint8),
        rgb=np.zeros((height_px, width_px, 3), np.uint8) if rgb else None,
        instance=np.full((height_px, width_px), -1, np.int32) if instance else None,
    )
