"""Policies that learn nothing, to compare networks with: follow, random, zero, stop, oracles."""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from wcsim.agents.perception.alarm import TWO_TICKS, AlarmState, next_alarm_state
from wcsim.agents.perception.depth_image import depth_image_to_metres, viewing_rays
from wcsim.agents.policies.dwa import DynamicWindowPolicy
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

MARGIN_M: Final = 0.19  # on each side
CLEAR_M: Final = 0.3  # in front of a chair at rest
# What is higher is in the way, what is deeper is a drop: twice what the casters climb.
STEP_M: Final = 0.15
HEAD_M: Final = 1.6  # what hangs higher passes above
WARNS_AHEAD_S: Final = 1.0  # `stop` warns so long before it would stop
_REACTION_S: Final = 0.4  # one tick of delay, the drive's ramp
_SLOPE_PER_M: Final = 0.03  # uneven ground and depth steps grow with the distance
_PIXEL_SHARE: Final = 4e-4  # of the image, and at least _MIN_PIXELS: less is noise
_MIN_PIXELS: Final = 2
_STRAIGHT_RADPS: Final = 0.05


class _Memoryless:
    """The starts of a policy without a memory."""

    __slots__ = ()

    def begin(self) -> None:
        """Nothing to clear."""

    def reset(self) -> None:
        """Nothing to clear."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowPolicy(_Memoryless):
    """The action nearest to the user's joystick."""

    actions: ActionSet
    name: str = "follow"

    def act(self, observation: Observation) -> int:
        """The action nearest to the user's stick."""
        return self.actions.nearest(observation[JOYSTICK_KEY])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Zero(_Memoryless):
    """The stick at rest: the longest life and the worst obedience."""

    actions: ActionSet
    name: str = "zero"

    def act(self, observation: Observation) -> int:
        """Always the middle."""
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
        """Start the draws again: they are the same in every test."""
        self.rng = seeding.make_rng(self.seed, "agent", "random")

    def act(self, observation: Observation) -> int:
        """Draw an action, uniformly."""
        return int(self.rng.integers(0, len(self.actions)))


class _CorridorWatch:
    """Looks along the corridor that the chair sweeps at a joystick position, in one camera."""

    def __init__(self, camera: CameraConfig, chair: ChairConfig, outline: Outline) -> None:
        self._rays = viewing_rays(camera)
        self._eye_B_m = np.array(camera.p_BC_m, np.float64)  # (3,)
        self._range_m = camera.range_m
        self._chair = chair
        self._outline = outline
        self._few = max(_MIN_PIXELS, round(_PIXEL_SHARE * len(self._rays)))

    def blocked(self, observation: Observation, x: float, y: float, ahead_s: float = 0.0) -> bool:
        """Whether a joystick (x right, y > 0 forward) would hit something before the chair stops.

        With `ahead_s` the chair begins to brake so much later.
        """
        # 1. The points of the image in B, and how far the chair drives until it stops.
        depth_m = (
            depth_image_to_metres(observation[DEPTH_KEY], self._range_m)
            .reshape(-1)
            .astype(np.float64)
        )
        points = self._eye_B_m + self._rays * depth_m[:, None]  # (H * W, 3)
        roll_rad = math.pi * float(observation[IMU_KEY][3])
        pitch_rad = 0.5 * math.pi * float(observation[IMU_KEY][4])
        speed, turn = y * self._chair.v_max_mps, -x * self._chair.yaw_rate_max_radps
        stop_m = speed * (_REACTION_S + ahead_s) + speed * speed / (2.0 * self._chair.decel_mps2)
        reach_m = stop_m + self._outline.front_x_m + CLEAR_M
        # 2. Something solid. A depth of 0 was not measured.
        seen = (depth_m > 0.0) & (depth_m < 0.99 * self._range_m)
        low, high = _heights(points, roll_rad, pitch_rad)
        solid = seen & (low > _limit_m(points)) & (high < HEAD_M)
        if self._enough(solid & _in_corridor(points, speed, turn, reach_m, self._outline)):
            return True
        # 3. A drop: rays that would meet level ground within the corridor, but go on below it.
        down = self._rays[:, 2] < -1e-3
        fall = np.where(down, -self._eye_B_m[2] / np.where(down, self._rays[:, 2], -1.0), 0.0)
        ground = self._eye_B_m + self._rays * fall[:, None]
        deep = down & (high < -_limit_m(ground))
        return self._enough(deep & _in_corridor(ground, speed, turn, reach_m, self._outline))

    def _enough(self, pixels: Bool) -> bool:
        return int(np.count_nonzero(pixels)) >= self._few


def _limit_m(points_B_m: F64) -> F64:
    """(K,) the height above which a place is in the way, and the depth below which it is a drop."""
    return STEP_M + _SLOPE_PER_M * np.hypot(points_B_m[:, 0], points_B_m[:, 1])


