"""One frame as one blob: smooth pictures as differences between neighbours, then zstd at level 1.

A noisy depth picture is a third smaller when its holes (zeros: what the camera did not measure) are told apart and what
is left is written as differences of neighbouring bytes; and so is a blob whose parts are packed by themselves, because
zstd gives every part an entropy code of its own.
"""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
import zstandard

from wcsim.core.reading import unzstd
from wcsim.types import U8

LEVEL: Final = 1
_LEAST_MATCH: Final = 7  # bytes; in noise a shorter repetition costs more than it saves
_HASH_LOG: Final = 12  # a table so small that it is in the cache, though a world was computed in between
_LENGTHS: Final = struct.Struct("<II")


class BlobCodec:
    """Packs frames of `size` bytes, the first `smooth` of which are of a smooth picture with holes."""

    def __init__(self, size: int, smooth: int) -> None:
        self._size, self._smooth = size, smooth
        settings = zstandard.ZstdCompressionParameters.from_level(LEVEL, min_match=_LEAST_MATCH, hash_log=_HASH_LOG)
        self._pack = zstandard.ZstdCompressor(compression_params=settings)
        self._unpack = zstandard.ZstdDecompressor()

    def pack(self, frame: U8) -> bytes:
        """The blob of a frame (size,)."""
        smooth, others = frame[: self._smooth], frame[self._smooth :]
        there = smooth != 0
        holes = b""
        if not there.all():
            holes = self._pack.compress(np.packbits(there).data)
            smooth = smooth[there]
        steps = smooth.copy()
        steps[1:] -= smooth[:-1]
        packed = self._pack.compress(steps.data)
        rest = self._pack.compress(np.ascontiguousarray(others).data)
        return _LENGTHS.pack(len(holes), len(packed)) + holes + packed + rest

    def unpack(self, blob: bytes) -> U8:
        """The frame (size,) of a blob. Raises ValueError or ZstdError when it is of something else."""
        if len(blob) < _LENGTHS.size:
            raise ValueError(f"{len(blob)} bytes")
        hole_bytes, smooth_bytes = _LENGTHS.unpack_from(blob)
        first = _LENGTHS.size + hole_bytes
        stop = first + smooth_bytes
        steps = self._part(blob[first:stop], self._smooth)
        frame = np.zeros(self._size, dtype=np.uint8)
        frame[self._smooth :] = self._part(blob[stop:], self._size - self._smooth)
        if hole_bytes:
            bits = self._part(blob[_LENGTHS.size : first], -(-self._smooth // 8))
            there = np.unpackbits(bits, count=self._smooth).astype(bool)
            frame[: self._smooth][there] = np.cumsum(steps, dtype=np.uint8)
        else:
            np.cumsum(steps, dtype=np.uint8, out=frame[: self._smooth])
        return frame

    def _part(self, packed: bytes, most: int) -> U8:
        return np.frombuffer(unzstd(packed, most, self._unpack), np.uint8)
