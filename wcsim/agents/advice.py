"""Safe actions of every step in a replay memory: a training aid from the privileged truth, never an observation.

The environment tells them in `info["truth"]` of the step that leads to an observation. The first observation of an
episode comes from a reset, whose info Stable-Baselines3 does not hand to the memory: that row stays without advice.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from wcsim.types import U8, Bool

I64 = npt.NDArray[np.int64]


class AdviceRing:
    """Bits beside the rows of a `FrameReplay`: which actions end well, and whether the user's command does not."""

    def __init__(self, rows: int, seats: int, actions: int) -> None:
        self._rows, self._actions = rows, actions
        self.bits = np.zeros((rows, seats, (actions + 7) // 8), dtype=np.uint8)  # 1 where safe, packed along the last
        self.known = np.zeros((rows, seats), dtype=bool)
        self.danger = np.zeros((rows, seats), dtype=bool)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.known[:] = False
        self.danger[:] = False
        self._coming: list[Any] = []  # the truth of the next row, by seat
        self.dangers: deque[tuple[int, int]] = deque()  # (absolute index, seat) with a successor, oldest first

    def write(self, index: int, fresh: Bool, infos: Sequence[dict[str, Any]]) -> None:
        """Keep the advice of step `index`; `infos` of that step hold the advice of the next one."""
        row = index % self._rows
        for seat, begins in enumerate(fresh):
            if not begins and self.danger[row - 1, seat]:
                self.dangers.append((index - 1, seat))
            truth = None if begins or not self._coming else self._coming[seat]
            self.known[row, seat] = truth is not None
            self.danger[row, seat] = truth is not None and truth.danger
            if truth is not None:
                self.bits[row, seat] = np.packbits(np.asarray(truth.safe_actions, dtype=bool))
        self._coming = [info.get("truth") for info in infos]

    def forget(self, index: int) -> None:
        """Drop what belongs to a row that is overwritten now."""
        while self.dangers and self.dangers[0][0] <= index:
            self.dangers.popleft()

    def read(self, rows: I64, seats: I64) -> tuple[Bool, Bool]:
        """Safe actions (K, A), and whether they are known (K,)."""
        safe = np.unpackbits(self.bits[rows, seats], axis=1, count=self._actions).astype(bool)
        return safe, self.known[rows, seats]

    def draw(self, count: int, rng: np.random.Generator) -> tuple[I64, I64]:
        """Absolute indices and seats of steps in which the user's command ends badly; some must be kept."""
        picks = [self.dangers[k] for k in rng.integers(0, len(self.dangers), count)]
        index, seats = np.array(picks, dtype=np.int64).T
        return index, seats

    def arrays(self, rows: I64) -> dict[str, U8 | Bool]:
        """What a checkpoint keeps of these rows."""
        return {"advice_bits": self.bits[rows], "advice_known": self.known[rows], "advice_danger": self.danger[rows]}

    def restore(self, arrays: dict[str, npt.NDArray[Any]], index: I64, fresh: Bool) -> None:
        """Put back what `arrays` gave, for the absolute indices (K,); `fresh` (K, seats) says where chains begin."""
        rows = index % self._rows
        self.bits[rows], self.known[rows] = arrays["advice_bits"], arrays["advice_known"]
        self.danger[rows] = arrays["advice_danger"]
        goes_on = self.danger[rows][:-1] & ~fresh[1:]
        self.dangers.extend((int(index[k]), int(seat)) for k, seat in np.argwhere(goes_on))
