"""Small convolutional networks without batch normalisation: a stem of its own, then stride-2 layers to a small map."""

from __future__ import annotations

import torch
from torch import nn

_MAP_HEIGHT = 8  # stride-2 layers are added until the feature map is no higher than this
FEATURES = 128
PATCH_PX, PATCH_CHANNELS = 4, 24


def strided(stem: nn.Module, image_shape: tuple[int, ...]) -> tuple[list[nn.Module], int]:
    """A stem and stride-2 convolutions behind it, down to a map of about 8x10; also how many channels that has."""
    layers: list[nn.Module] = [stem, nn.ReLU()]
    with torch.no_grad():
        _, width, height, _ = stem(torch.zeros(1, *image_shape)).shape
    while height > _MAP_HEIGHT:
        layers += [nn.Conv2d(width, 32, 3, stride=2, padding=1), nn.ReLU()]
        height, width = (height + 1) // 2, 32
    return layers, width


class StridedNet(nn.Module):
    """A stem, stride-2 convolutions down to a map of about 8x10, 16 channels of it, one linear layer.

    The stem makes a map (B, channels, H, W) of images of the given shape.
    """

    def __init__(self, stem: nn.Module, image_shape: tuple[int, ...], vector_size: int) -> None:
        super().__init__()
        layers, width = strided(stem, image_shape)
        layers += [nn.Conv2d(width, 16, 1), nn.ReLU(), nn.Flatten()]
        self.cnn = nn.Sequential(*layers)
        with torch.no_grad():
            flat = self.cnn(torch.zeros(1, *image_shape)).shape[1]
        self.dense = nn.Sequential(nn.Linear(flat + vector_size, FEATURES), nn.ReLU())

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        """Features (B, 128) of image (B, C, H, W) and vector (B, V)."""
        return torch.as_tensor(self.dense(torch.cat([self.cnn(image), vector], dim=1)))


class SmallNet(StridedNet):
    """About 0.2 M parameters for any image size."""

    def __init__(self, image_shape: tuple[int, int, int], vector_size: int) -> None:
        super().__init__(nn.Conv2d(image_shape[0], 16, 5, stride=2, padding=2), image_shape, vector_size)


class PatchNet(StridedNet):
    """First cuts the image into patches of 4 x 4 pixels: a third of the time of `small` for small images."""

    def __init__(self, image_shape: tuple[int, int, int], vector_size: int) -> None:
        super().__init__(nn.Conv2d(image_shape[0], PATCH_CHANNELS, PATCH_PX, stride=PATCH_PX), image_shape, vector_size)
