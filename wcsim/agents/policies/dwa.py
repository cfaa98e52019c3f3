"""The baseline `dwa`, a dynamic-window controller, and `veto:POLICY`, its watch over a policy.

Every joystick position of the action set is an arc within the reach of the drive. One is out that
could not be held for 0.3 s and then braked before it meets something known (a wall, a person, a
kerb, a drop). Of the others the one nearest to the user's stick wins, pushed away from what it
would pass closely. Arcs begin where the commands that are on their way will have brought the chair.
It backs up over ground that it has seen or stood on, and hardly farther: without a rear camera it
does not look backwards.

The wrapper forbids what it could not brake in time. Networks and `dwa` miss different crashes, so
together they crash less, and intervene more often.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from wcsim.agents.perception.alarm import TWO_TICKS, AlarmState, next_alarm_state
from wcsim.agents.perception.arcs import (
    LONGEST_S,
    STEP_S,
    find_collision_free_commands,
    integrate_chair_state,
    time_to_contact_s,
)
from wcsim.agents.perception.street_memory import is_known_place
from wcsim.agents.perception.surroundings import StreetPerception
from wcsim.agents.policy_api import (
    HIGHEST_LEVEL,
    JOYSTICK_KEY,
    MOTION_SENSES,
    STATE_SENSE,
    USUAL_LEVEL,
    HearsDelay,
    HearsSent,
    Observation,
    Policy,
    SeesTruth,
    TellsUnsafe,
    Warns,
    require_level,
    senses_of,
)
from wcsim.config import RunConfig
from wcsim.core.jit import compile_exact_kernel
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import action_set
from wcsim.types import F64, I64, Bool

ROOM_S: Final = 0.5  # more, for which a faster command than the last one must be free
WARN_S: Final = 2.0  # before the user's stick would meet something
# A joystick distance, less than the 0.1768 that still counts as following.
_COMFORT_COST: Final = 0.15
_WARN_MARGIN_M: Final = 0.03


@compile_exact_kernel
def _backs_blindly(
    start: F64,
    hold_s: float,
    commands: F64,
    limits: F64,
    box: F64,
    cells: I64,
    pose_O: F64,
    blind: Bool,
) -> None:
    """Write to `blind` (K,) which commands bring the chair's rear, backwards, onto unknown ground.

    Args:
        start: (6,) see `find_collision_free_commands`.
        hold_s: For how long each command is held, before the chair brakes.
        commands: (K, 2) joystick positions as the drive takes them.
        limits: (8,) of the drive.
        box: (3,) rear, front, half the width of the chair in B.
        cells: Of `StreetMemoryGrid`.
        pose_O: (3,) of the chair now.
        blind: Written.
    """
    rest, now = np.zeros(2), np.empty(6)
    for k in range(len(commands)):
        blind[k] = False
        if commands[k, 1] >= 0.0:
            continue
        now[:] = start
        for i in range(int(LONGEST_S / STEP_S)):
            held = i * STEP_S < hold_s - 1e-9
            if not held and now[3] == 0.0:
                break
            integrate_chair_state(now, commands[k] if held else rest, limits, STEP_S)
            if now[3] < 0.0 and not _rear_is_known(now, box, cells, pose_O):
                blind[k] = True
                break


@compile_exact_kernel
def _rear_is_known(now: F64, box: F64, cells: I64, pose: F64) -> bool:
    cos, sin = math.cos(now[2]), math.sin(now[2])
    for side in (-1.0, 0.0, 1.0):
        x = now[0] + cos * box[0] - sin * side * box[2]
        y = now[1] + sin * box[0] + cos * side * box[2]
        turned_x = pose[0] + math.cos(pose[2]) * x - math.sin(pose[2]) * y
        if not is_known_place(
            cells, turned_x, pose[1] + math.sin(pose[2]) * x + math.cos(pose[2]) * y
        ):
            return False
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class _Caution:
    """How early, and how widely, a driver is held back from what is in the way."""

    hold_s: float = 0.3  # each joystick position is held for so long before it is braked
    margin_m: float = 0.07  # all around: half a cell, and the error of the prediction
    comfort_m: float = 0.25  # passing closer than this costs up to _COMFORT_COST


_LAST_MOMENT = _Caution(hold_s=0.1, margin_m=0.03, comfort_m=0.1)
_EARLY = _Caution(hold_s=1.0, margin_m=0.2, comfort_m=0.5)


def _caution(level: float) -> _Caution:
    """The caution of a level of assistance: 0 (_LAST_MOMENT), 1 (the usual), 2 (_EARLY)."""
    low, high, share = _Caution(), _EARLY, level - 1.0
    if level < 1.0:
        low, high, share = _LAST_MOMENT, _Caution(), level
    mixed = {
        key: (1.0 - share) * getattr(low, key) + share * getattr(high, key)
        for key in _Caution.__slots__
    }
    return _Caution(**mixed)


def _brakes_in_time(
    around: StreetPerception, care: _Caution, start: F64, later_s: float, points: F64
) -> tuple[Bool, F64]:
    """Of each action, whether it can be braked in time, over known ground; and how near it passes.

    Args:
        around: The street, as of the newest observation.
        care: How early, and how widely.
        start: (6,) the state in which an action begins, see `StreetPerception.start`.
        later_s: When that is.
        points: (n, 5) what is in the way, `StreetPerception.in_the_way` of the margin of `care`.

    Returns:
        (A,) whether it can, and (A,) the gap in metres.
    """
    commands, limits, box = around.commands, around.limits, around.box_B_m
    gap_m = np.empty(len(commands))
    blind = np.empty(len(commands), np.bool_)
    free: Bool = find_collision_free_commands(
        start, later_s, care.hold_s, commands, limits, box, points, gap_m
    )
    _backs_blindly(
        start, care.hold_s, commands, limits, box, around.memory.cells, around.ego.pose_O, blind
    )
    return free & ~blind, gap_m


class DynamicWindowPolicy(HearsSent):
    """Chooses the action nearest to the user's stick that can be braked in time, with some room.

    It remembers the street around it, the road users there, and its own motion.

    Attributes:
        unsafe: (A,) the actions that were excluded at the last choice.

    Args:
        name: In tables.
        config: Of the run, with the cameras of `env.camera`, and the chair.
        level: Of assistance, see `_caution`.
    """

    senses = MOTION_SENSES
    levels = (0.0, HIGHEST_LEVEL)

    def __init__(self, name: str, config: RunConfig, level: float = USUAL_LEVEL) -> None:
        self.name = name
        self.level = level
        self._caution = _caution(level)
        self._actions = action_set(config.env.actions)
        self._alarm = AlarmState()
        self.unsafe: Bool = np.zeros(len(self._actions), np.bool_)
        self.around = StreetPerception(config)
        self._rest = self._actions.nearest((0.0, 0.0))
        self._last = self._rest  # the action that was sent last
        self._last_user = self._rest  # the action nearest to the user's stick then

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self.around.forget()
        self._alarm = AlarmState()
        self._last = self._last_user = self._rest

    @property
    def warning(self) -> bool:
        """Whether the user's own stick is about to meet something, see `next_alarm_state`."""
        return self._alarm.on

    def set_level(self, level: float) -> None:
        """Set the level from the next choice on. Raises PolicyError for one out of bounds."""
        require_level(level, self.levels)
        self.level = level
        self._caution = _caution(level)

    def sent(self, action: int) -> None:
        """Take the action that is executed."""
        self.around.command(action)
        self._last = action

    def choose(self, observation: Observation) -> int:
        """The action, while another one may still be sent."""
        # 1. Observe, and predict the state `start` (6,) in which an action begins.
        around = self.around
        around.observe(observation)
        care = self._caution
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        points = around.in_the_way(care.margin_m)
        start, later_s = around.start()
        # 2. Warn where the user's stick, held, would meet something soon.
        meets_s = time_to_contact_s(
            start,
            later_s,
            around.shaped(stick),
            around.limits,
            around.box_B_m,
            points,
            _WARN_MARGIN_M,
            WARN_S,
        )
        self._alarm = next_alarm_state(self._alarm, float(math.isfinite(meets_s)), TWO_TICKS)
        # 3. Exclude what could not be braked in time.
        free, gap_m = _brakes_in_time(around, care, start, later_s, points)
        self.unsafe = ~free
        out = np.hypot(self._actions.points[:, 0], self._actions.points[:, 1])
        overruled = self._last != self._last_user
        self._last_user = self._actions.nearest(stick)
        if overruled and out[self._last_user] > out[self._last]:
            # An overruled stick is obeyed again when there is room: else the chair would speed up
            # to brake again.
            longer = replace(care, hold_s=care.hold_s + ROOM_S)
            roomy, _ = _brakes_in_time(around, longer, start, later_s, points)
            free &= roomy | (out <= out[self._last])
        if not free.any():
            return self._rest
        # 4. Choose the nearest to the stick; passing closely costs.
        cost = self._actions.distances(stick[None])[0]
        cost += _COMFORT_COST * np.clip((care.comfort_m - gap_m) / care.comfort_m, 0.0, 1.0)
        return int(np.argmin(np.where(free, cost, np.inf)))


