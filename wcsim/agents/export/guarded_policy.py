"""A policy behind the guard, as it drives a chair whose frames may be missing, old or damaged."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from wcsim.agents.export.guard import GuardRule, GuardState, GuardTick, Stick, guarded
from wcsim.agents.policy_api import JOYSTICK_KEY, NotFinite, Observation, Policy
from wcsim.supervisor.actions import ActionSet


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
