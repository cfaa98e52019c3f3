"""The networks by name: convolutions, and some with a memory behind or within them.

- PatchNet is small and has no batch normalisation: patches, then stride-2 layers to a small map.
- Figure6Net is the paper's Figure 6 (CNN, LSTM, dense), over a short window of images. It starts as
  `PatchNet` does, with the whole window in one batch.
- ConvLstmNet and Conv3dNet preserve the picture's two dimensions while they look through time.
  ConvLSTM: Shi et al. 2015, which the paper tried in the place of its CNN.

Called with a window, the last three read it anew in every step, so no state is carried from step to
step, and replay may draw steps in any order. With the same weights, an LSTM can also be unrolled
from a state that the caller carries (`unroll`).

The names of layers stand in saved policies, and the order in which they are made decides which
random numbers each gets.
"""

from typing import ClassVar, Final

import torch
from torch import Tensor, nn

_Shape = tuple[int, int, int, int]  # T, C, H, W
_Unrolled = tuple[Tensor, Tensor]  # what comes of images in a row, and the state after them

_PATCH_PX: Final = 4
_PATCH_CHANNELS: Final = 24
_STRIDED_CHANNELS: Final = 32
_MAP_HEIGHT: Final = 8  # stride-2 layers are added until the feature map is no higher than this
_FEATURES: Final = 128
_LSTM_UNITS: Final = 128
# Of an LSTM's forget gates: three images later, 0.73 ** 3 = 0.39 of the cell is left.
_FORGET_BIAS: Final = 1.0
_CELL_CHANNELS: Final = 24  # of a ConvLSTM
_CONV3D_CHANNELS: Final = 32


class PatchNet(nn.Module):
    """Patches of 4 x 4 pixels, convolutions down to a map of about 8x10, one linear layer.

    It has about 0.2 M parameters for any image size.
    """

    def __init__(self, image_shape: tuple[int, int, int], vector_size: int) -> None:
        super().__init__()
        layers, channels = _map_layers(image_shape)
        layers += [nn.Conv2d(channels, 16, 1), nn.ReLU(), nn.Flatten()]
        self.cnn = nn.Sequential(*layers)
        with torch.no_grad():
            flat = self.cnn(torch.zeros(1, *image_shape)).shape[1]
        self.dense = nn.Sequential(nn.Linear(flat + vector_size, _FEATURES), nn.ReLU())

    def forward(self, image: Tensor, vector: Tensor) -> Tensor:
        """Features (B, 128) of image (B, C, H, W) and vector (B, V)."""
        return torch.as_tensor(self.dense(torch.cat([self.cnn(image), vector], dim=1)))


class _RecurrentNet(nn.Module):
    """A network that carries a state over the images of a window, or from tick to tick.

    From tick to tick its caller holds the state.
    """

    windowed: ClassVar[bool] = True
    window: ClassVar[int] = 4

    state_size: int

    def forward(self, image: Tensor, vector: Tensor) -> Tensor:
        """Features (B, 128 + V) of image (B, T, C, H, W) and vector (B, V)."""
        outputs, _ = self._run(image, image.new_zeros(len(image), self.state_size))
        return torch.cat([outputs[:, -1], vector], dim=1)

    def unroll(self, image: Tensor, vector: Tensor, state: Tensor) -> _Unrolled:
        """Features (B, T, 128 + V) of images and vectors in a row, and the state after them.

        Args:
            image: (B, T, C, H, W).
            vector: (B, T, V).
            state: (B, state_size) before them, zeros where an episode starts.
        """
        outputs, after = self._run(image, state)
        return torch.cat([outputs, vector], dim=2), after

    def _run(self, image: Tensor, state: Tensor) -> _Unrolled:
        """Outputs of the LSTM after each image, (B, T, 128), and the flat state after the last."""
        raise NotImplementedError


