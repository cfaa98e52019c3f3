"""Where replay keeps images in memory: raw bytes when frames are small, one zstd blob a frame when they are large.

Grouping several frames into a blob gains nothing (no temporal coding) and would cost random access.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import zstandard

from wcsim.agents.replay.blob import LEVEL, BlobCodec
from wcsim.types import I64, U8

_PACK_ABOVE_BYTES = 40_000  # an 80x60 pair of images has 9.6 kB and is not worth the time of packing
_CHUNK_FRAMES = 256  # frames of one blob in a checkpoint

Folded = U8 | bytes


class FrameStore(Protocol):
    """Frames of the last steps by (absolute index of the step, seat); a frame is a flat uint8 array of `size` bytes."""

    def write(self, index: int, seat: int, frame: U8) -> None:
        """Keep a frame (size,) of the next step."""

    def read(self, index: I64, seats: I64) -> U8:
        """Copies of frames, (K,) and (K,) -> (K, size)."""


class RawFrames:
    """Frames as they are."""

    def __init__(self, rows: int, seats: int, size: int) -> None:
        self._frames = np.zeros((rows, seats, size), dtype=np.uint8)

    def write(self, index: int, seat: int, frame: U8) -> None:
        """Keep a frame (size,)."""
        self._frames[index % len(self._frames), seat] = frame

    def read(self, index: I64, seats: I64) -> U8:
        """Copies of frames, (K, size)."""
        return np.asarray(self._frames[index % len(self._frames), seats], dtype=np.uint8)


class PackedFrames:
    """Frames as blobs, 3 to 24 kB for a 320x240 pair of images; `smooth` bytes at a frame's beginning are of depth."""

    def __init__(self, rows: int, seats: int, size: int, smooth: int = 0) -> None:
        self._blobs: list[list[bytes]] = [[b""] * seats for _ in range(rows)]
        self._size, self._codec = size, BlobCodec(size, smooth)

    def write(self, index: int, seat: int, frame: U8) -> None:
        """Keep a frame (size,)."""
        self._blobs[index % len(self._blobs)][seat] = self._codec.pack(frame)

    def read(self, index: I64, seats: I64) -> U8:
        """Copies of frames, (K, size); a place never written reads as zeros."""
        out = np.zeros((len(index), self._size), dtype=np.uint8)
        for k, (row, seat) in enumerate(zip(index % len(self._blobs), seats, strict=True)):
            blob = self._blobs[row][seat]
            if blob:
                out[k] = self._codec.unpack(blob)
        return out


def frame_store(rows: int, seats: int, size: int, smooth: int = 0) -> FrameStore:
    """The store in memory that fits frames of `size` bytes, the first `smooth` of depth, of the last `rows` steps."""
    return RawFrames(rows, seats, size) if size <= _PACK_ABOVE_BYTES else PackedFrames(rows, seats, size, smooth)


def folded(frame: U8) -> Folded:
    """A copy of one frame, or, of a large one, its blob."""
    return pack_each(frame[None])[0] if len(frame) > _PACK_ABOVE_BYTES else frame.copy()


def unfolded(kept: Folded, size: int) -> U8:
    """The frame (size,) of which `folded` made this."""
    return unpack_each([kept], size)[0] if isinstance(kept, bytes) else kept


def pack(frames: U8) -> list[bytes]:
    """Frames (K, size) as compressed blobs of up to 256 frames, for a file."""
    packer = zstandard.ZstdCompressor(level=LEVEL)
    return [packer.compress(frames[k : k + _CHUNK_FRAMES].tobytes()) for k in range(0, len(frames), _CHUNK_FRAMES)]


def unpack(blobs: list[bytes], size: int) -> U8:
    """What `pack` packed, (K, size)."""
    unpacker = zstandard.ZstdDecompressor()
    limit = _CHUNK_FRAMES * size
    parts = [np.frombuffer(unpacker.decompress(blob, max_output_size=limit), dtype=np.uint8) for blob in blobs]
    return np.concatenate(parts).reshape(-1, size) if parts else np.zeros((0, size), dtype=np.uint8)


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
