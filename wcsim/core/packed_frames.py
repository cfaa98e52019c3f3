"""Pictures in memory, each packed by itself, so that any of them can be read alone."""

from __future__ import annotations

from typing import Final

import numpy as np
import zstandard

from wcsim.types import U8

LEVEL: Final = 1  # of zstd


def pack_each(frames: U8) -> list[bytes]:
    """Frames (K, size) as a compressed blob each."""
    packer = zstandard.ZstdCompressor(level=LEVEL)
    # Copied: a blob as it comes lies in a block for a frame that cannot be compressed, whose rest is lost.
    return [bytes(memoryview(packer.compress(frame.tobytes()))) for frame in frames]


def unpack_each(blobs: list[bytes], size: int) -> U8:
    """What `pack_each` packed, (K, size)."""
    unpacker, out = zstandard.ZstdDecompressor(), np.empty((len(blobs), size), np.uint8)
    for row, blob in zip(out, blobs, strict=True):
        row[:] = np.frombuffer(unpacker.decompress(blob, max_output_size=size), np.uint8)
    return out
