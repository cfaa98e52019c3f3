"""How one observation is cut into a flat image part (bytes) and a flat vector part (float32), and back."""

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
    def image_bytes(self) -> int:
        """Bytes of all images of one observation."""
        return sum(int(np.prod(shape)) for _, shape in self.images)

    @property
    def vector_size(self) -> int:
        """Numbers in all vectors of one observation."""
        return sum(int(np.prod(shape)) for _, shape in self.vectors)

    def image_rows(self, batch: Mapping[str, npt.NDArray[Any]]) -> U8:
        """Images of a batch side by side, (N, image_bytes)."""
        return _rows(batch, self.images, np.dtype(np.uint8))

    def vector_rows(self, batch: Mapping[str, npt.NDArray[Any]]) -> F32:
        """Vectors of a batch side by side, (N, vector_size)."""
        return _rows(batch, self.vectors, np.dtype(np.float32))

    def split(self, images: U8, vectors: F32) -> dict[str, npt.NDArray[Any]]:
        """The batch of observations that these rows were made of; the parts are views."""
        return {**_parts(images, self.images), **_parts(vectors, self.vectors)}


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


def _rows(batch: Mapping[str, npt.NDArray[Any]], shapes: Shapes, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    count = len(next(iter(batch.values())))
    if not shapes:
        return np.zeros((count, 0), dtype=dtype)
    return np.concatenate([np.asarray(batch[key], dtype=dtype).reshape(count, -1) for key, _ in shapes], axis=1)


def _parts(rows: npt.NDArray[Any], shapes: Shapes) -> dict[str, npt.NDArray[Any]]:
    out: dict[str, npt.NDArray[Any]] = {}
    start = 0
    for key, shape in shapes:
        stop = start + int(np.prod(shape))
        out[key] = rows[:, start:stop].reshape(len(rows), *shape)
        start = stop
    return out
