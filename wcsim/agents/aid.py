"""The training aid beyond the paper: values learn from the oracle which actions end badly.

Crashes are rare (a few in a kilometre), safe actions are known for every step and action. The oracle sees the true
geometry and speaks only while learning; the policy that comes out of it sees what every policy sees.
"""

from __future__ import annotations

import numpy as np
import torch
from torch.nn import functional

from wcsim.types import F32, F64, Bool

OFFSET = 0.4  # joystick distance that the margin adds to the distance between two actions
HALF_CELL = 0.125  # of the actions' lattice


def aid_loss(
    values: torch.Tensor, distances: torch.Tensor, safe: torch.Tensor, rest: int, scale: float, unsafe: float
) -> torch.Tensor:
    """How far the safe action nearest to the user's joystick is from beating the others by a margin.

    The strongest rival counts as in DQfD; every unsafe action counts too, so that one step teaches about all of them.

    Args:
        values: (B, A) action values.
        distances: (B, A) joystick distance of every action from the user's.
        safe: (B, A) bool, which actions end well. Where none does, the teacher chooses `rest`.
        rest: Index of the stick at rest, which brakes.
        scale: Of the reward; margins are joystick distances times this.
        unsafe: Joystick distance that the margin adds for an action that ends badly.

    Returns:
        A scalar, 0 when every row has its teacher's action ahead by the margins.
    """
    label = teacher_actions(distances, safe, rest)[:, None]
    margin = (distances - distances.gather(1, label)).clamp(min=0.0) + OFFSET + unsafe * ~safe
    margin = (scale * margin).scatter(1, label, 0.0)
    behind = functional.relu(values + margin - values.gather(1, label))  # (B, A), 0 at the label
    dense = (behind * ~safe).sum(dim=1) / (~safe).sum(dim=1).clamp(min=1)
    return (behind.max(dim=1).values + dense).mean()


def teacher_actions(distances: torch.Tensor, safe: torch.Tensor, rest: int) -> torch.Tensor:
    """The safe action nearest to the user's joystick, or `rest` where nothing is safe; (B, A) and (B, A) -> (B,)."""
    nearest = distances.masked_fill(~safe, torch.inf).argmin(dim=1)
    return torch.where(safe.any(dim=1), nearest, torch.full_like(nearest, rest))


def relabelled(joysticks_xy: F32, safe: Bool, points: F64, share: float, rng: np.random.Generator) -> F32:
    """Other wishes for the same moments: whether an action is safe does not depend on what the user wants.

    A share of the rows gets a random joystick position (2,) in the unit disc; where some action ends badly it is a bad
    one, so that a moment in which the user happened to be right teaches too.
    """
    candidates = np.where(safe.all(axis=1, keepdims=True), True, ~safe)
    chosen = np.where(candidates, rng.random(safe.shape), -1.0).argmax(axis=1)
    wish = points[chosen] + rng.uniform(-HALF_CELL, HALF_CELL, joysticks_xy.shape)
    wish /= np.maximum(np.hypot(wish[:, 0], wish[:, 1]), 1.0)[:, None]
    replaced = rng.random(len(wish)) < share
    return np.where(replaced[:, None], wish, joysticks_xy).astype(np.float32)
