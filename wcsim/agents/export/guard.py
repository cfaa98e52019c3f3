"""What stands between a policy and a chair: nothing that is not sure drives it. One pure state machine.

In each tick it is told what the policy wants and whether that can be trusted: numbers that are finite on both sides, a
frame that is not old, an answer in time. Where it cannot, the command goes to zero within `stop_s`, whatever it was.
It comes back when `good_ticks` good ticks have come one after the other; till then the policy is shown the user's stick
at rest, and begins anew wherever it wants something else than was sent, so that it never believes to have sent that.
`examples/exported_policy.py` says the same in NumPy.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.agents.policy_api import JOYSTICK_KEY, NotFinite, Observation, Policy
from wcsim.config import parse
from wcsim.config.run_file import GuardFile, GuardRule
from wcsim.core.reading import FileKind, escaped, is_file, read_json
from wcsim.errors import ConfigError, PolicyError
from wcsim.supervisor.actions import ActionSet

Stick = tuple[float, float]

LONGEST: Final = math.sqrt(2.0)  # of a stick, in a corner of its square
FAULTS: Final = ("", "missing", "input", "old", "late", "output")
"""Why a tick was bad, "" for a good one: no frame, an input that is not finite, an old frame, a missed deadline, an
output that is not finite."""


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


class GuardedPolicy:
    """Drives one chair: `drive` with a real one, where frames have an age; `act` in a test, where time stands still.

    Args:
        policy: Begun anew whenever it could not be trusted.
        actions: Its joystick positions.
        rule: See there.
        clock: In seconds; what an answer takes is measured by it.
    """

    def __init__(
        self,
        policy: Policy,
        actions: ActionSet,
        rule: GuardRule | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.rule, self.state = GuardRule() if rule is None else rule, GuardState()
        self._policy, self._actions, self._clock = policy, actions, clock
        self.name, self.warning = policy.name, False

    def begin(self) -> None:
        """Nothing outlives an episode."""
        self._policy.begin()

    def reset(self) -> None:
        """Stand still."""
        self._policy.reset()
        self.state, self.warning = GuardState(), False

    def act(self, observation: Observation) -> int:
        """The action nearest to the guarded command; the same frames give the same action, however long it takes.

        Raises what the policy does: in a simulation a fault of a policy is to be seen.
        """
        return self._actions.nearest(self._step(observation, 0.0, lambda: 0.0, (NotFinite,)))

    def drive(self, frames: Observation | None, age_s: float = 0.0) -> Stick:
        """The command for the frames of a tick, x right and y ahead; None where no frames came.

        Whatever the policy raises stops the chair.
        """
        return self._step(frames, age_s, self._clock, (Exception,))

    def _step(
        self,
        frames: Observation | None,
        age_s: float,
        clock: Callable[[], float],
        outlived: tuple[type[Exception], ...],
    ) -> Stick:
        began_s, wanted, answered = clock(), None, True
        whole = frames is not None and all(np.isfinite(frame).all() for frame in frames.values())
        if frames is not None and whole and age_s <= self.rule.oldest_s:
            wanted = self._asked(frames, outlived)
            answered = wanted is not None
        self.state = guarded(
            self.rule,
            self.state,
            GuardTick(
                wanted=wanted,
                inputs_finite=whole or frames is None,
                outputs_finite=answered,
                age_s=age_s,
                took_s=clock() - began_s,
            ),
        )
        self.warning = self.warning and not self.state.fault
        if self.state.fault or self.state.stick != wanted:  # it remembers what it wanted as what was sent
            self._policy.reset()
        return self.state.stick

    def _asked(self, frames: Observation, outlived: tuple[type[Exception], ...]) -> Stick | None:
        """What the policy wants; None where it has no finite answer, or raises one of `outlived`."""
        seen: dict[str, Any] = dict(frames)
        if self.state.tripped:
            seen[JOYSTICK_KEY] = np.zeros_like(frames[JOYSTICK_KEY])
        try:
            x, y = self._actions.points[self._policy.act(seen)].tolist()
        except outlived:
            return None
        self.warning = bool(getattr(self._policy, "warning", False))
        return x, y


MEANING: Final = "meaning.json"
_KIND: Final = FileKind(what="the meaning.json of an exported policy", limit_bytes=4 << 20, error=PolicyError)


def guard_of(folder: Path) -> GuardRule | None:
    """The guard of an ONNX folder; None where it has none. Raises PolicyError when it cannot be read."""
    if not is_file(folder / MEANING):
        return None
    said = read_json(folder / MEANING, _KIND).get("guard")
    if not isinstance(said, dict):
        return None
    try:
        return parse(GuardFile, {"guard": said}, escaped(folder / MEANING)).guard
    except ConfigError as error:
        raise PolicyError(str(error)) from None
