"""Networks that keep the picture's two dimensions while they look through time: ConvLSTM and 3D convolutions.

ConvLSTM: Shi et al. 2015, which the paper tried in the place of its CNN. Both read the whole window anew in every step;
ConvLSTM can also be unrolled from a state that the caller carries.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import nn

from wcsim.agents.networks.convolutional import FEATURES, strided
from wcsim.agents.networks.recurrent import Shape, carried, lstm

_CELL = 24  # channels that are remembered
_DEPTH = 32


class ConvLstmNet(nn.Module):
    """A ConvLSTM in the place of Figure 6's CNN: its map becomes 128 numbers, and the LSTM behind it stays."""

    windowed: ClassVar[bool] = True
    window: ClassVar[int] = 4

    def __init__(self, image_shape: Shape, vector_size: int) -> None:
        super().__init__()
        del vector_size
        self.eye, width = _eye(image_shape)
        self.gates = nn.Conv2d(width + _CELL, 4 * _CELL, 3, padding=1)
        self.small = _Small(_CELL, self.eye, image_shape, 0)
        self.memory = lstm()
        with torch.no_grad():
            self._map = self.eye(torch.zeros(1, *image_shape[1:])).shape[2:]
            self._cells = 2 * _CELL * self._map.numel()
            self.state_size = self._cells + 2 * self.memory.hidden_size
            bias = torch.zeros(4 * _CELL)  # of the gates input, forget, cell, output
            bias[_CELL : 2 * _CELL] = 1.0  # it begins by remembering
            self.gates.bias = nn.Parameter(bias)

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        """Features (B, 128 + V) of image (B, T, C, H, W) and vector (B, V)."""
        remembered, _ = self._remembered(image, image.new_zeros(len(image), self.state_size))
        return torch.cat([remembered[:, -1], vector], dim=1)

    def unroll(
        self, image: torch.Tensor, vector: torch.Tensor, state: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Features (B, T, 128 + V) of images (B, T, C, H, W) and vectors (B, T, V) in a row, and the state after them.

        The state (B, state_size) is the one before them: zeros where an episode begins.
        """
        remembered, after = self._remembered(image, state)
        return torch.cat([remembered, vector], dim=2), after

    def _remembered(self, image: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What the LSTM gives after each image, (B, T, 128), and the flat state after the last."""
        seen = self.eye(image.flatten(0, 1)).unflatten(0, image.shape[:2])
        hidden, cell = torch.unflatten(state[:, : self._cells], 1, (2, _CELL, *self._map)).unbind(1)
        maps = []
        for tick in range(image.shape[1]):
            into, forget, new, out = self.gates(torch.cat([seen[:, tick], hidden], 1)).chunk(4, 1)
            cell = torch.sigmoid(forget) * cell + torch.sigmoid(into) * torch.tanh(new)
            hidden = torch.sigmoid(out) * torch.tanh(cell)
            maps.append(hidden)
        flat = torch.stack(maps, dim=1).flatten(0, 1)
        features = self.small(flat, flat.new_zeros(len(flat), 0)).unflatten(0, image.shape[:2])
        remembered, after = carried(self.memory, features, state[:, self._cells :])
        return remembered, torch.cat([torch.stack([hidden, cell], dim=1).flatten(1), after], dim=1)


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
        self.voter = _Small(_DEPTH, self.eye, image_shape, vector_size)

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        """Features (B, 128) of image (B, T, C, H, W) and vector (B, V)."""
        seen = self.eye(image.flatten(0, 1)).unflatten(0, image.shape[:2])
        return torch.as_tensor(self.voter(self.deep(seen.movedim(1, 2))[:, :, 0], vector))


class _Small(nn.Module):
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
    layers, width = strided(image_shape[1:])
    return nn.Sequential(*layers), width