def _heights(points_B_m: F64, roll_rad: float, pitch_rad: float) -> tuple[F64, F64]:
    """Smaller and larger of two heights of each point: above the chair's plane, and a level plane.

    On a ramp the first is right, just before or after it the second; something counts only when
    both agree.
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
    """(K,) which points the chair passes over on its arc, up to `reach_m` ahead of its axle."""
    x, y = points_B_m[:, 0], points_B_m[:, 1]
    half = 0.5 * outline.width_m + MARGIN_M
    if abs(turn_radps) < _STRAIGHT_RADPS:
        return (np.abs(y) < half) & (x > 0.0) & (x < reach_m)
    radius = speed_mps / turn_radps  # centre of the arc at (0, radius), left positive
    aside = np.abs(np.hypot(x, y - radius) - abs(radius))
    angle = np.arctan2(x, (radius - y) * np.sign(radius))
    along = np.where(angle > 0.0, angle, 0.0) * abs(radius)
    # On a tight arc the footplate swings wide of the axle's path, so the straight box ahead of the
    # chair counts too.
    box = (np.abs(y) < half) & (x > 0.0) & (x < outline.front_x_m + CLEAR_M)
    return np.asarray(box | ((aside < half) & (angle > 0.0) & (along < reach_m)), np.bool_)


@dataclass(slots=True, kw_only=True)
class _StopBeforeObstacles(_Memoryless):
    """Follows, but without throttle while something is in the way within the stopping distance.

    It may still turn on the spot, so a user who steers past the obstacle can go on. The camera
    looks forward: backwards it follows blindly. It warns, by `next_alarm_state`, a second before it
    would stop.
    """

    actions: ActionSet
    watch: _CorridorWatch
    name: str = "stop"
    _alarm: AlarmState = field(init=False, default=AlarmState())

    @property
    def warning(self) -> bool:
        """Whether it would soon stop."""
        return self._alarm.on

    def reset(self) -> None:
        """End the warning with the episode."""
        self._alarm = AlarmState()

    def act(self, observation: Observation) -> int:
        """The user's stick, without its forward part when the way is blocked."""
        x, y = (float(value) for value in observation[JOYSTICK_KEY])
        stops = y > 0.0 and self.watch.blocked(observation, x, y, WARNS_AHEAD_S)
        self._alarm = next_alarm_state(self._alarm, float(stops), TWO_TICKS)
        if y > 0.0 and self.watch.blocked(observation, x, y):
            return self.actions.nearest((x, 0.0))
        return self.actions.nearest((x, y))


@dataclass(slots=True, kw_only=True)
class _OracleDriver(_Memoryless):
    """The safe action nearest to the user's joystick, by the true geometry, or the last to fail.

    With the name `oracle-visible` it knows only the road users that the chair's cameras have shown
    lately.
    """

    actions: ActionSet
    name: str = UPPER_BOUND
    _first_s: F64 | None = field(init=False, default=None)

    def see(self, truth: Truth | None) -> None:
        """Take the truth of the moment to act in. Raises PolicyError without one."""
        visible = self.name == VISIBLE_BOUND
        verdict: Verdict | None = truth.visible if visible and truth is not None else truth
        if verdict is None:
            key = "env.truth_visible" if visible else "env.truth"
            raise PolicyError(
                f"{self.name} got no truth from its environment; expected {key} = true: set it"
            )
        self._first_s = verdict.first_s

    def act(self, observation: Observation) -> int:
        """The action nearest to the user's stick that ends well."""
        if self._first_s is None:
            raise PolicyError(
                "the oracle was asked to act before it saw the truth; expected see() before each "
                "act()"
            )
        # The truth of one moment is none of the next.
        first_s = self._first_s
        self._first_s = None
        latest = first_s == first_s.max()  # infinity, where any ends well
        distances = self.actions.distances(np.asarray(observation[JOYSTICK_KEY])[None])[0]
        if np.isfinite(first_s).all():  # of those that fail together the gentlest
            distances = np.hypot(self.actions.points[:, 0], self.actions.points[:, 1])
        return int(np.argmin(np.where(latest, distances, np.inf)))


def make_baseline_policy(name: str, config: RunConfig, seed: int = 0) -> Policy:
    """A baseline for a run's actions, camera and chair. Raises PolicyError for an unknown name."""
    actions = action_set(config.env.actions)
    if name == "follow":
        return FollowPolicy(actions=actions)
    if name == "random":
        return _Random(actions=actions, seed=seed)
    if name == "zero":
        return _Zero(actions=actions)
    if name == "stop":
        outline = plant_spec(config.chair).outline
        return _StopBeforeObstacles(
            actions=actions, watch=_CorridorWatch(config.eye, config.chair, outline)
        )
    if name.partition("@")[0] == LEVELLED:
        return DynamicWindowPolicy(name, config, level_of(name))
    if name in UPPER_BOUNDS:
        return _OracleDriver(actions=actions, name=name)
    raise PolicyError(
        f"unknown baseline {name!r}; expected one of: {', '.join((*BASELINES, *UPPER_BOUNDS))}"
    )
