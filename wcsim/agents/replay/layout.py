"""How one observation is cut into a flat image part (bytes) and a flat vector part (float32), and back.

The image part of a window is its frames one after the other, the newest last; a frame is all images of one moment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from wcsim.errors import PolicyError
from wcsim.types import F32, U8

Shapes = tuple[tuple[str, tuple[int, ...]], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationLayout:
    """Which keys of an observation are images (uint8) and which are vectors (float32), with their shapes, by name."""

    images: Shapes
    vectors: Shapes

    @property
    def window(self) -> int:
        """Frames in one observation: the images' common first dimension, 1 when they have none."""
        firsts = {shape[0] if len(shape) == 3 else 1 for _, shape in self.images}
        return firsts.pop() if len(firsts) == 1 else 1

    @property
    def frame_bytes(self) -> int:
        """Bytes of all images at one moment."""
        return self.image_bytes // self.window

    @property
    def image_bytes(self) -> int:
        """Bytes of all images of one observation."""
        return sum(int(np.prod(shape)) for _, shape in self.images)

    @property
    def vector_size(self) -> int:
        """Numbers in all vectors of one observation."""
        return sum(int(np.prod(shape)) for _, shape in self.vectors)

    def image_rows(self, batch: Mapping[str, npt.NDArray[Any]]) -> U8:
        """Images of a batch side by side, (N, image_bytes)."""
        count, frames = len(next(iter(batch.values()))), self.window
        if not self.images:
            return np.zeros((count, 0), dtype=np.uint8)
        parts = [np.asarray(batch[key], dtype=np.uint8).reshape(count, frames, -1) for key, _ in self.images]
        return np.concatenate(parts, axis=2).reshape(count, -1)

    def vector_rows(self, batch: Mapping[str, npt.NDArray[Any]]) -> F32:
        """Vectors of a batch side by side, (N, vector_size)."""
        count = len(next(iter(batch.values())))
        if not self.vectors:
            return np.zeros((count, 0), dtype=np.float32)
        parts = [np.asarray(batch[key], dtype=np.float32).reshape(count, -1) for key, _ in self.vectors]
        return np.concatenate(parts, axis=1)

    def split(self, images: U8, vectors: F32) -> dict[str, npt.NDArray[Any]]:
        """The batch of observations that these rows were made of; the parts are views."""
        return {**_parts(images, self.images, self.window), **_parts(vectors, self.vectors, 1)}


def layout_of(space: spaces.Space[Any]) -> ObservationLayout:
    """The layout of an observation space. Raises PolicyError when it is not a Dict of uint8 and float32 boxes."""
    if not isinstance(space, spaces.Dict):
        raise PolicyError(f"observation space is {space}; expected a Dict of boxes: set env.observation=compact")
    images: list[tuple[str, tuple[int, ...]]] = []
    vectors: list[tuple[str, tuple[int, ...]]] = []
    for key, box in sorted(space.spaces.items()):
        if not isinstance(box, spaces.Box) or box.dtype not in (np.uint8, np.float32):
            raise PolicyError(f"observation {key!r} is {box}; expected a Box of uint8 or float32")
        if box.dtype == np.float32 and len(box.shape) > 2:
            raise PolicyError(f"observation {key!r} is a float image; replay keeps bytes: set env.observation=compact")
        (images if box.dtype == np.uint8 else vectors).append((key, tuple(box.shape)))
    return ObservationLayout(images=tuple(images), vectors=tuple(vectors))


def _parts(rows: npt.NDArray[Any], shapes: Shapes, frames: int) -> dict[str, npt.NDArray[Any]]:
    out: dict[str, npt.NDArray[Any]] = {}
    by_frame = rows.reshape(len(rows), frames, rows.shape[1] // frames)
    start = 0
    for key, shape in shapes:
        stop = start + int(np.prod(shape)) // frames
        out[key] = by_frame[:, :, start:stop].reshape(len(rows), *shape)
        start = stop
    return out
