"""One frame as one blob: smooth pictures as differences between neighbours, then zstd at level 1.

A noisy depth picture is a quarter smaller as differences of neighbouring bytes, and so is a blob whose parts are packed
by themselves, because zstd gives every part an entropy code of its own.
"""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
import zstandard

from wcsim.types import U8

LEVEL: Final = 1
_LEAST_MATCH: Final = 7  # bytes; in noise a shorter repetition costs more than it saves
_LENGTH: Final = struct.Struct("<I")


class BlobCodec:
    """Packs frames of `size` bytes, the first `smooth` of which are of a smooth picture."""

    def __init__(self, size: int, smooth: int) -> None:
        self._size, self._smooth = size, smooth
        settings = zstandard.ZstdCompressionParameters.from_level(LEVEL, min_match=_LEAST_MATCH)
        self._pack = zstandard.ZstdCompressor(compression_params=settings)
        self._unpack = zstandard.ZstdDecompressor()

    def pack(self, frame: U8) -> bytes:
        """The blob of a frame (size,)."""
        smooth = np.diff(frame[: self._smooth], prepend=np.uint8(0))
        first = self._pack.compress(smooth.tobytes())
        return _LENGTH.pack(len(first)) + first + self._pack.compress(frame[self._smooth :].tobytes())

    def unpack(self, blob: bytes) -> U8:
        """The frame (size,) of a blob. Raises ValueError or ZstdError when it is of something else."""
        if len(blob) < _LENGTH.size:
            raise ValueError(f"{len(blob)} bytes")
        stop = _LENGTH.size + _LENGTH.unpack_from(blob)[0]
        rest = self._size - self._smooth
        smooth = self._unpack.decompress(blob[_LENGTH.size : stop], max_output_size=self._smooth)
        others = self._unpack.decompress(blob[stop:], max_output_size=rest)
        if (len(smooth), len(others)) != (self._smooth, rest):
            raise ValueError(f"{len(smooth)} and {len(others)} bytes")
        frame = np.empty(self._size, dtype=np.uint8)
        np.cumsum(np.frombuffer(smooth, np.uint8), dtype=np.uint8, out=frame[: self._smooth])
        frame[self._smooth :] = np.frombuffer(others, np.uint8)
        return frame
