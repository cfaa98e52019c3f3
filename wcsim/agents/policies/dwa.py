"""The baseline `dwa`: a dynamic-window shared controller that sees what a chair senses, and the user's joystick.

Every joystick position of the action set is an arc within the reach of the drive. One that could not be held for 0.3 s
and then braked before it meets something that it knows of (a wall, a person, a kerb, a drop) is out; of the others the
one nearest to the user's stick wins, pushed away from what it would pass closely. Arcs begin where the commands that
are on their way will have brought the chair.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wcsim.agents.policies.baseline_names import HIGHEST_LEVEL, USUAL_LEVEL
from wcsim.agents.policies.dynamic_window.arcs import arcs, touches_after
from wcsim.agents.policies.dynamic_window.backing import backs_blindly
from wcsim.agents.policies.dynamic_window.surroundings import SENSES, StreetSense
from wcsim.agents.policy_api import JOYSTICK_KEY, Observation, require_level
from wcsim.config import RunConfig
from wcsim.supervisor.actions import ActionSet
from wcsim.types import F64, Bool, Outline

_COMFORT_COST = 0.15  # joystick distance, less than the 0.1768 that still counts as following
WARN_S = 2.0  # of what the user's stick would meet so soon
_WARN_MARGIN_M = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class Caution:
    """How early, and how widely, a driver is kept from what is in the way."""

    hold_s: float = 0.3  # each joystick position is held for so long before it is braked
    margin_m: float = 0.07  # kept all around: half a cell, and what the reckoning is off
    comfort_m: float = 0.25  # passing closer than this costs up to _COMFORT_COST


LAST_MOMENT = Caution(hold_s=0.1, margin_m=0.03, comfort_m=0.1)
EARLY = Caution(hold_s=1.0, margin_m=0.2, comfort_m=0.5)


def caution(level: float) -> Caution:
    """That of a level of assistance from 0 (LAST_MOMENT) over 1 (the usual one) to 2 (EARLY)."""
    low, high, share = (LAST_MOMENT, Caution(), level) if level < 1.0 else (Caution(), EARLY, level - 1.0)
    mixed = {key: (1.0 - share) * getattr(low, key) + share * getattr(high, key) for key in Caution.__slots__}
    return Caution(**mixed)


class DynamicWindow:
    """Chooses actions; remembers the street around it, who moves there, and how it drives.

    Args:
        name: What it is called.
        config: Of the run: its first camera is seen, and its chair driven.
        actions: The joystick positions to choose from.
        outline: The box around the chair and its user.
        level: Of assistance, see `caution`.
    """

    senses, levels = SENSES, (0.0, HIGHEST_LEVEL)

    def __init__(
        self, name: str, config: RunConfig, actions: ActionSet, outline: Outline, level: float = USUAL_LEVEL
    ) -> None:
        self.name, self.warning = name, False
        self.level, self._caution, self._actions = level, caution(level), actions
        self.unsafe: Bool = np.zeros(len(actions), np.bool_)  # (A,) out of the question at the last choice
        self._around = StreetSense(config, actions, outline)

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self._around.forget()
        self.warning = False

    def set_level(self, level: float) -> None:
        """Assist so from the next choice on; see `caution`. Raises PolicyError for a level out of bounds."""
        require_level(level, self.levels)
        self.level, self._caution = level, caution(level)

    def act(self, observation: Observation) -> int:
        """The action nearest to the user's stick that can be braked in time, with some room on its sides."""
        choice = self.choose(observation)
        self.sent(choice)
        return choice

    def sent(self, action: int) -> None:
        """Say which action is carried out."""
        self._around.command(action)

    def choose(self, observation: Observation) -> int:
        """The same as `act`, while another action may still be sent."""
        around, stick = self._around, np.asarray(observation[JOYSTICK_KEY], np.float64)
        around.observe(observation)
        points = around.in_the_way(self._caution.margin_m)
        start, later_s = around.start()
        self.warning = self._meets(stick, start, later_s, points)
        return self._choose(stick, start, later_s, points)

    def _meets(self, stick: F64, start: F64, later_s: float, points: F64) -> bool:
        """Whether the user's stick, held, would meet something soon."""
        around = self._around
        shaped, limits, box = around.shaped(stick), around.limits, around.box_B_m
        return math.isfinite(touches_after(start, later_s, shaped, limits, box, points, _WARN_MARGIN_M, WARN_S))

    def _choose(self, stick: F64, start: F64, later_s: float, points: F64) -> int:
        """The action that begins at `start` (6,), with `points` (n, 5) in the way, see `arcs`."""
        care, around = self._caution, self._around
        commands, limits, box = around.commands, around.limits, around.box_B_m
        gap_m, blind = np.empty(len(self._actions)), np.empty(len(self._actions), np.bool_)
        free = arcs(start, later_s, care.hold_s, commands, limits, box, points, gap_m)
        backs_blindly(start, care.hold_s, commands, limits, box, around.memory.cells, around.ego.pose_O, blind)
        free &= ~blind
        self.unsafe = ~free
        if not free.any():
            return self._actions.nearest((0.0, 0.0))
        cost = self._actions.distances(stick[None])[0]
        cost += _COMFORT_COST * np.clip((care.comfort_m - gap_m) / care.comfort_m, 0.0, 1.0)
        return int(np.argmin(np.where(free, cost, np.inf)))
