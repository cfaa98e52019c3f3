"""Networks over a short window of images: the paper's Figure 6 (CNN, LSTM, dense), a GRU in its place, stacked images.

All begin as `PatchNet` does, with the whole window in one batch. Called with a window, they read it anew in every
step, so no state is carried from step to step, and replay may draw steps in any order. With the same weights, LSTM and
GRU can also be unrolled from a state that the caller carries (`unroll`).
"""

from __future__ import annotations

from typing import ClassVar, TypeVar

import torch
from torch import nn

from wcsim.agents.networks.convolutional import FEATURES, PATCH_CHANNELS, PATCH_PX, PatchNet, StridedNet

_MEMORY = 128  # units of the recurrent layer
_REMEMBERS = 1.0  # bias of an LSTM's forget gates: three images later, 0.73 ** 3 = 0.39 of the cell is left
Shape = tuple[int, int, int, int]  # T, C, H, W
Recurrent = TypeVar("Recurrent", nn.LSTM, nn.GRU)


class RecurrentNet(nn.Module):
    """Each image to 128 numbers, then a recurrent layer over the window; its last output joins the vector."""

    windowed: ClassVar[bool] = True
    window: ClassVar[int] = 4

    def __init__(self, image_shape: Shape, memory: nn.LSTM | nn.GRU) -> None:
        super().__init__()
        _, channels, height, width = image_shape
        self.eye = PatchNet((channels, height, width), 0)
        self.memory = memory
        self.state_size = (2 if isinstance(memory, nn.LSTM) else 1) * _MEMORY

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


class Figure6Net(RecurrentNet):
    """Figure 6 of the paper: CNN, LSTM; the dense voter is the head, which gets IMU and joystick besides."""

    def __init__(self, image_shape: Shape, vector_size: int) -> None:
        del vector_size
        super().__init__(image_shape, lstm())


class GruNet(RecurrentNet):
    """A GRU in the place of the LSTM: three quarters of its weights. A fresh one gives the newest image half a say."""

    def __init__(self, image_shape: Shape, vector_size: int) -> None:
        del vector_size
        super().__init__(image_shape, _begun(nn.GRU(FEATURES, _MEMORY, batch_first=True)))


def lstm() -> nn.LSTM:
    """128 numbers to 128, one layer, batch first; it begins by remembering."""
    memory = _begun(nn.LSTM(FEATURES, _MEMORY, batch_first=True))
    with torch.no_grad():
        biases = memory.get_parameter("bias_ih_l0")  # of the gates input, forget, cell, output
        biases[_MEMORY : 2 * _MEMORY] = _REMEMBERS
    return memory


def carried(memory: nn.LSTM | nn.GRU, seen: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Outputs (B, T, 128) for `seen` (B, T, 128) in a row, and the flat state (B, S) after them; `state` is before."""
    before = state[None]
    if isinstance(memory, nn.LSTM):
        hidden, cell = (part.contiguous() for part in before.chunk(2, dim=2))
        remembered, after = memory(seen, (hidden, cell))
        after = torch.cat(after, dim=2)
    else:
        remembered, after = memory(seen, before.contiguous())
    return remembered, after[0]


def _begun(memory: Recurrent) -> Recurrent:
    """The same with orthogonal recurrent weights, Glorot's input weights and biases of zero."""
    with torch.no_grad():
        for name, values in memory.named_parameters():
            if name.startswith("bias"):
                values.zero_()
                continue
            fill = nn.init.orthogonal_ if name.startswith("weight_hh") else nn.init.xavier_uniform_
            for first in range(0, len(values), _MEMORY):
                fill(values[first : first + _MEMORY])  # gate by gate
    return memory


class StackNet(StridedNet):
    """The images of the window as the channels of one: `PatchNet` with patches that reach through the window."""

    windowed: ClassVar[bool] = True
    window: ClassVar[int] = 4

    def __init__(self, image_shape: Shape, vector_size: int) -> None:
        super().__init__(_StackStem(image_shape), image_shape, vector_size)


class _StackStem(nn.Conv3d):
    """Patches of T x 4 x 4 pixels; in three dimensions because stacking the channels would copy every image."""

    def __init__(self, image_shape: Shape) -> None:
        frames, channels, _, _ = image_shape
        super().__init__(channels, PATCH_CHANNELS, (frames, PATCH_PX, PATCH_PX), stride=(1, PATCH_PX, PATCH_PX))

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """The map (B, channels, H / 4, W / 4) of images (B, T, C, H, W)."""
        return super().forward(input.movedim(1, 2)).squeeze(2)