class VetoPolicy(HearsSent):
    """Drives one chair: its action is the policy's, or the nearest one to it that is not forbidden.

    Its level of assistance is that of `dwa`: how early, and how widely, it forbids.

    Attributes:
        unsafe: (A,) the actions that either of both excluded at the last choice.

    Args:
        name: In tables.
        inner: The policy that is watched.
        config: Of the run, with the cameras of `env.camera`, and the chair.
    """

    def __init__(self, name: str, inner: Policy, config: RunConfig) -> None:
        """Raises PolicyError for a policy that sees the truth: it is a bound already."""
        if isinstance(inner, SeesTruth) or STATE_SENSE in senses_of(inner):
            raise PolicyError(
                f"policy {name!r}: {inner.name} sees the truth; expected one that sees pictures"
            )
        self.name = name
        self.inner = inner
        self._actions = action_set(config.env.actions)
        self._dwa = DynamicWindowPolicy("dwa", config)
        self.senses = tuple(dict.fromkeys((*MOTION_SENSES, *senses_of(inner))))
        self.levels = self._dwa.levels
        self.unsafe: Bool = np.zeros(len(self._actions), np.bool_)

    @property
    def warning(self) -> bool:
        """Whether the policy warns; for one that cannot, whether `dwa` does."""
        return self.inner.warning if isinstance(self.inner, Warns) else self._dwa.warning

    @property
    def level(self) -> float:
        """That of `dwa`."""
        return self._dwa.level

    def set_level(self, level: float) -> None:
        """Set the level from the next choice on. Raises PolicyError for a level out of bounds."""
        self._dwa.set_level(level)

    def set_delay(self, ticks: int) -> None:
        """Pass the delay on to a policy that takes it."""
        if isinstance(self.inner, HearsDelay):
            self.inner.set_delay(ticks)

    def begin(self) -> None:
        """Begin both anew."""
        self.inner.begin()
        self._dwa.begin()

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self.inner.reset()
        self._dwa.reset()

    def close(self) -> None:
        """Close the policy, if it has something to close."""
        if hasattr(self.inner, "close"):
            self.inner.close()

    def choose(self, observation: Observation) -> int:
        """The action, while another one may still be sent."""
        inner = self.inner
        chooses = inner.choose if isinstance(inner, HearsSent) else inner.act
        chosen = int(chooses(observation))
        self._dwa.choose(observation)
        forbidden = self._dwa.unsafe
        doubted = inner.unsafe if isinstance(inner, TellsUnsafe) else np.zeros_like(forbidden)
        self.unsafe = forbidden | doubted
        # With every action forbidden `dwa` knows no better than the policy.
        if not forbidden[chosen] or forbidden.all():
            return chosen
        allowed = ~forbidden if self.unsafe.all() else ~self.unsafe
        distance = self._actions.distances(self._actions.points[chosen][None])[0]
        return int(np.argmin(np.where(allowed, distance, np.inf)))

    def sent(self, action: int) -> None:
        """Take the action that is executed."""
        if isinstance(self.inner, HearsSent):
            self.inner.sent(action)
        self._dwa.sent(action)
