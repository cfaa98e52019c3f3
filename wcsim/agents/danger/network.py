"""The danger network: a logit of "this ends badly" for each joystick position.

The user's stick is no input. The logits of two heads are added up. The roll-out head paints cost
maps of the street, and reads them where each position would bring the chair. The context head sees
the street map as a whole.
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

_MAPS: Final = 2 * SLICES  # cost maps, of hull and wheels in each slice of time
_FIRST_LOGIT: Final = -3.0  # before anything is learned: dangers are so rare


def spec_of(config: RunConfig) -> DangerNetworkSpec:
    """The network of a run's configuration."""
    net = DangerNetworkShape(width=config.danger.width, actions=config.env.actions)
    first, *more = config.eyes.values()
    return DangerNetworkSpec(
        net=net, camera=first, more_cameras=tuple(more), classes=config.env.classes
    )


class DangerNet(nn.Module):
    """Logits (B, A) of a batch.

    The names of its modules are those of the saved weights. Their order is that of the random
    draws: in another order, a seed gives another network.

    Args:
        spec: Its shape, cameras and classes.
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
        self.context = _ContextHead(count)
        self.direct = nn.Sequential(
            nn.Linear(VECTOR, 48), nn.ReLU(), _scale_down(nn.Linear(48, count))
        )
        self.base = nn.Parameter(torch.tensor(_FIRST_LOGIT))
        # With PyTorch's own weights, signals fade: some seeds never learned to tell the sides.
        for layer in (*self.down, *self.deep, *self.context.squeeze, *self.context.dense):
            if isinstance(layer, (nn.Conv2d, nn.Linear)):
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
    """The same network; the weights of its two-dimensional convolutions have channels last."""
    for value in net.parameters():
        if value.dim() == 4:
            # On a CPU this is faster. It changes the order of sums, so all networks have it.
            value.data = value.data.contiguous(memory_format=torch.channels_last)
    return net


class _RollOutHead(nn.Module):
    """Logits from cost maps (B, _MAPS, SIDE, SIDE), read where hull and wheels sweep."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.narrow = nn.Conv2d(32, width, 3, padding=1)
        self.fine = nn.Conv2d(PLANES, _MAPS, 3, padding=1)
        self.out = nn.Conv2d(2 * width, 4 * _MAPS, 1)
        self.shuffle = nn.PixelShuffle(2)
        self.sharpness = nn.Parameter(torch.tensor(1.0))

    def forward(self, picture: Tensor, near: Tensor, far: Tensor, swept: Tensor) -> Tensor:
        """(B, A)."""
        # 1. The costs (B, A, n) of the cells that each position sweeps over.
        wide = functional.interpolate(functional.relu(self.narrow(far)), scale_factor=2.0)
        maps = self.shuffle(self.out(torch.cat([near, wide], 1))) + self.fine(picture)
        read = maps.reshape(len(maps), -1).gather(1, swept.flatten(1))
        costs = read.view(len(swept), swept.shape[1], -1)
        # 2. A soft maximum: one bad cell is a crash, but its neighbours need a gradient, too.
        # It is never flat (0.2). Equal costs give that cost, however many cells there are.
        sharp = functional.softplus(self.sharpness) + 0.2
        return (torch.logsumexp(costs * sharp, 2) - math.log(costs.shape[2])) / sharp


class _ContextHead(nn.Module):
    """Logits from the street map as a whole."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.squeeze = nn.Sequential(
            nn.Conv2d(32, 16, 3, stride=2, padding=1), nn.ReLU(), nn.Flatten()
        )
        flat = 16 * (SIDE // 8) ** 2
        self.dense = nn.Sequential(
            nn.Linear(flat + VECTOR, 128), nn.ReLU(), nn.Linear(128, 64), nn.ReLU()
        )
        self.out = _scale_down(nn.Linear(64, count))

    def forward(self, far: Tensor, vector: Tensor) -> Tensor:
        """(B, A)."""
        return torch.as_tensor(self.out(self.dense(torch.cat([self.squeeze(far), vector], 1))))


def _scale_down(layer: nn.Linear) -> nn.Linear:
    """The same layer with small weights: it says little before it has learned."""
    with torch.no_grad():
        layer.weight.mul_(0.1)
        layer.bias.zero_()
    return layer