class Figure6Net(_RecurrentNet):
    """Figure 6 of the paper: each image to 128 numbers, and an LSTM over the window.

    Its last output joins the vector. The dense voter is the head, which gets IMU and joystick
    besides.
    """

    def __init__(self, image_shape: _Shape, vector_size: int) -> None:
        super().__init__()
        # The LSTM is made before the eye, and registered after it.
        memory = _lstm()
        self.eye = PatchNet(image_shape[1:], 0)
        self.memory = memory
        self.state_size = 2 * _LSTM_UNITS

    def _run(self, image: Tensor, state: Tensor) -> _Unrolled:
        seen = self.eye(image.flatten(0, 1), image.new_zeros(image.shape[0] * image.shape[1], 0))
        return _run_lstm(self.memory, torch.unflatten(seen, 0, image.shape[:2]), state)


class ConvLstmNet(_RecurrentNet):
    """A ConvLSTM in the place of Figure 6's CNN.

    Its map becomes 128 numbers, and the LSTM behind it stays.
    """

    def __init__(self, image_shape: _Shape, vector_size: int) -> None:
        super().__init__()
        self.eye, channels = _eye(image_shape)
        self.gates = nn.Conv2d(channels + _CELL_CHANNELS, 4 * _CELL_CHANNELS, 3, padding=1)
        self.small = _MapToFeatures(_CELL_CHANNELS, self.eye, image_shape, 0)
        self.memory = _lstm()
        with torch.no_grad():
            self._map_hw = self.eye(torch.zeros(1, *image_shape[1:])).shape[2:]
            # Hidden maps and cells of the ConvLSTM, before the state of the LSTM.
            self._map_numbers = 2 * _CELL_CHANNELS * self._map_hw.numel()
            self.state_size = self._map_numbers + 2 * self.memory.hidden_size
            # Of the gates input, forget, cell, output; as the LSTM it starts by remembering.
            bias = torch.zeros(4 * _CELL_CHANNELS)
            bias[_CELL_CHANNELS : 2 * _CELL_CHANNELS] = _FORGET_BIAS
            self.gates.bias = nn.Parameter(bias)

    def _run(self, image: Tensor, state: Tensor) -> _Unrolled:
        # 1. All images at once, each to a map.
        seen = self.eye(image.flatten(0, 1)).unflatten(0, image.shape[:2])
        # 2. The ConvLSTM from tick to tick.
        shape = (2, _CELL_CHANNELS, *self._map_hw)
        maps_before = torch.unflatten(state[:, : self._map_numbers], 1, shape)
        hidden, cell = maps_before.unbind(1)
        maps = []
        for tick in range(image.shape[1]):
            into, forget, new, out = self.gates(torch.cat([seen[:, tick], hidden], 1)).chunk(4, 1)
            cell = torch.sigmoid(forget) * cell + torch.sigmoid(into) * torch.tanh(new)
            hidden = torch.sigmoid(out) * torch.tanh(cell)
            maps.append(hidden)
        # 3. Each map to features, and the LSTM over these.
        flat = torch.stack(maps, dim=1).flatten(0, 1)
        features = self.small(flat, flat.new_zeros(len(flat), 0)).unflatten(0, image.shape[:2])
        outputs, after = _run_lstm(self.memory, features, state[:, self._map_numbers :])
        return outputs, torch.cat([torch.stack([hidden, cell], dim=1).flatten(1), after], dim=1)


