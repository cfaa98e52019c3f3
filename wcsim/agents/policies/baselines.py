"""Policies that learn nothing, to compare networks with: follow, random, zero, stop, dwa, and oracles above all."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from wcsim.agents.perception.alarm import TWO_TICKS, Alarm, next_alarm
from wcsim.agents.perception.depth_image import depth_metres, viewing_rays
from wcsim.agents.policies.dwa import DynamicWindow
from wcsim.agents.policy_api import (
    BASELINES,
    DEPTH_KEY,
    IMU_KEY,
    JOYSTICK_KEY,
    LEVELLED,
    UPPER_BOUND,
    UPPER_BOUNDS,
    VISIBLE_BOUND,
    Observation,
    Policy,
    level_of,
)
from wcsim.config import CameraConfig, ChairConfig, RunConfig
from wcsim.core import seeding
from wcsim.errors import PolicyError
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.types import F64, Bool, Outline, Truth, Verdict

MARGIN_M = 0.19  # on each side
CLEAR_M = 0.3  # to keep in front when standing
_REACTION_S = 0.4  # one tick of delay, the drive's ramp
STEP_M = (
    0.15  # higher than this is in the way, deeper than this is a drop: twice what the casters climb
)
HEAD_M = 1.6  # what hangs higher passes above
_SLOPE_PER_M = 0.03  # uneven ground and depth steps grow with the distance
_PIXEL_SHARE = 4e-4  # of the image, and at least _MIN_PIXELS: less is noise
_MIN_PIXELS = 2
_STRAIGHT_RADPS = 0.05
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


class _CorridorWatch:
    """Looks along the swept corridor of a joystick position. Keeps the viewing rays of one camera."""

    def __init__(self, camera: CameraConfig, chair: ChairConfig, outline: Outline) -> None:
        self._rays = viewing_rays(camera)
        self._eye_B_m = np.array(camera.p_BC_m, dtype=np.float64)  # (3,)
        self._range_m, self._chair, self._outline = camera.range_m, chair, outline
        self._few = max(_MIN_PIXELS, round(_PIXEL_SHARE * len(self._rays)))

    def blocked(self, observation: Observation, x: float, y: float, ahead_s: float = 0.0) -> bool:
        """Whether a joystick at (x right, y > 0 forward) would run into something before the chair could stand.

        With `ahead_s` before it could when it begins to brake so much later.
        """
        depth_m = depth_metres(observation[DEPTH_KEY], self._range_m).reshape(-1).astype(np.float64)
        points = self._eye_B_m + self._rays * depth_m[:, None]  # (H * W, 3) in B
        roll, pitch = (
            math.pi * float(observation[IMU_KEY][3]),
            0.5 * math.pi * float(observation[IMU_KEY][4]),
        )
        speed, turn = y * self._chair.v_max_mps, -x * self._chair.yaw_rate_max_radps
        stop_m = speed * (_REACTION_S + ahead_s) + speed * speed / (2.0 * self._chair.decel_mps2)
        reach_m = stop_m + self._outline.front_x_m + CLEAR_M
        seen = (depth_m > 0.0) & (depth_m < 0.99 * self._range_m)  # 0: nothing was measured
        low, high = _heights(points, roll, pitch)
        solid = seen & (low > _limit_m(points)) & (high < HEAD_M)
        if self._enough(solid & _in_corridor(points, speed, turn, reach_m, self._outline)):
            return True
        # Rays that would meet level ground within the corridor, but go on below it.
        down = self._rays[:, 2] < -1e-3
        fall = np.where(down, -self._eye_B_m[2] / np.where(down, self._rays[:, 2], -1.0), 0.0)
        ground = self._eye_B_m + self._rays * fall[:, None]
        deep = down & (high < -_limit_m(ground))
        return self._enough(deep & _in_corridor(ground, speed, turn, reach_m, self._outline))

    def _enough(self, pixels: Bool) -> bool:
        return int(np.count_nonzero(pixels)) >= self._few


def _limit_m(points_B_m: F64) -> F64:
    """(K,) how high or deep something must be at these places to be in the way, or a drop."""
    return np.asarray(
        STEP_M + _SLOPE_PER_M * np.hypot(points_B_m[:, 0], points_B_m[:, 1]), np.float64
    )


def _heights(points_B_m: F64, roll_rad: float, pitch_rad: float) -> tuple[F64, F64]:
    """Smaller and larger of two heights of each point: above the chair's own plane, and above a level plane below it.

    On a ramp the first is right, just before or after it the second; something counts only when both agree.
    """
    own = points_B_m[:, 2]
    level = (
        math.sin(pitch_rad) * points_B_m[:, 0]
        + math.cos(pitch_rad) * math.sin(roll_rad) * points_B_m[:, 1]
        + math.cos(pitch_rad) * math.cos(roll_rad) * points_B_m[:, 2]
    )
    return np.minimum(own, level), np.maximum(own, level)


def _in_corridor(
    points_B_m: F64, speed_mps: float, turn_radps: float, reach_m: float, outline: Outline
) -> Bool:
    """Points over which the chair passes on the arc of (speed, turn), up to `reach_m` ahead of its axle; (K,) bool."""
    x, y = points_B_m[:, 0], points_B_m[:, 1]
    half = 0.5 * outline.width_m + MARGIN_M
    if abs(turn_radps) < _STRAIGHT_RADPS:
        return np.asarray((np.abs(y) < half) & (x > 0.0) & (x < reach_m), dtype=np.bool_)
    radius = speed_mps / turn_radps  # centre of the arc at (0, radius), left positive
    aside = np.abs(np.hypot(x, y - radius) - abs(radius))
    angle = np.arctan2(x, (radius - y) * np.sign(radius))
    along = np.where(angle > 0.0, angle, 0.0) * abs(radius)
    # On a tight arc the footplate swings wide of the axle's path, so the straight box ahead of the chair counts too.
    box = (np.abs(y) < half) & (x > 0.0) & (x < outline.front_x_m + CLEAR_M)
    return np.asarray(box | ((aside < half) & (angle > 0.0) & (along < reach_m)), dtype=np.bool_)


@dataclass(slots=True, kw_only=True)
class _StopBeforeObstacles(_Memoryless):
    """Follows, but gives no throttle while the depth image shows something in the way within the stopping distance.

    It may still turn on the spot, so a user who steers past the obstacle gets going again. The camera looks forward:
    backwards it follows blindly. It warns, as `next_alarm` has it, of what it would stop for in a second.
    """

    actions: ActionSet
    watch: _CorridorWatch
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
            raise PolicyError(
                f"{self.name} got no truth from its environment; expected {key} = true: set it"
            )
        self._first_s = said.first_s

    def act(self, observation: Observation) -> int:
        """The user's wish as far as it ends well."""
        if self._first_s is None:
            raise PolicyError(
                "the oracle was asked to act before it saw the truth; expected see() before each act()"
            )
        first_s, self._first_s = (
            self._first_s,
            None,
        )  # the truth of one moment says nothing of the next
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
        return _StopBeforeObstacles(
            actions=actions, watch=_CorridorWatch(config.cameras[0], config.chair, outline)
        )
    if name.partition("@")[0] == LEVELLED:
        return DynamicWindow(
            name, config, actions, plant_spec(config.chair).outline, level_of(name)
        )
    if name in UPPER_BOUNDS:
        return _OracleDriver(actions=actions, name=name)
    raise PolicyError(
        f"unknown baseline {name!r}; expected one of: {', '.join((*BASELINES, *UPPER_BOUNDS))}"
    )
