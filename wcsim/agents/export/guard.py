"""What stands between an exported policy and a chair in a test: only finite numbers drive it.

After a tick with others the command falls to zero within `stop_s`. The policy drives again after
`good_ticks` good ticks in a row. Until then it sees the user's stick at rest, and is reset whenever
it chooses another stick than was sent. On a real chair frames are also late or missing:
`examples/exported_policy.py` has the whole guard, in NumPy.
"""

import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.agents.policy_api import JOYSTICK_KEY, NotFinite, Observation, Policy, Warns
from wcsim.agents.runs.policy_file import parse_saved
from wcsim.config.run_file import ExportedGuardSection, PolicyGuardSettings
from wcsim.core import reading
from wcsim.core.reading import escape, is_file, read_json
from wcsim.supervisor.actions import ActionSet

MEANING: Final = "meaning.json"
# A stick in a corner of its square is this long.
_LONGEST: Final = math.sqrt(2.0)


class GuardedPolicy:
    """Drives one chair with a policy, except in ticks that are not finite and shortly after them.

    `stick` is the command that was sent last; `tripped` means that the policy does not drive now.

    Args:
        policy: It is reset whenever something else was sent than it chose.
        actions: Its joystick positions.
        rule: How fast the chair stops, and when the policy drives again.
    """

    def __init__(self, policy: Policy, actions: ActionSet, rule: PolicyGuardSettings) -> None:
        self._policy, self._actions, self._rule = policy, actions, rule
        self.name = policy.name
        self._rest()

    def _rest(self) -> None:
        self.stick = (0.0, 0.0)
        self.tripped = False
        self._good_ticks = 0
        if isinstance(self._policy, Warns):
            self.warning = False

    def begin(self) -> None:
        """Nothing outlives an episode."""
        self._policy.begin()

    def reset(self) -> None:
        """Stand still."""
        self._policy.reset()
        self._rest()

    def act(self, observation: Observation) -> int:
        """The action nearest to the guarded command.

        Errors of the policy pass through: in a simulation they are to be seen.
        """
        rule, chosen = self._rule, self._finite_choice(observation)
        self._good_ticks = 0 if chosen is None else self._good_ticks + 1
        self.tripped = chosen is None or (self.tripped and self._good_ticks < rule.good_ticks)
        if isinstance(self._policy, Warns):
            self.warning = chosen is not None and self._policy.warning
        if chosen and not self.tripped:
            self.stick = chosen
        else:
            step = _LONGEST * rule.tick_s / rule.stop_s
            share = max(0.0, 1.0 - step / max(math.hypot(*self.stick), 1e-9))
            self.stick = (self.stick[0] * share, self.stick[1] * share)
        if self.stick != chosen:
            # A policy remembers its choice as what was sent, which it was not.
            self._policy.reset()
        return self._actions.nearest(self.stick)

    def _finite_choice(self, frames: Observation) -> tuple[float, float] | None:
        """The policy's stick; None where its input or output is not finite."""
        if not all(np.isfinite(frame).all() for frame in frames.values()):
            return None
        seen: dict[str, Any] = dict(frames)
        if self.tripped:
            seen[JOYSTICK_KEY] = np.zeros_like(frames[JOYSTICK_KEY])
        try:
            x, y = self._actions.points[self._policy.act(seen)].tolist()
        except NotFinite:
            return None
        return x, y


def read_guard_rule(folder: Path) -> PolicyGuardSettings | None:
    """The guard of an ONNX folder; None where it has none. Raises PolicyError for a faulty one."""
    path = folder / MEANING
    if not is_file(path):
        return None
    guard = read_json(path, reading.MEANING).get("guard")
    if not isinstance(guard, dict):
        return None
    return parse_saved(ExportedGuardSection, {"guard": guard}, escape(path)).guard
