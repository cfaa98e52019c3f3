"""A residual network in the manner of IMPALA (Espeholt et al. 2018) behind a stride-4 stem, for full-size images."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

FEATURES = 256


class Residual(nn.Module):
    """Two 3x3 convolutions beside the identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """The same shape as x."""
        return x + torch.as_tensor(self.second(functional.relu(self.first(functional.relu(x)))))


class ImpalaNet(nn.Module):
    """Stem, then stages of convolution, max-pooling and two residual blocks until the map is no higher than 8."""

    def __init__(self, image_shape: tuple[int, int, int], vector_size: int) -> None:
        super().__init__()
        height, width = image_shape[1], 16
        layers: list[nn.Module] = [nn.Conv2d(image_shape[0], width, 8, stride=4, padding=2)]
        height = (height - 4) // 4 + 1
        while height > 8 or width == 16:
            layers += [nn.Conv2d(width, 32, 3, padding=1), nn.MaxPool2d(3, 2, 1), Residual(32), Residual(32)]
            height, width = (height + 1) // 2, 32
        self.cnn = nn.Sequential(*layers, nn.ReLU(), nn.Flatten())
        with torch.no_grad():
            flat = self.cnn(torch.zeros(1, *image_shape)).shape[1]
        self.dense = nn.Sequential(nn.Linear(flat + vector_size, FEATURES), nn.ReLU())

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        """Features (B, 256) of image (B, C, H, W) and vector (B, V)."""
        return torch.as_tensor(self.dense(torch.cat([self.cnn(image), vector], dim=1)))
