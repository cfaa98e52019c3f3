"""What stands between an exported policy and a chair in a test: numbers that are not finite do not drive it.

After such a tick the command goes to zero within `stop_s`, whatever it was. It comes back when `good_ticks` good ticks
have come one after the other; till then the policy is shown the user's stick at rest, and begins anew wherever it wants
something else than was sent, so that it never believes to have sent that. On a real chair frames are late or missing,
too: `examples/exported_policy.py` has the whole guard, in NumPy.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.agents.policy_api import JOYSTICK_KEY, NotFinite, Observation, Policy
from wcsim.config import parse
from wcsim.config.run_file import GuardFile, GuardRule
from wcsim.core import reading
from wcsim.core.reading import escaped, is_file, read_json
from wcsim.errors import ConfigError, PolicyError
from wcsim.supervisor.actions import ActionSet

_LONGEST: Final = math.sqrt(2.0)  # of a stick, in a corner of its square
MEANING: Final = "meaning.json"


class GuardedPolicy:
    """Drives one chair; `stick` is the command that was sent last, `tripped` whether the policy does not drive now.

    Args:
        policy: Begun anew whenever it could not be trusted.
        actions: Its joystick positions.
        rule: See there.
    """

    def __init__(self, policy: Policy, actions: ActionSet, rule: GuardRule) -> None:
        self._policy, self._actions, self._rule = policy, actions, rule
        self.name = policy.name
        self._rest()

    def _rest(self) -> None:
        self.stick, self.tripped, self.warning = (0.0, 0.0), False, False
        self._good = 0  # good ticks since the last bad one

    def begin(self) -> None:
        """Nothing outlives an episode."""
        self._policy.begin()

    def reset(self) -> None:
        """Stand still."""
        self._policy.reset()
        self._rest()

    def act(self, observation: Observation) -> int:
        """The action nearest to the guarded command.

        Raises what the policy does: in a simulation a fault of a policy is to be seen.
        """
        wanted, rule = self._asked(observation), self._rule
        self._good = 0 if wanted is None else self._good + 1
        self.tripped = wanted is None or (self.tripped and self._good < rule.good_ticks)
        self.warning = self.warning and wanted is not None
        share = max(
            0.0, 1.0 - _LONGEST * rule.tick_s / rule.stop_s / max(math.hypot(*self.stick), 1e-9)
        )
        self.stick = (
            wanted
            if wanted and not self.tripped
            else (self.stick[0] * share, self.stick[1] * share)
        )
        if self.stick != wanted:  # it remembers what it wanted as what was sent
            self._policy.reset()
        return self._actions.nearest(self.stick)

    def _asked(self, frames: Observation) -> tuple[float, float] | None:
        """What the policy wants; None where a number on either side is not finite."""
        if not all(np.isfinite(frame).all() for frame in frames.values()):
            return None
        seen: dict[str, Any] = dict(frames)
        if self.tripped:
            seen[JOYSTICK_KEY] = np.zeros_like(frames[JOYSTICK_KEY])
        try:
            x, y = self._actions.points[self._policy.act(seen)].tolist()
        except NotFinite:
            return None
        self.warning = bool(getattr(self._policy, "warning", False))
        return x, y


def guard_of(folder: Path) -> GuardRule | None:
    """The guard of an ONNX folder; None where it has none. Raises PolicyError when it cannot be read."""
    if not is_file(folder / MEANING):
        return None
    said = read_json(folder / MEANING, reading.MEANING).get("guard")
    if not isinstance(said, dict):
        return None
    try:
        return parse(GuardFile, {"guard": said}, escaped(folder / MEANING)).guard
    except ConfigError as error:
        raise PolicyError(str(error)) from None
