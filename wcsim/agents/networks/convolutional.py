"""The networks by name: convolutions, and some with a memory behind or within them.

- PatchNet is small and has no batch normalisation: patches, then stride-2 layers to a small map.
- Figure6Net is the paper's Figure 6 (CNN, LSTM, dense), over a short window of images. It begins as `PatchNet` does,
  with the whole window in one batch.
- ConvLstmNet and Conv3dNet keep the picture's two dimensions while they look through time. ConvLSTM: Shi et al. 2015,
  which the paper tried in the place of its CNN.

Called with a window, the last three read it anew in every step, so no state is carried from step to step, and replay
may draw steps in any order. With the same weights, an LSTM can also be unrolled from a state that the caller carries
(`unroll`).
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import nn

_MAP_HEIGHT = 8  # stride-2 layers are added until the feature map is no higher than this
_PATCH_PX, _PATCH_CHANNELS = 4, 24
_FEATURES = 128
_MEMORY = 128  # units of the recurrent layer
_REMEMBERS = (
    1.0  # bias of an LSTM's forget gates: three images later, 0.73 ** 3 = 0.39 of the cell is left
)
_Shape = tuple[int, int, int, int]  # T, C, H, W
_CELL = 24  # channels that are remembered
_DEPTH = 32


def _strided(image_shape: tuple[int, int, int]) -> tuple[list[nn.Module], int]:
    """Patches and stride-2 convolutions behind them, down to a map of about 8x10; also how many channels that has."""
    channels, height, _ = image_shape
    layers: list[nn.Module] = [
        nn.Conv2d(channels, _PATCH_CHANNELS, _PATCH_PX, stride=_PATCH_PX),
        nn.ReLU(),
    ]
    height, width = height // _PATCH_PX, _PATCH_CHANNELS
    while height > _MAP_HEIGHT:
        layers += [nn.Conv2d(width, 32, 3, stride=2, padding=1), nn.ReLU()]
        height, width = (height + 1) // 2, 32
    return layers, width


class PatchNet(nn.Module):
    """Patches of 4 x 4 pixels, convolutions down to a map of about 8x10, 16 channels of it, one linear layer.

    It has about 0.2 M parameters for any image size.
    """

    def __init__(self, image_shape: tuple[int, int, int], vector_size: int) -> None:
        super().__init__()
        layers, width = _strided(image_shape)
        layers += [nn.Conv2d(width, 16, 1), nn.ReLU(), nn.Flatten()]
        self.cnn = nn.Sequential(*layers)
        with torch.no_grad():
            flat = self.cnn(torch.zeros(1, *image_shape)).shape[1]
        self.dense = nn.Sequential(nn.Linear(flat + vector_size, _FEATURES), nn.ReLU())

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        """Features (B, 128) of image (B, C, H, W) and vector (B, V)."""
        return torch.as_tensor(self.dense(torch.cat([self.cnn(image), vector], dim=1)))


class _Remembering(nn.Module):
    """A network that carries a state: over the images of a window, or from tick to tick where its caller holds it."""

    windowed: ClassVar[bool] = True
    window: ClassVar[int] = 4

    state_size: int

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

    def _remembered(
        self, image: torch.Tensor, state: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """What the LSTM gives after each image, (B, T, 128), and the flat state after the last."""
        raise NotImplementedError


class Figure6Net(_Remembering):
    """Figure 6 of the paper: each image to 128 numbers, an LSTM over the window; its last output joins the vector.

    The dense voter is the head, which gets IMU and joystick besides.
    """

    def __init__(self, image_shape: _Shape, vector_size: int) -> None:
        super().__init__()
        del vector_size
        memory = _lstm()  # before the eye: the order decides which random numbers each gets
        self.eye = PatchNet(image_shape[1:], 0)
        self.memory = memory
        self.state_size = 2 * _MEMORY

    def _remembered(
        self, image: torch.Tensor, state: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        seen = self.eye(image.flatten(0, 1), image.new_zeros(image.shape[0] * image.shape[1], 0))
        return _carried(self.memory, torch.unflatten(seen, 0, image.shape[:2]), state)


def _lstm() -> nn.LSTM:
    """128 numbers to 128, one layer, batch first; it begins by remembering.

    A fresh one has orthogonal recurrent weights, Glorot's input weights, and no bias but that of the forget gates.
    """
    memory = nn.LSTM(_FEATURES, _MEMORY, batch_first=True)
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


def _carried(
    memory: nn.LSTM, seen: torch.Tensor, state: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Outputs (B, T, 128) for `seen` (B, T, 128) in a row, and the flat state (B, S) after them; `state` is before."""
    hidden, cell = (part.contiguous() for part in state[None].chunk(2, dim=2))
    remembered, after = memory(seen, (hidden, cell))
    return remembered, torch.cat(after, dim=2)[0]


class ConvLstmNet(_Remembering):
    """A ConvLSTM in the place of Figure 6's CNN: its map becomes 128 numbers, and the LSTM behind it stays."""

    def __init__(self, image_shape: _Shape, vector_size: int) -> None:
        super().__init__()
        del vector_size
        self.eye, width = _eye(image_shape)
        self.gates = nn.Conv2d(width + _CELL, 4 * _CELL, 3, padding=1)
        self.small = _Small(_CELL, self.eye, image_shape, 0)
        self.memory = _lstm()
        with torch.no_grad():
            self._map = self.eye(torch.zeros(1, *image_shape[1:])).shape[2:]
            self._cells = 2 * _CELL * self._map.numel()
            self.state_size = self._cells + 2 * self.memory.hidden_size
            bias = torch.zeros(4 * _CELL)  # of the gates input, forget, cell, output
            bias[_CELL : 2 * _CELL] = 1.0  # it begins by remembering
            self.gates.bias = nn.Parameter(bias)

    def _remembered(
        self, image: torch.Tensor, state: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
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
        remembered, after = _carried(self.memory, features, state[:, self._cells :])
        return remembered, torch.cat([torch.stack([hidden, cell], dim=1).flatten(1), after], dim=1)


class Conv3dNet(nn.Module):
    """Each image to a small map, then convolutions through space and time until one moment is left."""

    windowed: ClassVar[bool] = True
    window: ClassVar[int] = 4

    def __init__(self, image_shape: _Shape, vector_size: int) -> None:
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

    def __init__(
        self, channels: int, eye: nn.Module, image_shape: _Shape, vector_size: int
    ) -> None:
        super().__init__()
        with torch.no_grad():
            cells = eye(torch.zeros(1, *image_shape[1:]))[0, 0].numel()
        self.small = nn.Sequential(nn.Conv2d(channels, 16, 1), nn.ReLU(), nn.Flatten())
        self.dense = nn.Sequential(nn.Linear(16 * cells + vector_size, _FEATURES), nn.ReLU())

    def forward(self, seen: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        return torch.as_tensor(self.dense(torch.cat([self.small(seen), vector], 1)))


def _eye(image_shape: _Shape) -> tuple[nn.Sequential, int]:
    layers, width = _strided(image_shape[1:])
    return nn.Sequential(*layers), width