class Conv3dNet(nn.Module):
    """Each image to a small map, then convolutions in space and time until one moment is left."""

    windowed: ClassVar[bool] = True
    window: ClassVar[int] = 4

    def __init__(self, image_shape: _Shape, vector_size: int) -> None:
        super().__init__()
        self.eye, channels = _eye(image_shape)
        # Two layers in time: the first takes up to three images, the second what is left of them.
        frames = image_shape[0]
        first = min(frames, 3)
        second = frames - first + 1
        self.deep = nn.Sequential(
            nn.Conv3d(channels, _CONV3D_CHANNELS, (first, 3, 3), padding=(0, 1, 1)),
            nn.ReLU(),
            nn.Conv3d(_CONV3D_CHANNELS, _CONV3D_CHANNELS, (second, 3, 3), padding=(0, 1, 1)),
            nn.ReLU(),
        )
        self.voter = _MapToFeatures(_CONV3D_CHANNELS, self.eye, image_shape, vector_size)

    def forward(self, image: Tensor, vector: Tensor) -> Tensor:
        """Features (B, 128) of image (B, T, C, H, W) and vector (B, V)."""
        seen = self.eye(image.flatten(0, 1)).unflatten(0, image.shape[:2])
        return torch.as_tensor(self.voter(self.deep(seen.movedim(1, 2))[:, :, 0], vector))


class _MapToFeatures(nn.Module):
    """A small map and the vector to 128 features."""

    def __init__(
        self, channels: int, eye: nn.Module, image_shape: _Shape, vector_size: int
    ) -> None:
        super().__init__()
        with torch.no_grad():
            cells = eye(torch.zeros(1, *image_shape[1:]))[0, 0].numel()
        self.small = nn.Sequential(nn.Conv2d(channels, 16, 1), nn.ReLU(), nn.Flatten())
        self.dense = nn.Sequential(nn.Linear(16 * cells + vector_size, _FEATURES), nn.ReLU())

    def forward(self, seen: Tensor, vector: Tensor) -> Tensor:
        return torch.as_tensor(self.dense(torch.cat([self.small(seen), vector], 1)))


def _eye(image_shape: _Shape) -> tuple[nn.Sequential, int]:
    """The layers that take each image of a window to a map, and the map's channels."""
    layers, channels = _map_layers(image_shape[1:])
    return nn.Sequential(*layers), channels


def _map_layers(image_shape: tuple[int, int, int]) -> tuple[list[nn.Module], int]:
    """Patches and stride-2 convolutions, down to a map of about 8x10; also the map's channels."""
    planes, height, _ = image_shape
    layers: list[nn.Module] = [
        nn.Conv2d(planes, _PATCH_CHANNELS, _PATCH_PX, stride=_PATCH_PX),
        nn.ReLU(),
    ]
    height, channels = height // _PATCH_PX, _PATCH_CHANNELS
    while height > _MAP_HEIGHT:
        layers += [nn.Conv2d(channels, _STRIDED_CHANNELS, 3, stride=2, padding=1), nn.ReLU()]
        height, channels = (height + 1) // 2, _STRIDED_CHANNELS
    return layers, channels


def _lstm() -> nn.LSTM:
    """128 numbers to 128, one layer, batch first; it starts by remembering.

    A fresh one has orthogonal recurrent weights, Glorot's input weights, and no bias but that of
    the forget gates.
    """
    memory = nn.LSTM(_FEATURES, _LSTM_UNITS, batch_first=True)
    with torch.no_grad():
        for name, values in memory.named_parameters():
            if name.startswith("bias"):
                values.zero_()
                continue
            fill = nn.init.orthogonal_ if name.startswith("weight_hh") else nn.init.xavier_uniform_
            for first in range(0, len(values), _LSTM_UNITS):
                fill(values[first : first + _LSTM_UNITS])  # gate by gate
        biases = memory.get_parameter("bias_ih_l0")  # of the gates input, forget, cell, output
        biases[_LSTM_UNITS : 2 * _LSTM_UNITS] = _FORGET_BIAS
    return memory


def _run_lstm(memory: nn.LSTM, seen: Tensor, state: Tensor) -> _Unrolled:
    """Outputs (B, T, 128) for `seen` (B, T, 128) in a row, and the flat state (B, S) after them."""
    hidden, cell = (part.contiguous() for part in state[None].chunk(2, dim=2))
    outputs, after = memory(seen, (hidden, cell))
    return outputs, torch.cat(after, dim=2)[0]
