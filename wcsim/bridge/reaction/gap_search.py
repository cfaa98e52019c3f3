"""Where a person finds a way past what stands in front of it: plain geometry in the person's own frame."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from wcsim.core.boxes import Box

FURTHEST_M = 2.0
FOREGO_RIGHT_M = 0.2  # how much shorter the way on the left must be
BACK_PULL = 1.2  # a metre off one's own line counts as this much walking across: who can go back does


class Block(NamedTuple):  # made for everybody near a chair in every tick: a frozen dataclass costs twice as much
    """Something in the way: where it begins and ends ahead, and to the left of the person's own line, gaps included."""

    near_m: float
    far_m: float
    right_m: float
    left_m: float

    def blocks(self, left_m: float) -> bool:
        """Whether a person that walks so far left of its line would run into it."""
        return self.right_m < left_m < self.left_m

    @property
    def beside(self) -> bool:
        """Whether it is neither ahead nor behind: a step sideways may lead against it."""
        return self.near_m < 0.0 < self.far_m

    def parts(self, here_m: float, there_m: float) -> bool:
        """Whether it lies beside the person and between two places: nobody steps through it."""
        return self.beside and min(here_m, there_m) < 0.5 * (self.right_m + self.left_m) < max(here_m, there_m)


def block_of(x: float, y: float, cos: float, sin: float, box: Box, gap_m: float, end_gap_m: float) -> Block:
    """A box as somebody at (x, y) who looks along (cos, sin) sees it, with gaps at its sides and ends."""
    dx, dy = box[0] - x, box[1] - y
    turn_cos, turn_sin = abs(box[2] * cos + box[3] * sin), abs(box[3] * cos - box[2] * sin)
    ahead_m, aside_m = dx * cos + dy * sin, dy * cos - dx * sin
    long_m = box[4] * turn_cos + box[5] * turn_sin + end_gap_m
    wide_m = box[4] * turn_sin + box[5] * turn_cos + gap_m
    return Block(near_m=ahead_m - long_m, far_m=ahead_m + long_m, right_m=aside_m - wide_m, left_m=aside_m + wide_m)


def block_of_disc(ahead_m: float, aside_m: float, radius_m: float) -> Block:
    """Somebody round, so far ahead and to the left; of one that is behind, only what still is beside."""
    wide_m = radius_m if ahead_m >= 0.0 else math.sqrt(max(0.0, radius_m**2 - ahead_m**2))
    return Block(near_m=ahead_m - radius_m, far_m=ahead_m + radius_m, right_m=aside_m - wide_m, left_m=aside_m + wide_m)


def ways_round(blocks: Sequence[Block], now_m: float) -> Iterable[float]:
    """Places left of one's own line that no block covers and one can get to, the one with the shortest way first.

    >>> list(ways_round([Block(near_m=1.0, far_m=2.0, right_m=-0.6, left_m=0.8)], 0.0))
    [-0.6, 0.8]
    """
    ends = {end for block in blocks for end in (block.right_m, block.left_m)}
    free = {
        m
        for m in (0.0, now_m, *ends)
        if abs(m) <= FURTHEST_M and not any(block.blocks(m) or block.parts(now_m, m) for block in blocks)
    }
    return sorted(free, key=lambda m: (_cost(m, now_m), m))


def _cost(left_m: float, now_m: float) -> float:
    away_m = 0.0 if math.isclose(left_m, 0.0) else BACK_PULL * abs(left_m)
    return abs(left_m - now_m) + away_m + (FOREGO_RIGHT_M if left_m > max(now_m, 0.0) + 1e-9 else 0.0)
