"""How one observation is cut into a flat image part (bytes) and a flat vector part (float32), and back.

Images of float32 are kept as their bytes. The image part of a window is its frames one after the other, the newest
last; a frame is all images of one moment.
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
    """Which keys of an observation are images and which are vectors (float32), with their shapes, by name."""

    images: Shapes
    vectors: Shapes
    item_bytes: int = 1  # of a number of an image: uint8, or 4 for float32

    @property
    def window(self) -> int:
        """Frames in one observation: the smallest first dimension of its images, where it divides them all; else 1."""
        firsts = [shape[0] if len(shape) == 3 else 1 for _, shape in self.images] or [1]
        return min(firsts) if all(first % min(firsts) == 0 for first in firsts) else 1

    @property
    def frame_bytes(self) -> int:
        """Bytes of all images at one moment."""
        return self.image_bytes // self.window

    @property
    def image_bytes(self) -> int:
        """Bytes of all images of one observation."""
        return self.item_bytes * sum(int(np.prod(shape)) for _, shape in self.images)

    @property
    def vector_size(self) -> int:
        """Numbers in all vectors of one observation."""
        return sum(int(np.prod(shape)) for _, shape in self.vectors)

    def image_rows(self, batch: Mapping[str, npt.NDArray[Any]]) -> U8:
        """Images of a batch side by side, (N, image_bytes)."""
        count, frames = len(next(iter(batch.values()))), self.window
        if not self.images:
            return np.zeros((count, 0), dtype=np.uint8)
        parts = [np.asarray(batch[key], dtype=self._dtype).reshape(count, frames, -1) for key, _ in self.images]
        # As bytes: the stores behind it know no floats, and the same bits come back.
        rows: U8 = np.concatenate(parts, axis=2).reshape(count, -1).view(np.uint8)
        return rows

    def vector_rows(self, batch: Mapping[str, npt.NDArray[Any]]) -> F32:
        """Vectors of a batch side by side, (N, vector_size)."""
        count = len(next(iter(batch.values())))
        if not self.vectors:
            return np.zeros((count, 0), dtype=np.float32)
        parts = [np.asarray(batch[key], dtype=np.float32).reshape(count, -1) for key, _ in self.vectors]
        return np.concatenate(parts, axis=1)

    def split(self, images: U8, vectors: F32) -> dict[str, npt.NDArray[Any]]:
        """The batch of observations that these rows were made of; the parts are views."""
        pictures = np.ascontiguousarray(images).view(self._dtype)
        return {**_parts(pictures, self.images, self.window), **_parts(vectors, self.vectors, 1)}

    @property
    def _dtype(self) -> type[np.uint8] | type[np.float32]:
        return np.uint8 if self.item_bytes == 1 else np.float32


def layout_of(space: spaces.Space[Any]) -> ObservationLayout:
    """The layout of an observation space.

    Raises:
        PolicyError: It is not a Dict of uint8 and float32 boxes, or has images of both kinds.
    """
    if not isinstance(space, spaces.Dict):
        raise PolicyError(f"observation space is {space}; expected a Dict of boxes: set env.observation=compact")
    images: list[tuple[str, tuple[int, ...]]] = []
    vectors: list[tuple[str, tuple[int, ...]]] = []
    for key, box in sorted(space.spaces.items()):
        if not isinstance(box, spaces.Box) or box.dtype not in (np.uint8, np.float32):
            raise PolicyError(f"observation {key!r} is {box}; expected a Box of uint8 or float32")
        is_image = box.dtype == np.uint8 or len(box.shape) > 2
        (images if is_image else vectors).append((key, tuple(box.shape)))
    sizes = {space[key].dtype.itemsize for key, _ in images} or {1}  # type: ignore[union-attr]
    if len(sizes) > 1:
        raise PolicyError(f"images of {space} are of uint8 and float32; expected one kind: see env.observation")
    return ObservationLayout(images=tuple(images), vectors=tuple(vectors), item_bytes=sizes.pop())


def _parts(rows: npt.NDArray[Any], shapes: Shapes, frames: int) -> dict[str, npt.NDArray[Any]]:
    out: dict[str, npt.NDArray[Any]] = {}
    by_frame = rows.reshape(len(rows), frames, rows.shape[1] // frames)
    start = 0
    for key, shape in shapes:
        stop = start + int(np.prod(shape)) // frames
        out[key] = by_frame[:, :, start:stop].reshape(len(rows), *shape)
        start = stop
    return out
