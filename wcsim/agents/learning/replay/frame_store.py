"""Where a replay memory stores its images: frames as they are or packed, and windows made of them.

Frames are raw bytes when they are small, and one zstd blob each when they are large. Grouping
several frames into a blob gains nothing (no temporal coding) and would cost random access.

In a blob, smooth pictures are differences between neighbours, then zstd at level 1. A noisy depth
picture is a third smaller when its holes (zeros: what the camera did not measure) are packed apart
and what is left is written as differences of neighbouring bytes. So is a blob whose parts are
packed by themselves, because zstd gives every part an entropy code of its own.

Of a window of frames, each frame is stored once: a window is put together from the steps before it.
The first frame of a chain of steps fills its window. A window that is put together otherwise (a
wrapper changed the observations, or the steps before it are forgotten) is stored whole beside the
frames, so what is read is what was written.
"""

import struct
from typing import Final

import numpy as np
import zstandard

from wcsim.core.reading import decompress_zstd
from wcsim.types import I64, U8, Bool

ZSTD_LEVEL: Final = 1
# An 80x60 pair of images has 9.6 kB and is not worth the time of packing.
PACK_ABOVE_BYTES: Final = 40_000
_LEAST_MATCH: Final = 7  # bytes; in noise a shorter repetition costs more than it saves
# A table so small that it stays in the cache, though a world was computed in between.
_HASH_LOG: Final = 12
_LENGTHS: Final = struct.Struct("<II")


