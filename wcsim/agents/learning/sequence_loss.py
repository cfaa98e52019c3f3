"""Losses over groups of steps in a row, for networks that carry a state: `agents/replay/groups.py` says what is drawn.

Online and target network are each run over the steps before a group, from the stored state and without a gradient, and
then over the group itself and what its last n-step returns reach.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch.nn import functional

from wcsim.agents.networks.q_network import QNet
from wcsim.agents.policy_api import JOYSTICK_KEY
from wcsim.agents.replay.groups import SequenceBatch


@torch.no_grad()
def burned_in(net: QNet, batch: SequenceBatch) -> torch.Tensor:
    """The network's state (K, S) where the groups begin."""
    states = batch.states.clone()
    for rows, observations in batch.burn_in:
        states[rows] = net.unroll(observations, states[rows])[1]
    return states


def group_values(net: QNet, batch: SequenceBatch) -> torch.Tensor:
    """Values (K, P, A) of all observations of the groups."""
    return net.unroll(batch.observations, burned_in(net, batch))[0]


@torch.no_grad()
def group_targets(
    online: torch.Tensor, target: torch.Tensor, batch: SequenceBatch, reward_scale: float, double_q: bool
) -> torch.Tensor:
    """Scaled n-step returns plus the discounted value after them, (K, L), from both networks' values (K, P, A)."""
    judge = online if double_q else target
    best = target.gather(2, judge.argmax(dim=2, keepdim=True))[..., 0]  # (K, P)
    value = best.gather(1, batch.after)
    return reward_scale * batch.returns + (1.0 - batch.terminated) * batch.discounts * value


def sequence_loss(
    nets: tuple[QNet, QNet],
    batch: SequenceBatch,
    reward_scale: float,
    double_q: bool,
    supervised: Callable[[torch.Tensor, dict[str, torch.Tensor]], torch.Tensor] | None,
) -> tuple[torch.Tensor, float]:
    """Huber loss over the steps of the groups, and the largest value that was met.

    Args:
        nets: Online and target network.
        batch: Groups.
        reward_scale: Of the returns.
        double_q: The online network chooses the action whose value the target network gives.
        supervised: Added to it: of values (N, A) and the joysticks that they are for, by their key.
    """
    online = group_values(nets[0], batch)
    with torch.no_grad():
        target = group_values(nets[1], batch)
    wanted = group_targets(online.detach(), target, batch, reward_scale, double_q)[batch.live]
    length = batch.live.shape[1]
    values = online[:, :length][batch.live[:, : online.shape[1]]]  # (N, A)
    chosen = values.gather(1, batch.actions[batch.live][:, None])[:, 0]
    loss = functional.smooth_l1_loss(chosen, wanted)
    if supervised is not None:
        sticks = batch.observations[JOYSTICK_KEY][:, :length][batch.live[:, : online.shape[1]]]
        loss = loss + supervised(values, {JOYSTICK_KEY: sticks})
    return loss, float(values.detach().abs().max())
