"""Windows of frames of which each frame is kept once: a window is put together from the steps before it.

The first frame of a chain of steps fills its window. A window that is put together otherwise (a wrapper changed the
observations, or the steps before it are gone) is kept whole beside the frames, so what is read is what was written.
"""

from __future__ import annotations

import numpy as np

from wcsim.agents.replay.frame_store import FrameStore, frame_store
from wcsim.types import I64, U8, Bool


class WindowStore:
    """Windows (frames * size,) by absolute step index and seat, of the last `steps` steps."""

    def __init__(self, steps: int, seats: int, frames: int, size: int, smooth: int = 0) -> None:
        """A place for `steps` windows of `frames` frames of `size` bytes in each seat, the first `smooth` of depth."""
        self._window, self._size = frames, size
        self._rows = steps + frames - 1  # the oldest window's older frames belong to steps before it
        self._steps = steps
        self.frames: FrameStore = frame_store(self._rows, seats, size, smooth)
        self._depth = np.zeros((self._rows, seats), dtype=np.int64)  # steps since the start of the chain
        self._told = np.zeros((seats, frames * size), dtype=np.uint8)  # the last windows, as they would be read
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._next = -1  # the step that follows the last one
        self.whole: dict[tuple[int, int], U8] = {}  # by (absolute index, seat)

    def write(self, index: int, windows: U8, fresh: Bool) -> None:
        """Keep the windows (seats, frames * size) of the next step; `fresh` (seats,) says where a chain begins."""
        self.write_newest(index, windows[:, -self._size :], fresh)
        for seat in range(len(windows)):
            if not np.array_equal(windows[seat], self._told[seat]):
                self.whole[index, seat] = windows[seat].copy()

    def write_newest(self, index: int, frames: U8, fresh: Bool) -> None:
        """Keep the newest frames (seats, size) of the next step, whose windows follow from the steps before."""
        fresh = self._follow(index, fresh)
        for seat, frame in enumerate(frames):
            self.whole.pop((index - self._steps, seat), None)
            self.frames.write(index, seat, frame)
            told = self._told[seat].reshape(self._window, self._size)
            if fresh[seat]:
                told[:] = frame
            else:
                told[:-1] = told[1:].copy()
                told[-1] = frame

    def _follow(self, index: int, fresh: Bool) -> Bool:
        """Note where chains begin at the next step; returns where they do."""
        if index != self._next:  # nothing is known of the steps before
            fresh = np.ones_like(fresh)
        self._next = index + 1
        self._depth[index % self._rows] = np.where(fresh, 0, self._depth[(index - 1) % self._rows] + 1)
        return fresh

    def read(self, index: I64, seats: I64) -> U8:
        """Copies of windows, (K,) and (K,) -> (K, frames * size)."""
        rows = index % self._rows
        if self._window == 1 and not self.whole:
            return self.frames.read(index, seats)
        back = np.arange(self._window - 1, -1, -1)[:, None]  # oldest first
        steps = np.minimum(back, self._depth[rows, seats])  # (frames, K)
        read = self.frames.read((index - steps).reshape(-1), np.tile(seats, self._window))
        in_order = np.moveaxis(read.reshape(self._window, len(index), self._size), 0, 1)
        out = in_order.reshape(len(index), self._window * self._size)  # also of no windows at all
        if self.whole:
            for k, key in enumerate(zip(index.tolist(), seats.tolist(), strict=True)):
                out[k] = self.whole.get(key, out[k])
        return out

    def read_newest(self, index: I64, seat: int) -> U8:
        """Copies of the newest frames of one seat's windows, (K,) -> (K, size)."""
        return self.frames.read(index, np.full(len(index), seat))
