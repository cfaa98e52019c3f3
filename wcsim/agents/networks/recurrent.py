"""The paper's Figure 6 (CNN, LSTM, dense), over a short window of images.

It begins as `PatchNet` does, with the whole window in one batch. Called with a window, it reads it anew in every step,
so no state is carried from step to step, and replay may draw steps in any order. With the same weights, the LSTM can
also be unrolled from a state that the caller carries (`unroll`).
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import nn

from wcsim.agents.networks.convolutional import FEATURES, PatchNet

_MEMORY = 128  # units of the recurrent layer
_REMEMBERS = 1.0  # bias of an LSTM's forget gates: three images later, 0.73 ** 3 = 0.39 of the cell is left
Shape = tuple[int, int, int, int]  # T, C, H, W


class Figure6Net(nn.Module):
    """Figure 6 of the paper: each image to 128 numbers, an LSTM over the window; its last output joins the vector.

    The dense voter is the head, which gets IMU and joystick besides.
    """

    windowed: ClassVar[bool] = True
    window: ClassVar[int] = 4

    def __init__(self, image_shape: Shape, vector_size: int) -> None:
        super().__init__()
        del vector_size
        memory = lstm()  # before the eye: the order decides which random numbers each gets
        self.eye = PatchNet(image_shape[1:], 0)
        self.memory = memory
        self.state_size = 2 * _MEMORY

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        """Features (B, 128 + V) of image (B, T, C, H, W) and vector (B, V)."""
        remembered, _ = self.memory(self._seen(image))
        return torch.cat([remembered[:, -1], vector], dim=1)

    def unroll(
        self, image: torch.Tensor, vector: torch.Tensor, state: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Features (B, T, 128 + V) of images (B, T, C, H, W) and vectors (B, T, V) in a row, and the state after them.

        The state (B, state_size) is the one before them: zeros where an episode begins.
        """
        remembered, after = carried(self.memory, self._seen(image), state)
        return torch.cat([remembered, vector], dim=2), after

    def _seen(self, image: torch.Tensor) -> torch.Tensor:
        seen = self.eye(image.flatten(0, 1), image.new_zeros(image.shape[0] * image.shape[1], 0))
        return torch.unflatten(seen, 0, image.shape[:2])


def lstm() -> nn.LSTM:
    """128 numbers to 128, one layer, batch first; it begins by remembering.

    A fresh one has orthogonal recurrent weights, Glorot's input weights, and no bias but that of the forget gates.
    """
    memory = nn.LSTM(FEATURES, _MEMORY, batch_first=True)
    with torch.no_grad():
        for name, values in memory.named_parameters():
            if name.startswith("bias"):
                values.zero_()
                continue
            fill = nn.init.orthogonal_ if name.startswith("weight_hh") else nn.init.xavier_uniform_
            for first in range(0, len(values), _MEMORY):
                fill(values[first : first + _MEMORY])  # gate by gate
        biases = memory.get_parameter("bias_ih_l0")  # of the gates input, forget, cell, output
        biases[_MEMORY : 2 * _MEMORY] = _REMEMBERS
    return memory


def carried(memory: nn.LSTM, seen: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Outputs (B, T, 128) for `seen` (B, T, 128) in a row, and the flat state (B, S) after them; `state` is before."""
    hidden, cell = (part.contiguous() for part in state[None].chunk(2, dim=2))
    remembered, after = memory(seen, (hidden, cell))
    return remembered, torch.cat(after, dim=2)[0]
