"""A small convolutional network without batch normalisation: patches, then stride-2 layers to a small map."""

from __future__ import annotations

import torch
from torch import nn

_MAP_HEIGHT = 8  # stride-2 layers are added until the feature map is no higher than this
_PATCH_PX, _PATCH_CHANNELS = 4, 24
FEATURES = 128


def strided(image_shape: tuple[int, int, int]) -> tuple[list[nn.Module], int]:
    """Patches and stride-2 convolutions behind them, down to a map of about 8x10; also how many channels that has."""
    channels, height, _ = image_shape
    layers: list[nn.Module] = [nn.Conv2d(channels, _PATCH_CHANNELS, _PATCH_PX, stride=_PATCH_PX), nn.ReLU()]
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
        layers, width = strided(image_shape)
        layers += [nn.Conv2d(width, 16, 1), nn.ReLU(), nn.Flatten()]
        self.cnn = nn.Sequential(*layers)
        with torch.no_grad():
            flat = self.cnn(torch.zeros(1, *image_shape)).shape[1]
        self.dense = nn.Sequential(nn.Linear(flat + vector_size, FEATURES), nn.ReLU())

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        """Features (B, 128) of image (B, C, H, W) and vector (B, V)."""
        return torch.as_tensor(self.dense(torch.cat([self.cnn(image), vector], dim=1)))
