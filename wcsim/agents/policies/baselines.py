"""Policies that learn nothing, to compare networks with: follow, random, zero, stop, dwa, and oracles above all."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wcsim.agents.perception.alarm import TWO_TICKS, Alarm, next_alarm
from wcsim.agents.perception.depth_check import CorridorWatch
from wcsim.agents.policies.dwa import DynamicWindow
from wcsim.agents.policy_api import (
    BASELINES,
    JOYSTICK_KEY,
    LEVELLED,
    UPPER_BOUND,
    UPPER_BOUNDS,
    VISIBLE_BOUND,
    Observation,
    Policy,
    level_of,
)
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.errors import PolicyError
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.types import F64, Truth, Verdict

WARNS_AHEAD_S = 1.0  # `stop`, of what it would stop for so much later


class _Memoryless:
    """What a policy does at a start of which it remembers nothing."""

    __slots__ = ()

    def begin(self) -> None:
        """Nothing is remembered."""

    def reset(self) -> None:
        """Nothing is remembered."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Follow(_Memoryless):
    """The action nearest to the user's joystick."""

    actions: ActionSet
    name: str = "follow"

    def act(self, observation: Observation) -> int:
        """The user's wish."""
        return self.actions.nearest(observation[JOYSTICK_KEY])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Zero(_Memoryless):
    """The stick at rest: the longest life and the worst obedience."""

    actions: ActionSet
    name: str = "zero"

    def act(self, observation: Observation) -> int:
        """Always the middle."""
        del observation
        return self.actions.nearest((0.0, 0.0))


@dataclass(slots=True, kw_only=True)
class _Random(_Memoryless):
    """Any action, drawn from a generator of its own, which goes on from episode to episode."""

    actions: ActionSet
    seed: int
    name: str = "random"
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """The same draws in every test."""
        self.rng = seeding.generator(self.seed, "agent", "random")

    def act(self, observation: Observation) -> int:
        """A uniformly drawn action."""
        del observation
        return int(self.rng.integers(0, len(self.actions)))


@dataclass(slots=True, kw_only=True)
class _StopBeforeObstacles(_Memoryless):
    """Follows, but gives no throttle while the depth image shows something in the way within the stopping distance.

    It may still turn on the spot, so a user who steers past the obstacle gets going again. The camera looks forward:
    backwards it follows blindly. It warns, as `next_alarm` has it, of what it would stop for in a second.
    """

    actions: ActionSet
    watch: CorridorWatch
    name: str = "stop"
    _alarm: Alarm = field(init=False, default=Alarm())

    @property
    def warning(self) -> bool:
        """Whether it would soon stop."""
        return self._alarm.on

    def reset(self) -> None:
        """No warning outlasts an episode."""
        self._alarm = Alarm()

    def act(self, observation: Observation) -> int:
        """The user's wish, without its forward part when the way is blocked."""
        x, y = (float(value) for value in observation[JOYSTICK_KEY])
        stops = y > 0.0 and self.watch.blocked(observation, x, y, WARNS_AHEAD_S)
        self._alarm = next_alarm(self._alarm, float(stops), TWO_TICKS)
        if y > 0.0 and self.watch.blocked(observation, x, y):
            return self.actions.nearest((x, 0.0))
        return self.actions.nearest((x, y))


@dataclass(slots=True, kw_only=True)
class _OracleDriver(_Memoryless):
    """The safe action nearest to the user's joystick, by the true geometry; the one that fails latest when none is.

    With the name `oracle-visible` it knows only those of the others whom the chair's cameras have shown lately.
    """

    actions: ActionSet
    name: str = UPPER_BOUND
    _first_s: F64 | None = field(init=False, default=None)

    def see(self, truth: Truth | None) -> None:
        """Take the truth of the moment to act in. Raises PolicyError without one."""
        visible = self.name == VISIBLE_BOUND
        said: Verdict | None = truth.visible if visible and truth is not None else truth
        if said is None:
            key = "env.truth_visible" if visible else "env.truth"
            raise PolicyError(f"{self.name} got no truth from its environment; expected {key} = true: set it")
        self._first_s = said.first_s

    def act(self, observation: Observation) -> int:
        """The user's wish as far as it ends well."""
        if self._first_s is None:
            raise PolicyError("the oracle was asked to act before it saw the truth; expected see() before each act()")
        first_s, self._first_s = self._first_s, None  # the truth of one moment says nothing of the next
        latest = first_s == first_s.max()  # infinity, where any ends well
        distances = self.actions.distances(np.asarray(observation[JOYSTICK_KEY])[None])[0]
        if np.isfinite(first_s).all():  # of those that fail together the gentlest
            distances = np.hypot(self.actions.points[:, 0], self.actions.points[:, 1])
        return int(np.argmin(np.where(latest, distances, np.inf)))


def baseline(name: str, config: RunConfig, seed: int = 0) -> Policy:
    """The baseline of that name for a run's action set, camera and chair. Raises PolicyError for an unknown name."""
    actions = action_set(config.env.actions)
    if name == "follow":
        return Follow(actions=actions)
    if name == "random":
        return _Random(actions=actions, seed=seed)
    if name == "zero":
        return _Zero(actions=actions)
    if name == "stop":
        outline = plant_spec(config.chair).outline
        return _StopBeforeObstacles(actions=actions, watch=CorridorWatch(config.cameras[0], config.chair, outline))
    if name.partition("@")[0] == LEVELLED:
        return DynamicWindow(name, config, actions, plant_spec(config.chair).outline, level_of(name))
    if name in UPPER_BOUNDS:
        return _OracleDriver(actions=actions, name=name)
    raise PolicyError(f"unknown baseline {name!r}; expected one of: {', '.join((*BASELINES, *UPPER_BOUNDS))}")
