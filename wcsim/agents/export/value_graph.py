"""One tick of a network of Q-learning, for export: one picture goes in, and what it remembers goes in and comes out.

A network that carries a state has it as the model's state. One that looks at a window has the earlier pictures of the
window as its state, so whoever runs a model shows each picture once, whatever the network is.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import nn

from wcsim.agents.networks.encoder import image_size
from wcsim.agents.networks.q_network import QNet
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY
from wcsim.errors import PolicyError


class ValueGraph(nn.Module):
    """One tick of a network of Q-learning; every state is zero at the start of an episode.

    Args:
        net: Its weights.
        window: Images that it looks at; 1 if it carries a state.
    """

    outputs: Final = ("values",)
    checked: Final = "values"
    border_share: Final = 0.0

    def __init__(self, net: QNet, window: int) -> None:
        """Raises PolicyError for a network that sees something else than classes and depth."""
        if net.encoder.form != "compact":
            raise PolicyError(
                f"a network that sees env.observation={net.encoder.form} cannot be exported; expected compact"
            )
        super().__init__()
        self.net, self.window = net, window
        self.inputs = (DEPTH_KEY, CLASS_KEY, *net.encoder.vector_keys)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shapes of all states."""
        if self.net.spec.stateful:
            return {"state_memory": (1, self.net.encoder.state_size)}
        height_px, width_px = image_size(self.net.observation_space)
        earlier = (1, 2, self.window - 1, height_px, width_px)  # depth and classes, each number one higher
        return {"state_pictures": earlier} if self.window > 1 else {}

    def forward(self, *given: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Values (1, A) and the next states, of inputs and states in the order of `inputs` and `shapes`."""
        seen, states = dict(zip(self.inputs, given, strict=False)), given[len(self.inputs) :]
        if self.net.spec.stateful:
            return self.net.step(seen, *states)
        if not states:
            return (self.net(seen),)
        (earlier,) = states
        newest = torch.stack([seen[DEPTH_KEY], seen[CLASS_KEY]], 1).to(torch.float32) + 1.0
        # 0 is no picture yet: the first one of an episode fills the window, as in `FrameWindow`
        pictures = torch.cat([torch.where(earlier > 0.0, earlier, newest), newest], 2)
        depth, classes = (pictures - 1.0).unbind(1)
        return self.net({**seen, DEPTH_KEY: depth, CLASS_KEY: classes}), pictures[:, :, 1:]