class BlobCodec:
    """Packs frames of `size` bytes, the first `smooth` of a smooth picture with holes."""

    def __init__(self, size: int, smooth: int) -> None:
        self._size, self._smooth = size, smooth
        settings = zstandard.ZstdCompressionParameters.from_level(
            ZSTD_LEVEL, min_match=_LEAST_MATCH, hash_log=_HASH_LOG
        )
        self._pack = zstandard.ZstdCompressor(compression_params=settings)
        self._unpack = zstandard.ZstdDecompressor()

    def pack(self, frame: U8) -> bytes:
        """The blob of a frame (size,)."""
        smooth, others = frame[: self._smooth], frame[self._smooth :]
        measured = smooth != 0
        holes = b""
        if not measured.all():
            holes = self._pack.compress(np.packbits(measured).data)
            smooth = smooth[measured]
        steps = smooth.copy()
        steps[1:] -= smooth[:-1]
        packed = self._pack.compress(steps.data)
        rest = self._pack.compress(np.ascontiguousarray(others).data)
        return _LENGTHS.pack(len(holes), len(packed)) + holes + packed + rest

    def unpack(self, blob: bytes) -> U8:
        """The frame (size,) of a blob. Raises ValueError or ZstdError when it is none."""
        if len(blob) < _LENGTHS.size:
            raise ValueError(f"{len(blob)} bytes")
        hole_bytes, smooth_bytes = _LENGTHS.unpack_from(blob)
        first = _LENGTHS.size + hole_bytes
        stop = first + smooth_bytes
        steps = self._part(blob[first:stop], self._smooth)
        frame = np.zeros(self._size, np.uint8)
        frame[self._smooth :] = self._part(blob[stop:], self._size - self._smooth)
        if hole_bytes:
            bits = self._part(blob[_LENGTHS.size : first], -(-self._smooth // 8))
            measured = np.unpackbits(bits, count=self._smooth).astype(bool)
            frame[: self._smooth][measured] = np.cumsum(steps, dtype=np.uint8)
        else:
            np.cumsum(steps, dtype=np.uint8, out=frame[: self._smooth])
        return frame

    def _part(self, packed: bytes, most: int) -> U8:
        return np.frombuffer(decompress_zstd(packed, most, self._unpack), np.uint8)


class WindowStore:
    """Windows (frames * size,) by absolute step index and seat, of the last `steps` steps."""

    def __init__(self, steps: int, seats: int, frames: int, size: int, smooth: int = 0) -> None:
        """Room for windows of `frames` frames of `size` bytes, the first `smooth` of depth."""
        self._window, self._size = frames, size
        self._steps = steps
        # The oldest window's older frames belong to steps before it.
        self._rows = steps + frames - 1
        self.frames = _frame_store(self._rows, seats, size, smooth)
        self._chain_step = np.zeros((self._rows, seats), np.int64)  # since the chain's start
        # The last windows, as they would be read.
        self._last = np.zeros((seats, frames * size), np.uint8)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._next = -1  # the step that follows the last one
        self.whole_windows: dict[tuple[int, int], U8] = {}  # by (absolute index, seat)

    def write(self, index: int, windows: U8, starts: Bool) -> None:
        """Store the windows (seats, frames * size) of the next step.

        `starts` (seats,) are those where a chain starts.
        """
        self.write_newest(index, windows[:, -self._size :], starts)
        for seat in range(len(windows)):
            if not np.array_equal(windows[seat], self._last[seat]):
                self.whole_windows[index, seat] = windows[seat].copy()

    def write_newest(self, index: int, frames: U8, starts: Bool) -> None:
        """Store the newest frames (seats, size) of the next step; its windows follow from them."""
        # 1. After a gap nothing is known of the steps before: every chain starts.
        if index != self._next:
            starts = np.ones_like(starts)
        self._next = index + 1
        before = self._chain_step[(index - 1) % self._rows]
        self._chain_step[index % self._rows] = np.where(starts, 0, before + 1)
        for seat, frame in enumerate(frames):
            # 2. The frame takes the place of the oldest.
            self.whole_windows.pop((index - self._steps, seat), None)
            self.frames.write(index, seat, frame)
            # 3. The window that will be read is moved on by it.
            last = self._last[seat].reshape(self._window, self._size)
            if starts[seat]:
                last[:] = frame
            else:
                last[:-1] = last[1:].copy()
                last[-1] = frame

    def read(self, index: I64, seats: I64) -> U8:
        """Copies of windows, (K,) and (K,) -> (K, frames * size)."""
        rows = index % self._rows
        if self._window == 1 and not self.whole_windows:
            return self.frames.read(index, seats)
        back = np.arange(self._window - 1, -1, -1)[:, None]  # oldest first
        steps = np.minimum(back, self._chain_step[rows, seats])  # (frames, K)
        read = self.frames.read((index - steps).reshape(-1), np.tile(seats, self._window))
        in_order = np.moveaxis(read.reshape(self._window, len(index), self._size), 0, 1)
        # No -1 here: there may be no windows at all.
        out = in_order.reshape(len(index), self._window * self._size)
        if self.whole_windows:
            for k, key in enumerate(zip(index.tolist(), seats.tolist(), strict=True)):
                out[k] = self.whole_windows.get(key, out[k])
        return out

    def read_newest(self, index: I64, seat: int) -> U8:
        """Copies of the newest frames of one seat's windows, (K,) -> (K, size)."""
        return self.frames.read(index, np.full(len(index), seat))


class _RawFrames:
    """Frames of the last steps by (absolute index, seat): flat uint8 arrays of `size` bytes."""

    def __init__(self, rows: int, seats: int, size: int) -> None:
        self._frames = np.zeros((rows, seats, size), np.uint8)

    def write(self, index: int, seat: int, frame: U8) -> None:
        """Store a frame (size,) of the next step."""
        self._frames[index % len(self._frames), seat] = frame

    def read(self, index: I64, seats: I64) -> U8:
        """Copies of frames, (K,) and (K,) -> (K, size)."""
        return self._frames[index % len(self._frames), seats]


class _PackedFrames:
    """Frames as blobs, 3 to 24 kB for a 320x240 pair of images; their first bytes are of depth."""

    def __init__(self, rows: int, seats: int, size: int, smooth: int) -> None:
        self._blobs: list[list[bytes]] = [[b""] * seats for _ in range(rows)]
        self._size, self._codec = size, BlobCodec(size, smooth)

    def write(self, index: int, seat: int, frame: U8) -> None:
        """Store a frame (size,) of the next step."""
        self._blobs[index % len(self._blobs)][seat] = self._codec.pack(frame)

    def read(self, index: I64, seats: I64) -> U8:
        """Copies of frames, (K, size); a place never written reads as zeros."""
        out = np.zeros((len(index), self._size), np.uint8)
        for k, (row, seat) in enumerate(zip(index % len(self._blobs), seats, strict=True)):
            blob = self._blobs[row][seat]
            if blob:
                out[k] = self._codec.unpack(blob)
        return out


def _frame_store(rows: int, seats: int, size: int, smooth: int) -> _RawFrames | _PackedFrames:
    """The store that fits frames of `size` bytes, the first `smooth` of depth, of `rows` steps."""
    if size <= PACK_ABOVE_BYTES:
        return _RawFrames(rows, seats, size)
    return _PackedFrames(rows, seats, size, smooth)
