"""Safe actions of every step in a replay memory: a training aid from the privileged truth, never an observation.

The environment tells them in `info["truth"]` of the step that leads to an observation. The first observation of an
episode comes from a reset, whose info Stable-Baselines3 does not hand to the memory: that row stays without advice.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from wcsim.types import I64, U8, Bool


class AdviceBatch(NamedTuple):
    """Observations with the actions that end well in them."""

    observations: dict[str, torch.Tensor]
    safe: torch.Tensor  # (B, A) bool


class AdviceRing:
    """Bits beside the rows of a `FrameReplay`: which actions end well."""

    def __init__(self, rows: int, seats: int, actions: int) -> None:
        self._rows, self._actions = rows, actions
        self.bits = np.zeros((rows, seats, (actions + 7) // 8), dtype=np.uint8)  # 1 where safe, packed along the last
        self.known = np.zeros((rows, seats), dtype=bool)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.known[:] = False
        self._coming: list[Any] = []  # the truth of the next row, by seat
        self._all: deque[tuple[int, int]] = deque()  # (absolute index, seat) of every known row, oldest first
        self._tight: deque[tuple[int, int]] = deque()  # of those in which some action ends badly

    def write(self, index: int, fresh: Bool, infos: Sequence[dict[str, Any]]) -> None:
        """Keep the advice of step `index`; `infos` of that step hold the advice of the next one."""
        self._forget(index - self._rows)
        row = index % self._rows
        for seat, begins in enumerate(fresh):
            truth = None if begins or not self._coming else self._coming[seat]
            self.known[row, seat] = truth is not None
            if truth is not None:
                self.bits[row, seat] = np.packbits(np.asarray(truth.safe_actions, dtype=bool))
                self._list(index, seat)
        self._coming = [info.get("truth") for info in infos]

    def draw(self, count: int, tight_share: float, rng: np.random.Generator) -> tuple[I64, I64] | None:
        """Absolute indices and seats of known rows, a share of them where some action ends badly; None without any."""
        if not self._all:
            return None
        tight = round(tight_share * count) if self._tight else 0
        picks = [self._tight[k] for k in rng.integers(0, max(len(self._tight), 1), tight)]
        picks += [self._all[k] for k in rng.integers(0, len(self._all), count - tight)]
        index, seats = np.array(picks, dtype=np.int64).T
        return index, seats

    def safe(self, index: I64, seats: I64) -> Bool:
        """Safe actions of these rows, (K, A)."""
        bits = self.bits[index % self._rows, seats]
        return np.unpackbits(bits, axis=1, count=self._actions).astype(bool)

    def arrays(self, rows: I64) -> dict[str, U8 | Bool]:
        """What a checkpoint keeps of these rows."""
        return {"advice_bits": self.bits[rows], "advice_known": self.known[rows]}

    def restore(self, arrays: dict[str, npt.NDArray[Any]], index: I64) -> None:
        """Put back what `arrays` gave, for the absolute indices (K,)."""
        self.bits[index % self._rows] = arrays["advice_bits"]
        self.known[index % self._rows] = arrays["advice_known"]
        for k, seat in np.argwhere(arrays["advice_known"]):
            self._list(int(index[k]), int(seat))

    def _list(self, index: int, seat: int) -> None:
        self._all.append((index, seat))
        if not self.safe(np.array([index]), np.array([seat])).all():
            self._tight.append((index, seat))

    def _forget(self, index: int) -> None:
        """Drop what belongs to a row that is overwritten now."""
        for listed in (self._all, self._tight):
            while listed and listed[0][0] <= index:
                listed.popleft()
