"""Networks that keep the picture's two dimensions while they look through time: ConvLSTM and 3D convolutions.

ConvLSTM: Shi et al. 2015, the form that the paper tried first. Both read the whole window anew in every step.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import nn

from wcsim.agents.networks.convolutional import FEATURES, PATCH_CHANNELS, PATCH_PX, strided
from wcsim.agents.networks.recurrent import Shape

_CELL = 24  # channels that are remembered
_DEPTH = 32


class ConvLstmNet(nn.Module):
    """Each image to a small map, a ConvLSTM over the window, then one linear layer over its last map."""

    windowed: ClassVar[bool] = True
    window: ClassVar[int] = 4

    def __init__(self, image_shape: Shape, vector_size: int) -> None:
        super().__init__()
        self.eye, width = _eye(image_shape)
        self.gates = nn.Conv2d(width + _CELL, 4 * _CELL, 3, padding=1)
        self.voter = _Voter(_CELL, self.eye, image_shape, vector_size)
        with torch.no_grad():
            bias = torch.zeros(4 * _CELL)  # of the gates input, forget, cell, output
            bias[_CELL : 2 * _CELL] = 1.0  # it begins by remembering
            self.gates.bias = nn.Parameter(bias)

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        """Features (B, 128) of image (B, T, C, H, W) and vector (B, V)."""
        batch, frames = image.shape[:2]
        seen = self.eye(image.flatten(0, 1)).unflatten(0, (batch, frames))
        hidden = cell = seen.new_zeros((batch, _CELL, *seen.shape[3:]))
        for tick in range(frames):
            into, forget, new, out = self.gates(torch.cat([seen[:, tick], hidden], 1)).chunk(4, 1)
            cell = torch.sigmoid(forget) * cell + torch.sigmoid(into) * torch.tanh(new)
            hidden = torch.sigmoid(out) * torch.tanh(cell)
        return torch.as_tensor(self.voter(hidden, vector))


class Conv3dNet(nn.Module):
    """Each image to a small map, then convolutions through space and time until one moment is left."""

    windowed: ClassVar[bool] = True
    window: ClassVar[int] = 4

    def __init__(self, image_shape: Shape, vector_size: int) -> None:
        super().__init__()
        frames = image_shape[0]
        self.eye, width = _eye(image_shape)
        first = min(frames, 3)
        self.deep = nn.Sequential(
            *(nn.Conv3d(width, _DEPTH, (first, 3, 3), padding=(0, 1, 1)), nn.ReLU()),
            *(nn.Conv3d(_DEPTH, _DEPTH, (frames - first + 1, 3, 3), padding=(0, 1, 1)), nn.ReLU()),
        )
        self.voter = _Voter(_DEPTH, self.eye, image_shape, vector_size)

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        """Features (B, 128) of image (B, T, C, H, W) and vector (B, V)."""
        seen = self.eye(image.flatten(0, 1)).unflatten(0, image.shape[:2])
        return torch.as_tensor(self.voter(self.deep(seen.movedim(1, 2))[:, :, 0], vector))


class _Voter(nn.Module):
    """A small map and the vector to features."""

    def __init__(self, channels: int, eye: nn.Module, image_shape: Shape, vector_size: int) -> None:
        super().__init__()
        with torch.no_grad():
            cells = eye(torch.zeros(1, *image_shape[1:]))[0, 0].numel()
        self.small = nn.Sequential(nn.Conv2d(channels, 16, 1), nn.ReLU(), nn.Flatten())
        self.dense = nn.Sequential(nn.Linear(16 * cells + vector_size, FEATURES), nn.ReLU())

    def forward(self, seen: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        return torch.as_tensor(self.dense(torch.cat([self.small(seen), vector], 1)))


def _eye(image_shape: Shape) -> tuple[nn.Sequential, int]:
    channels = image_shape[1]
    layers, width = strided(nn.Conv2d(channels, PATCH_CHANNELS, PATCH_PX, stride=PATCH_PX), image_shape[1:])
    return nn.Sequential(*layers), width
