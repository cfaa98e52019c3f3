"""From dangers to an action: the nearest to the user's stick that is safe enough; the last one is kept a little longer.

The threshold is the assistance level, and can be set at run time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wcsim.config import DangerConfig
from wcsim.supervisor.actions import ActionSet
from wcsim.types import F64

LESS_M = 0.02  # danger that a joystick distance of 1 is worth where nothing is safe


@dataclass(frozen=True, slots=True, kw_only=True)
class DangerRule:
    """How dangers are answered."""

    threshold: float = 0.3  # of danger: below it an action is allowed
    keep: float = 0.06  # joystick distance by which the last action is taken for nearer
    lenient: float = 1.3  # times the threshold for the last action
    shy: float = 0.1  # joystick distance that a danger of the whole threshold is worth
    warn: float = 0.5  # of the user's own stick's danger: above it, warn


def rule_of(danger: DangerConfig) -> DangerRule:
    """The rule that a run's configuration asks for."""
    return DangerRule(
        threshold=danger.threshold, keep=danger.keep, lenient=danger.lenient, shy=danger.shy, warn=danger.warn
    )


def choose(danger: F64, stick: F64, actions: ActionSet, rule: DangerRule, last: int = -1) -> int:
    """The action.

    Args:
        danger: (A,) in 0..1.
        stick: (2,) the user's.
        actions: The joystick positions.
        rule: See there.
        last: The action before, -1 for none.
    """
    distance = actions.distances(stick[None])[0]
    limit, cost = np.full(len(danger), rule.threshold), distance + rule.shy * danger / rule.threshold
    if last >= 0:
        limit[last] *= rule.lenient
        cost[last] -= rule.keep
    allowed = danger < limit
    if allowed.any():
        return int(np.argmin(np.where(allowed, cost, np.inf)))
    return int(np.argmin(danger + LESS_M * distance))
