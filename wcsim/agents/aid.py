"""The training aid beyond the paper: values learn from the oracle which actions end badly.

Crashes are rare (a few in a kilometre), safe actions are known for every step and action. The oracle sees the true
geometry and speaks only while learning; the policy that comes out of it sees what every policy sees.
"""

from __future__ import annotations

import torch
from torch.nn import functional

OFFSET = 0.4  # joystick distance that the margin adds to the distance between two actions
UNSAFE = 1.0  # the same for an action that ends badly


def aid_loss(
    values: torch.Tensor,
    distances: torch.Tensor,
    safe: torch.Tensor,
    advised: torch.Tensor,
    rest: int,
    scale: float,
) -> torch.Tensor:
    """How far the safe action nearest to the user's joystick is from beating the others by a margin.

    The strongest rival counts as in DQfD; every unsafe action counts too, so that one step teaches about all of them.

    Args:
        values: (B, A) action values.
        distances: (B, A) joystick distance of every action from the user's.
        safe: (B, A) bool, which actions end well. Where none does, the teacher chooses `rest`.
        advised: (B,) bool, whether `safe` is known; the other rows are left out.
        rest: Index of the stick at rest, which brakes.
        scale: Of the reward; margins are joystick distances times this.

    Returns:
        A scalar, 0 when every row has its teacher's action ahead by the margins.
    """
    label = teacher_actions(distances, safe, rest)[:, None]
    best = values.gather(1, label)
    margin = (distances - distances.gather(1, label)).clamp(min=0.0) + OFFSET + UNSAFE * ~safe
    margin = (scale * margin).scatter(1, label, 0.0)
    behind = functional.relu(values + margin - best)  # (B, A), 0 at the label
    unsafe = ~safe & safe.any(dim=1, keepdim=True)
    dense = (behind * unsafe).sum(dim=1) / unsafe.sum(dim=1).clamp(min=1)
    known = advised.to(values.dtype)
    return ((behind.max(dim=1).values + dense) * known).sum() / known.sum().clamp(min=1.0)


def teacher_actions(distances: torch.Tensor, safe: torch.Tensor, rest: int) -> torch.Tensor:
    """The safe action nearest to the user's joystick, or `rest` where nothing is safe; (B, A) and (B, A) -> (B,)."""
    nearest = distances.masked_fill(~safe, torch.inf).argmin(dim=1)
    return torch.where(safe.any(dim=1), nearest, torch.full_like(nearest, rest))
