"""The danger network: 81 logits, one for each joystick position, of "this ends badly"; the user's wish is no input.

Its heads are added up: a roll-out head, which paints cost maps of the street and reads them where each position would
bring the chair, and a context head on the street map as a whole.
"""

import math
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from wcsim.agents.danger.street_map import PLANES, SIDE, SLICES, VECTOR
from wcsim.config import RunConfig
from wcsim.config.run_file import DangerNetworkShape, DangerNetworkSpec
from wcsim.supervisor.actions import action_set

_MAPS: Final = 2 * SLICES  # hull and wheels, by slice of time
_BASE: Final = -3.0  # so rare are dangers before anything is learned


def spec_of(config: RunConfig) -> DangerNetworkSpec:
    """The network that a run's configuration asks for."""
    net = DangerNetworkShape(width=config.danger.width, actions=config.env.actions)
    first, *more = config.eyes.values()
    return DangerNetworkSpec(net=net, camera=first, more_cameras=tuple(more), classes=config.env.classes)


class DangerNet(nn.Module):
    """Logits (B, A) of a batch of sights.

    Args:
        spec: Its parts.
    """

    def __init__(self, spec: DangerNetworkSpec) -> None:
        super().__init__()
        self.spec = spec
        count, width = len(action_set(spec.net.actions)), spec.net.width
        self.down = nn.Sequential(
            *(nn.Conv2d(PLANES, width, 4, stride=2, padding=1), nn.ReLU()),
            *(nn.Conv2d(width, width, 3, padding=1), nn.ReLU()),
        )
        self.deep = nn.Sequential(
            *(nn.Conv2d(width, 32, 4, stride=2, padding=1), nn.ReLU()),
            *(nn.Conv2d(32, 32, 3, padding=1), nn.ReLU()),
        )
        self.roll_out = _RollOutHead(width)
        self.context = Context(count)
        # The order of these modules is the order of the random draws: another one gives another network for a seed.
        self.direct = nn.Sequential(nn.Linear(VECTOR, 48), nn.ReLU(), _small_init(nn.Linear(48, count)))
        self.base = nn.Parameter(torch.tensor(_BASE))
        for layer in (*self.down, *self.deep, *self.context.squeeze, *self.context.dense):
            if isinstance(layer, (nn.Conv2d, nn.Linear)):
                # PyTorch's own start lets what tells streets apart fade on its way: some seeds never learned a side.
                nn.init.kaiming_uniform_(layer.weight, nonlinearity="relu")

    def forward(self, picture: Tensor, vector: Tensor, swept: Tensor) -> Tensor:
        """Logits (B, A).

        Args:
            picture: (B, PLANES, SIDE, SIDE) float32 in 0..1.
            vector: (B, VECTOR) float32.
            swept: (B, A, n) int64, see `street_map.sweep`.
        """
        logit = self.base + self.direct(vector)
        near = self.down(picture)
        far = self.deep(near)
        logit = logit + self.context(far, vector)
        return torch.as_tensor(logit + self.roll_out(picture, near, far, swept))


def channels_last(net: DangerNet) -> DangerNet:
    """The same network, the weights of its two-dimensional convolutions with channels last in memory."""
    for value in net.parameters():
        if value.dim() == 4:
            # Convolutions on a CPU run faster so; sums have another order, so weights are always kept in this form.
            value.data = value.data.contiguous(memory_format=torch.channels_last)
    return net


def _small_init(layer: nn.Linear) -> nn.Linear:
    """A layer that says little before it has learned."""
    with torch.no_grad():
        layer.weight.mul_(0.1)
        layer.bias.zero_()
    return layer


class _RollOutHead(nn.Module):
    """Cost maps (B, 2 * SLICES, SIDE, SIDE), read where hull and wheels sweep; the worst place counts most."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.narrow = nn.Conv2d(32, width, 3, padding=1)
        self.fine = nn.Conv2d(PLANES, _MAPS, 3, padding=1)
        self.out = nn.Conv2d(2 * width, 4 * _MAPS, 1)
        self.shuffle = nn.PixelShuffle(2)
        self.sharpness = nn.Parameter(torch.tensor(1.0))

    def forward(self, picture: Tensor, near: Tensor, far: Tensor, swept: Tensor) -> Tensor:
        """(B, A)."""
        wide = functional.interpolate(functional.relu(self.narrow(far)), scale_factor=2.0)
        maps = self.shuffle(self.out(torch.cat([near, wide], 1))) + self.fine(picture)
        read = maps.reshape(len(maps), -1).gather(1, swept.flatten(1)).view(len(swept), swept.shape[1], -1)
        # A soft maximum: one bad cell is a crash, but the gradient has to reach its neighbours too. Never flat (0.2).
        sharp = functional.softplus(self.sharpness) + 0.2
        # Less the logarithm of how many: equal costs give that cost, however many cells are read.
        return (torch.logsumexp(read * sharp, 2) - math.log(read.shape[2])) / sharp


class Context(nn.Module):
    """Logits of the street map as a whole."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.squeeze = nn.Sequential(nn.Conv2d(32, 16, 3, stride=2, padding=1), nn.ReLU(), nn.Flatten())
        flat = 16 * (SIDE // 8) ** 2
        self.dense = nn.Sequential(nn.Linear(flat + VECTOR, 128), nn.ReLU(), nn.Linear(128, 64), nn.ReLU())
        self.out = _small_init(nn.Linear(64, count))

    def forward(self, far: Tensor, vector: Tensor) -> Tensor:
        """(B, A)."""
        return torch.as_tensor(self.out(self.dense(torch.cat([self.squeeze(far), vector], 1))))
