"""What stands between a policy and a chair: nothing that is not sure drives it. One pure state machine.

In each tick it is told what the policy wants and whether that can be trusted: numbers that are finite on both sides, a
frame that is not old, an answer in time. Where it cannot, the command goes to zero within `stop_s`, whatever it was.
It comes back when `good_ticks` good ticks have come one after the other; till then the policy is shown the user's stick
at rest, and begins anew wherever it wants something else than was sent, so that it never believes to have sent that.
`examples/exported_policy.py` says the same in NumPy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

Stick = tuple[float, float]

LONGEST: Final = math.sqrt(2.0)  # of a stick, in a corner of its square
FAULTS: Final = ("", "missing", "input", "old", "late", "output")
"""Why a tick was bad, "" for a good one: no frame, an input that is not finite, an old frame, a missed deadline, an
output that is not finite."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardRule:
    """What can be trusted, and what happens when it cannot."""

    oldest_s: float = 0.3  # a frame that was taken earlier is too old
    deadline_s: float = 0.1  # from a frame's arrival to the answer
    tick_s: float = 0.1
    stop_s: float = 0.5  # within so long the command is zero
    good_ticks: int = 10  # one after the other, until the policy drives again


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardTick:
    """What came of a tick."""

    wanted: Stick | None  # the policy's command; None where no frame came, or the policy was not asked
    inputs_finite: bool = True
    outputs_finite: bool = True
    age_s: float = 0.0  # of the frame
    took_s: float = 0.0  # until the answer was there


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardState:
    """What is remembered from tick to tick."""

    stick: Stick = (0.0, 0.0)  # the command of the last tick
    good: int = 0  # good ticks since the last bad one
    tripped: bool = False
    fault: str = ""  # of the last tick


def _fault_of(rule: GuardRule, tick: GuardTick) -> str:
    """Why a tick is bad, "" when it is good."""
    if not tick.inputs_finite:
        return "input"
    if not tick.age_s <= rule.oldest_s:  # so is an age that is NaN
        return "old"
    if not tick.took_s <= rule.deadline_s:
        return "late"
    if not tick.outputs_finite:
        return "output"
    return "" if tick.wanted is not None and all(map(math.isfinite, tick.wanted)) else "missing"


def guarded(rule: GuardRule, state: GuardState, tick: GuardTick) -> GuardState:
    """The state after a tick; its `stick` is the command to send.

    >>> rule, state = GuardRule(stop_s=0.2, good_ticks=2), GuardState()
    >>> driven = []
    >>> for age_s in (0.0, 0.4, 0.0, 0.0, 0.0):
    ...     state = guarded(rule, state, GuardTick(wanted=(0.0, 1.0), age_s=age_s))
    ...     driven.append(round(state.stick[1], 2))
    >>> driven
    [1.0, 0.29, 0.0, 1.0, 1.0]
    """
    fault = _fault_of(rule, tick)
    good = 0 if fault else state.good + 1
    tripped = bool(fault) or (state.tripped and good < rule.good_ticks)
    if tripped or tick.wanted is None:
        return GuardState(stick=_ramped(rule, state.stick), good=good, tripped=True, fault=fault)
    return GuardState(stick=tick.wanted, good=good)


def _ramped(rule: GuardRule, stick: Stick) -> Stick:
    """A command one tick nearer to zero."""
    length = math.hypot(*stick)
    share = max(0.0, 1.0 - LONGEST * rule.tick_s / rule.stop_s / max(length, 1e-9))
    return stick[0] * share, stick[1] * share
