"""The baseline `dwa`: a dynamic-window shared controller that sees what a chair senses, and the user's joystick.

Every joystick position of the action set is an arc within the reach of the drive. One that could not be held for 0.3 s
and then braked before it meets something that it knows of (a wall, a person, a kerb, a drop) is out; of the others the
one nearest to the user's stick wins, pushed away from what it would pass closely. Arcs begin where the commands that
are on their way will have brought the chair.
"""

from __future__ import annotations

import math

import numpy as np

from wcsim.agents.policies.alarm import TWO_TICKS, Alarm, next_alarm
from wcsim.agents.policies.dynamic_window.arcs import touches_after
from wcsim.agents.policies.dynamic_window.braking import brakes_in_time, caution
from wcsim.agents.policies.dynamic_window.surroundings import StreetSense
from wcsim.agents.policy_api import (
    HIGHEST_LEVEL,
    JOYSTICK_KEY,
    MOTION_SENSES,
    USUAL_LEVEL,
    HearsSent,
    Observation,
    require_level,
)
from wcsim.config import RunConfig
from wcsim.supervisor.actions import ActionSet
from wcsim.types import F64, Bool, Outline

_COMFORT_COST = 0.15  # joystick distance, less than the 0.1768 that still counts as following
WARN_S = 2.0  # of what the user's stick would meet so soon
_WARN_MARGIN_M = 0.03


class DynamicWindow(HearsSent):
    """Chooses the actions nearest to the user's stick that can be braked in time, with some room on their sides.

    It remembers the street around it, who moves there, and how it drives.

    Args:
        name: What it is called.
        config: Of the run: its first camera is seen, and its chair driven.
        actions: The joystick positions to choose from.
        outline: The box around the chair and its user.
        level: Of assistance, see `caution`.
    """

    senses, levels = MOTION_SENSES, (0.0, HIGHEST_LEVEL)

    def __init__(
        self, name: str, config: RunConfig, actions: ActionSet, outline: Outline, level: float = USUAL_LEVEL
    ) -> None:
        self.name, self._alarm = name, Alarm()
        self.level, self._caution, self._actions = level, caution(level), actions
        self.unsafe: Bool = np.zeros(len(actions), np.bool_)  # (A,) out of the question at the last choice
        self._around = StreetSense(config, actions, outline)

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self._around.forget()
        self._alarm = Alarm()

    @property
    def warning(self) -> bool:
        """Whether the user's own stick is about to meet something, see `next_alarm`."""
        return self._alarm.on

    def set_level(self, level: float) -> None:
        """Assist so from the next choice on; see `caution`. Raises PolicyError for a level out of bounds."""
        require_level(level, self.levels)
        self.level, self._caution = level, caution(level)

    def sent(self, action: int) -> None:
        """Say which action is carried out."""
        self._around.command(action)

    def choose(self, observation: Observation) -> int:
        """The action, while another one may still be sent."""
        around, stick = self._around, np.asarray(observation[JOYSTICK_KEY], np.float64)
        around.observe(observation)
        points = around.in_the_way(self._caution.margin_m)
        start, later_s = around.start()
        self._alarm = next_alarm(self._alarm, float(self._meets(stick, start, later_s, points)), TWO_TICKS)
        return self._choose(stick, start, later_s, points)

    def _meets(self, stick: F64, start: F64, later_s: float, points: F64) -> bool:
        """Whether the user's stick, held, would meet something soon."""
        around = self._around
        shaped, limits, box = around.shaped(stick), around.limits, around.box_B_m
        return math.isfinite(touches_after(start, later_s, shaped, limits, box, points, _WARN_MARGIN_M, WARN_S))

    def _choose(self, stick: F64, start: F64, later_s: float, points: F64) -> int:
        """The action that begins at `start` (6,), with `points` (n, 5) in the way, see `arcs`."""
        care = self._caution
        free, gap_m = brakes_in_time(self._around, care, start, later_s, points)
        self.unsafe = ~free
        if not free.any():
            return self._actions.nearest((0.0, 0.0))
        cost = self._actions.distances(stick[None])[0]
        cost += _COMFORT_COST * np.clip((care.comfort_m - gap_m) / care.comfort_m, 0.0, 1.0)
        return int(np.argmin(np.where(free, cost, np.inf)))
