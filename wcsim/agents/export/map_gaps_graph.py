"""What `wcsim/agents/danger/map_gaps.py` reckons, in tensors that ONNX knows; a test holds the two together."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from wcsim.agents.danger.map_gaps import (
    FAR_CELLS,
    FIRST_ROW,
    HIDDEN_CELLS,
    NO_GROUND,
    RISE_CODES,
    SLOPE_CODES,
    discs_of,
)
from wcsim.agents.danger.roll_outs import INSIDE_M, NEAR_M, STEPS, TOUCH_M, WAY_M
from wcsim.agents.danger.street_map import BEHIND_M, CELL_M, HALF_M, HIGHEST, LOWEST, SIDE, TRAIL
from wcsim.agents.export.drive_law import Places
from wcsim.types import F64

_SPAN = 2 * FAR_CELLS - 1  # cells along which a nearest one is looked for


class MapGaps(nn.Module):
    """The numbers of each action.

    Args:
        box: (3,) rear, front and half the width of the chair in B.
    """

    def __init__(self, box: F64) -> None:
        super().__init__()
        offsets = torch.arange(_SPAN)
        kept = {
            "discs": torch.from_numpy(discs_of(box).astype(np.float32)),
            "places": (torch.arange(SIDE)[:, None] + offsets).reshape(-1),
            "squares": ((offsets - FAR_CELLS + 1) ** 2).to(torch.float32)[:, None],
            "rows": (torch.arange(SIDE) >= FIRST_ROW)[:, None],
        }
        self.discs: torch.Tensor
        self.places: torch.Tensor
        self.squares: torch.Tensor
        self.rows: torch.Tensor
        for name, tensor in kept.items():
            self.register_buffer(name, tensor, persistent=False)

    def forward(self, codes: torch.Tensor, rolled: Places, start: Places) -> torch.Tensor:
        """Numbers (K, NUMBERS) in 0..1, whole multiples of 1 / 255.

        Args:
            codes: (OWN_PLANES, SIDE, SIDE) of the street map, in 0..255.
            rolled: (STEPS, K) where each action brings the chair.
            start: (1,) where they begin.
        """
        away_m = self.distances(self.in_the_way(codes))
        gaps_m = self._gaps(away_m, rolled)
        least_m = gaps_m.amin(0)  # (2, K)
        gap = torch.floor(255.0 * ((least_m + INSIDE_M) / (NEAR_M + INSIDE_M)).clamp(0.0, 1.0))
        step = torch.arange(STEPS, dtype=gap.dtype, device=gap.device)[:, None, None]
        first = torch.where(gaps_m < TOUCH_M, step, torch.full_like(step, STEPS)).amin(0)
        touch = torch.floor(255.0 * first / STEPS)
        way_m = ((rolled[0][-1] - start[0]) ** 2 + (rolled[1][-1] - start[1]) ** 2).sqrt()
        way = torch.floor(255.0 * (way_m / WAY_M).clamp(max=1.0))
        return torch.stack([gap[0], touch[0], gap[1], touch[1], way], 1) / 255.0

    def in_the_way(self, codes: torch.Tensor) -> torch.Tensor:
        """(2, SIDE, SIDE) of what stands and of what moves."""
        low, high = codes[LOWEST], codes[HIGHEST]
        unseen = low < 0.5
        ground = torch.where(unseen, torch.full_like(low, NO_GROUND), low)
        for _ in range(HIDDEN_CELLS):
            filled = torch.minimum(ground, _lowest_around(ground) + SLOPE_CODES)
            ground = torch.where(unseen, filled, ground)
        lower = torch.minimum(low, _lowest_around(ground) + SLOPE_CODES)
        steps = (high > lower + (RISE_CODES + 0.5)) & self.rows
        moves = codes[TRAIL] > 0.5
        return torch.stack([steps & ~moves, steps & moves])

    def distances(self, cells: torch.Tensor) -> torch.Tensor:
        """(2, SIDE, SIDE) metres to the nearest of the marked cells, FAR_CELLS of them at most."""
        far = float(FAR_CELLS * FAR_CELLS)
        squares = torch.where(cells, 0.0, far)
        for _ in range(2):  # along the rows, then along the columns, which change places each time
            padded = functional.pad(squares, (FAR_CELLS - 1, FAR_CELLS - 1), value=far).transpose(1, 2)
            lines = padded.index_select(1, self.places).view(2, SIDE, _SPAN, SIDE)
            squares = (lines + self.squares).amin(2).clamp(max=far)
        return CELL_M * squares.sqrt()

    def _gaps(self, away_m: torch.Tensor, rolled: Places) -> torch.Tensor:
        """(STEPS, 2, K) room around the chair at each step."""
        x, y, yaw = (part[..., None] for part in rolled)
        cos, sin = torch.cos(yaw), torch.sin(yaw)
        row = SIDE - 0.5 - (x + cos * self.discs[:, 0] - sin * self.discs[:, 1] + BEHIND_M) / CELL_M
        column = (HALF_M - (y + sin * self.discs[:, 0] + cos * self.discs[:, 1])) / CELL_M - 0.5
        row, column = row.clamp(0.0, SIDE - 1.001), column.clamp(0.0, SIDE - 1.001)
        i, j = torch.floor(row), torch.floor(column)
        # One long dimension last: libraries take rows of two numbers one by one.
        down, right = (row - i).reshape(1, -1), (column - j).reshape(1, -1)
        at = (i * SIDE + j).reshape(-1).to(torch.int64)
        flat, last = away_m.reshape(2, -1), SIDE * SIDE - SIDE - 1  # what stands, what moves
        around = torch.cat([flat[:, first : first + last] for first in (0, 1, SIDE, SIDE + 1)]).t().contiguous()
        left_above, right_above, left_below, right_below = torch.split(around.index_select(0, at).t(), 2)
        above = (1.0 - right) * left_above + right * right_above
        below = (1.0 - right) * left_below + right * right_below
        room = ((1.0 - down) * above + down * below).view(2, *row.shape) - self.discs[:, 2]
        return room.amin(3).transpose(0, 1)


def _lowest_around(ground: torch.Tensor) -> torch.Tensor:
    """The least of each cell and the eight around it."""
    return -functional.max_pool2d(-ground[None, None], 3, stride=1, padding=1)[0, 0]
