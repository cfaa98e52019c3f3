"""From dangers to an action: the nearest to the user's stick that is safe enough.

The user's own is taken whenever it is safe enough, or is not for a single tick; among the others the choice is calm, so
that the chair does not waver between two ways round. The threshold is the assistance level, and can be set at run time.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from wcsim.config.run_file import DangerRule
from wcsim.supervisor.actions import ActionSet
from wcsim.types import F64, Bool

LESS_M = 0.02  # danger that a joystick distance of 1 is worth where nothing is safe
LEVELS: Final = (0.95, 0.02)  # thresholds that may be set while driving: with the first it assists least
RECENT_TICKS: Final = 5  # for so long after it was taken away, the user's own is again as soon as it is unsafe


def within(danger: F64, rule: DangerRule, last: int = -1) -> Bool:
    """(A,) which actions are safe enough; the arguments are those of `choose`."""
    limit = np.full(len(danger), rule.threshold)
    if last >= 0:
        # Near the threshold the last action would be allowed in one tick and not in the next.
        limit[last] *= rule.hysteresis_factor
    allowed: Bool = danger < limit
    return allowed


def next_recent(before: int, unsafe: bool, danger: float, rule: DangerRule) -> int:
    """For how many ticks more the user's own action is taken away as soon as it is unsafe.

    Args:
        before: What it was a tick ago; 0 at the start.
        unsafe: Whether the user's own action is unsafe in this tick.
        danger: Of it.
        rule: See there.

    >>> rule, ticks, found = DangerRule(at_once=0.6), 0, []
    >>> for danger in (0.3, 0.0, 0.3, 0.3, 0.0):
    ...     ticks = next_recent(ticks, danger >= rule.threshold, danger, rule)
    ...     found.append(ticks)
    >>> found
    [1, 0, 1, 5, 4]
    """
    if not unsafe:
        return max(before - 1, 0)
    return RECENT_TICKS if before > 0 or danger >= rule.at_once else 1


def choose(
    danger: F64,
    stick: F64,
    actions: ActionSet,
    rule: DangerRule,
    last: int = -1,
    recent: bool = True,
) -> int:
    """The action. Where none is safe enough, it is the least dangerous.

    Args:
        danger: (A,) in 0..1.
        stick: (2,) the user's.
        actions: The joystick positions.
        rule: See there.
        last: The action before, -1 for none.
        recent: Whether the user's own was unsafe a short time ago, see `next_recent`.
    """
    distance = actions.distances(stick[None])[0]
    cost = distance + rule.danger_cost * danger / rule.threshold
    # Noise moves dangers by more than neighbours differ: without it the chair would waver between two ways round.
    if last >= 0:
        cost[last] -= rule.hysteresis
    allowed = within(danger, rule, last)
    own = int(np.argmin(distance))
    if allowed[own] or (not recent and danger[own] < rule.at_once):
        return own
    if allowed.any():
        return int(np.argmin(np.where(allowed, cost, np.inf)))
    # All are bad: safety decides, and the stick only where dangers tie, as they do at 1.
    return int(np.argmin(danger + LESS_M * distance))
