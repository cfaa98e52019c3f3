"""Whether a crash could still have been survived, and until when.

Before the crash the true world is copied every 0.3 s, and in each copy five sticks are tried. It shows that the crash
was avoidable, not that the senses of a policy could know it.
"""

from typing import Final

from wcsim.agents.envs.episode_view import EnvStepResult
from wcsim.agents.evaluation.suite.alarms import crash_tick
from wcsim.agents.policy_api import Policy
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import Driver
from wcsim.types import Joystick

EVERY_S: Final = 0.3
SINCE_S: Final = 3.0  # before the crash
ON_S: Final = 3.0  # after it: so long no crash may follow
# Let go, half aside to either side, back, half ahead.
STICKS: Final = (
    Joystick(0.0, 0.0),
    Joystick(0.5, 0.0),
    Joystick(-0.5, 0.0),
    Joystick(0.0, -0.5),
    Joystick(0.0, 0.5),
)


class Survival:
    """Looks on while an episode is driven once more up to its crash.

    Args:
        crash_steps: The step of each seat's crash, counted from the start of its episode.
        tick_s: Length of a step.
    """

    def __init__(self, crash_steps: dict[int, int], tick_s: float) -> None:
        self.last_moment_s: dict[int, float | None] = dict.fromkeys(crash_steps)
        self._crash_steps, self._tick_s = crash_steps, tick_s
        self._steps = dict.fromkeys(crash_steps, 0)

    @property
    def seats(self) -> frozenset[int]:
        """Those that are looked at."""
        return frozenset(self._crash_steps)

    def see(self, seat: int, _step: EnvStepResult, world: World, _policy: Policy) -> None:
        """Try to survive from here, where it is time for that."""
        if seat not in self._crash_steps:
            return
        self._steps[seat] += 1
        left = self._crash_steps[seat] - self._steps[seat]
        every, since, on = (round(each_s / self._tick_s) for each_s in (EVERY_S, SINCE_S, ON_S))
        if not 0 < left <= since or left % every:
            return
        for stick in STICKS:
            if crash_tick(world, seat, _holding(stick), left + on) is None:
                self.last_moment_s[seat] = round(left * self._tick_s, 6)
                return

    def ended(self, seat: int, world: World) -> None:
        """Nothing is left to do."""


def _holding(stick: Joystick) -> Driver:
    return lambda _: stick
