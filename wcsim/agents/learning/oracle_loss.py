"""The training aid beyond the paper: values learn from the oracle which actions end badly.

Crashes are rare (a few in a kilometre), safe actions are known for every step and action. The oracle sees the true
geometry and speaks only while learning; the policy that comes out of it sees what every policy sees.
"""

from __future__ import annotations

import numpy as np
import torch
from torch.nn import functional

from wcsim.types import F32, F64

MARGIN_OFFSET = 0.4  # joystick distance that a margin adds to the distance between two actions
HALF_CELL = 0.125  # of the actions' lattice


def aid_loss(
    values: torch.Tensor, distances: torch.Tensor, safe: torch.Tensor, scale: float, unsafe: float
) -> torch.Tensor:
    """How far the safe action nearest to the user's joystick is from beating the others by a margin.

    The strongest rival counts as in DQfD; every unsafe action counts too, so that one step teaches about all of them.
    A row in which nothing is safe teaches nothing: what it would teach is to stand still.

    Args:
        values: (B, A) action values.
        distances: (B, A) joystick distance of every action from the user's.
        safe: (B, A) bool, which actions end well.
        scale: Of the reward; margins are joystick distances times this.
        unsafe: Joystick distance that the margin adds for an action that ends badly.

    Returns:
        A scalar, 0 when every row has its teacher's action ahead by the margins.
    """
    label = _teacher_actions(distances, safe)[:, None]
    margin = (distances - distances.gather(1, label)).clamp(min=0.0) + MARGIN_OFFSET + unsafe * ~safe
    margin = (scale * margin).scatter(1, label, 0.0)
    behind = functional.relu(values + margin - values.gather(1, label))  # (B, A), 0 at the label
    dense = (behind * ~safe).sum(dim=1) / (~safe).sum(dim=1).clamp(min=1)
    return ((behind.max(dim=1).values + dense) * safe.any(dim=1)).mean()


def _teacher_actions(distances: torch.Tensor, safe: torch.Tensor) -> torch.Tensor:
    """The safe action nearest to the user's joystick, where there is one; (B, A) and (B, A) -> (B,)."""
    return distances.masked_fill(~safe, torch.inf).argmin(dim=1)


def relabelled(joysticks_xy: F32, points: F64, share: float, rng: np.random.Generator) -> F32:
    """Other wishes for the same moments: whether an action is safe does not depend on what the user wants.

    A share of the rows (B, 2) gets the joystick near one of `points` (A, 2) instead, in the unit disc; so a moment in
    which the user happened to be right teaches too.
    """
    wish = points[rng.integers(0, len(points), len(joysticks_xy))]
    wish = wish + rng.uniform(-HALF_CELL, HALF_CELL, wish.shape)
    wish /= np.maximum(np.hypot(wish[:, 0], wish[:, 1]), 1.0)[:, None]
    replaced = rng.random(len(wish)) < share
    return np.where(replaced[:, None], wish, joysticks_xy).astype(np.float32)
