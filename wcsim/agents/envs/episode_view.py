"""One wheelchair as its agent sees it: frames become observations, rewards and info.

Every environment, and every driver of a seat, uses this one class `SeatEnvAdapter`; so what an
agent observes and earns does not depend on the interface. `begin` takes the first frame of an
episode; then each step is a `command` and its `finish_step`.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from typing import Any, Final, NamedTuple, Self, get_args

import numpy as np
from gymnasium import spaces

from wcsim.agents import policy_api
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, JOYSTICK_KEY, RGB_KEY, STATE_SENSE
from wcsim.config import RunConfig
from wcsim.core.reading import escape_repr
from wcsim.errors import (
    BadActionError,
    ConfigError,
    ConfigMismatchError,
    PolicyError,
    ProtocolError,
)
from wcsim.supervisor.actions import MAX_DISTANCE, action_set
from wcsim.supervisor.observation import NEAR, Observation, make_observation, make_state_observation
from wcsim.supervisor.rewards import (
    DISTANCE_TOLERANCE,
    CrashReason,
    RewardTerm,
    compute_reward_terms,
    joystick_distance,
)
from wcsim.types import F32, U8, ClientSnapshot, Command, Drawn, Joystick, RewardTerms
from wcsim.types.chair import AT_REST

WORLD_RESTARTED: Final = "world_restarted"  # key of `info`
OBJECTS: Final = "objects"  # key of `info`
_NUMBERS: Final = (bool, int, float, np.ndarray)
_NO_REWARD: Final = RewardTerms(base=0.0, joystick=0.0, accel=0.0, tilt=0.0, crash=0.0)
_IMAGES: Final = (CLASS_KEY, DEPTH_KEY, RGB_KEY, policy_api.COLOURS_KEY)

# Of an environment: pictures and numbers by name, or the rows of `state`.
EnvObservation = Observation | F32
Info = dict[str, Any]


class InfoObjects(np.ndarray[Any, Any]):
    """What else is known of a frame, as attributes of an array without elements.

    What converts, stacks or stores the numbers in `info` finds none here, and drops the rest. The
    attributes are the frame's `state`, `events`, `contacts`, `truth` and `drawn`, and of the step
    the `reward_terms` and the sticks that were `asked` and `given`. What is not there is None.
    They stay in their process.
    """

    state = truth = drawn = None

    def __new__(cls, **objects: Any) -> Self:
        """An array (0,) with these attributes."""
        made = np.empty(0).view(cls)
        made.__dict__.update(objects)
        return made

    def __array_finalize__(self, source: object) -> None:
        self.__dict__.update(getattr(source, "__dict__", {}))


class EnvStepResult(NamedTuple):
    """The result of a step, in the order of Gymnasium's `step`."""

    observation: EnvObservation
    reward: float
    terminated: bool
    truncated: bool
    info: Info

    @property
    def done(self) -> bool:
        """Whether the episode ended with it."""
        return self.terminated or self.truncated


class SeatEnvAdapter:
    """One seat of a world as its agent sees it, from episode to episode.

    Args:
        config: Of the world.
        terms: The user's own reward terms, for this chair alone.

    Attributes:
        now: Its latest frame; None before the first one.
    """

    def __init__(self, config: RunConfig, terms: Sequence[RewardTerm] = ()) -> None:
        self.now: ClientSnapshot | None = None
        self.terms = tuple(terms)
        self._config = config
        self._actions = action_set(config.env.lattice)
        self._any_stick = config.env.actions == "stick"
        self._state = config.env.observation == "state"
        self._window = FrameStacker(config.env.frames)
        self._observation: EnvObservation = {}  # the last one
        self._given = AT_REST  # as commanded last
        self._arrived = False  # at a destination of this episode

    @property
    def ready(self) -> bool:
        """Whether an episode is on."""
        return self.now is not None and self.now.first is None

    @property
    def picture(self) -> U8 | None:
        """The colours of the networks' camera, (H, W, 3) uint8; None where none are drawn."""
        if self.now is None or not self.now.sensors.cameras:
            return None
        camera = self._config.cameras.index(self._config.eye)
        drawn = self.now.sensors.cameras[camera].rgb
        # A copy: a film needs pictures for longer, and the camera draws into the same buffers.
        return None if drawn is None else drawn.copy()

    def begin(self, first: ClientSnapshot) -> tuple[EnvObservation, Info]:
        """Begin an episode with its first frame.

        Raises:
            ConfigMismatchError: The world's cameras or sensors are not those of this configuration.
        """
        self._require_configured(first)
        self.now = first
        for term in self.terms:
            term.reset()
        self._window.reset()
        self._arrived = False
        self._observation = self._observed(first)
        return self._observation, self._info(first)

    def begin_next(self) -> tuple[EnvObservation, Info]:
        """Begin the next episode, whose first frame is part of the last frame of this one.

        Raises:
            ProtocolError: The episode before has not ended.
        """
        if self.now is None or self.now.first is None:
            raise ProtocolError("the next episode is not there yet; expected one that has ended")
        return self.begin(self.now.first)

    def action_index(self, action: object) -> int:
        """See `ActionSet.index`. Raises ProtocolError, too, when no episode is on."""
        self._require_ready()
        return self._actions.index(action)

    def stick(self, action: object) -> Joystick:
        """The joystick position of an action. Raises as `action_index`."""
        if not self._any_stick:
            return Joystick(*self._actions.points[self.action_index(action)].tolist())
        self._require_ready()
        xy = np.empty(0)
        with suppress(TypeError, ValueError, OverflowError):
            # A complex number would lose its imaginary part with a warning alone.
            parts = np.ravel(action)  # type: ignore[call-overload]
            if not any(isinstance(part, complex | np.complexfloating) for part in parts):
                xy = np.asarray(action, np.float64)
        # NaN is not within the bounds either.
        if xy.shape != (2,) or not (np.abs(xy) <= 1.0).all():
            raise BadActionError(
                f"action {escape_repr(action)} is no stick; expected x and y from -1 to 1"
            )
        # The gate of a joystick is round: what lies beyond it is pushed that way, up to the gate.
        return Joystick(*(xy / max(1.0, float(np.hypot(*xy)))).tolist())

    def command(self, action: object) -> Command:
        """An action as the command of this tick. Raises as `action_index`."""
        now = self._require_ready()
        self._given = self.stick(action)
        return Command(seat=now.seat, tick=now.tick, joystick=self._given)

    def finish_step(self, after: ClientSnapshot) -> EnvStepResult:
        """The result of the last command; `after` is the seat's frame after the tick.

        Raises ConfigError for a user's reward term that is not finite.
        """
        # 1. Reward. The command answered the user's stick of the frame before.
        before = self.now
        if before is None:
            raise ProtocolError("nothing was commanded; expected command() before finish_step()")
        self.now = after
        user = np.array([before.user.x, before.user.y])
        given = np.array([self._given.x, self._given.y])
        config = self._config.reward
        terms = compute_reward_terms(
            joystick_distance(user, given, config),
            after.sensors.imu,
            after.plant,
            after.events,
            config,
        )
        for term in self.terms:
            reward = float(term.reward(before, after))
            if not math.isfinite(reward):
                raise ConfigError(
                    f"reward term {type(term).__name__} returned {reward} in step "
                    f"{after.events.step} of an episode; expected a finite number: correct the term"
                )
            terms = replace(terms, extra=terms.extra + reward)
        # 2. Observation and info. The distance in `info` does not depend on the reward's settings.
        self._observation = self._observed(after)
        self._arrived = self._arrived or after.events.arrived
        distance = min(float(np.hypot(*(given - user))), MAX_DISTANCE)
        info = self._info(after, terms, distance, (before.user, self._given))
        # 3. End. An episode that crashed has ended: nothing is left that could be cut off.
        crashed = after.events.crashed
        truncated = after.events.truncated and not crashed
        return EnvStepResult(self._observation, float(terms.total), crashed, truncated, info)

    def truncate(self) -> EnvStepResult:
        """End an episode whose world was restarted: the last observation again, reward 0.

        Raises:
            ProtocolError: There is no episode.
        """
        if self.now is None:
            raise ProtocolError("there is no episode to cut; expected one that has begun")
        last = self.now
        self.now = None
        # Nothing of the last step may count twice.
        events = replace(
            last.events,
            truncated=True,
            arrived=False,
            gave_up=False,
            progress_m=0.0,
            jam_teleports=0,
            crossed=False,
            entered_red=False,
            help_asked=False,
        )
        info = self._info(replace(last, events=events, contacts=()))
        return EnvStepResult(self._observation, 0.0, False, True, {**info, WORLD_RESTARTED: True})

    def _require_ready(self) -> ClientSnapshot:
        """The current frame. Raises ProtocolError where no episode is on."""
        if self.now is None or self.now.first is not None:
            raise ProtocolError(
                "step() came before reset(), or after the episode's end; call reset() first"
            )
        return self.now

    def _observed(self, frame: ClientSnapshot) -> EnvObservation:
        """The observation of a frame, which the window stores."""
        if self._state:
            return make_state_observation(frame)
        return self._window.add(make_observation(frame, self._config))

    def _info(
        self,
        snapshot: ClientSnapshot,
        terms: RewardTerms = _NO_REWARD,
        distance: float = 0.0,
        sticks: tuple[Joystick, Joystick] = (AT_REST, AT_REST),
    ) -> Info:
        """The info of an observation; `sticks` are the user's and the command that answered it."""
        plant, events, truth = snapshot.plant, snapshot.events, snapshot.truth
        user_stick, given = sticks
        user = (snapshot.user.x, snapshot.user.y)
        parts: dict[str, Any] = {
            "imu": snapshot.sensors.imu,
            "event": events,
            "reward": terms,
            "truth": truth,
        }
        return {
            # Flat, and without the names of an observation: tools put both into one dictionary.
            **{
                f"{kind}_{field.name}": value
                for kind, part in parts.items()
                if part is not None
                for field in fields(part)
                if isinstance(value := getattr(part, field.name), _NUMBERS)
            },
            **{f"reading_{reading.name}": reading.values for reading in snapshot.sensors.readings},
            "state": plant.row,
            "user_action": np.array(user, np.float32)
            if self._any_stick
            else self._actions.nearest(user),
            "joystick_distance": distance,
            "asked": np.array([user_stick.x, user_stick.y]),
            "given": np.array([given.x, given.y]),
            # An episode continues after a destination: its last step shows whether one was reached.
            "is_success": self._arrived and not events.crashed,
            **({} if truth is None else {"warning": truth.danger}),
            "intervening": distance > self._config.reward.max_follow_distance + DISTANCE_TOLERANCE,
            "event_crash_reason": get_args(CrashReason).index(events.crash_reason),
            "help": events.help_asked,
            "contacts": len(snapshot.contacts),
            "progress_m": events.progress_m,
            "speed_mps": float(np.hypot(plant.v_B_mps[0], plant.v_B_mps[1])),
            WORLD_RESTARTED: False,
            OBJECTS: InfoObjects(
                state=plant,
                events=events,
                contacts=snapshot.contacts,
                asked=user_stick,
                given=given,
                reward_terms=terms,
                truth=truth,
                drawn=snapshot.drawn,
            ),
        }

    def _require_configured(self, first: ClientSnapshot) -> None:
        """Refuse a world whose frames would not fit into the observation space."""
        config = self._config
        values = {reading.name: len(reading.values) for reading in first.sensors.readings}
        if self._state and NEAR not in values:
            raise ConfigMismatchError(
                "env.observation=state, but this seat's world does not say what is near; policies "
                "see pictures: expected env.observation=compact, your own class with senses = "
                "('state',) and no such setting, or a seat with near=True"
            )
        expected = [(camera.name, (camera.height_px, camera.width_px)) for camera in config.cameras]
        # Without pictures in the observation, a world draws them only for colours.
        if self._state and not any(camera.rgb for camera in config.cameras):
            expected = []
        received = [(frame.name, frame.depth_m.shape) for frame in first.sensors.cameras]
        if received != expected:
            raise ConfigMismatchError(
                f"the world's cameras are {received}; expected {expected}: use its configuration"
            )
        sensors = {name: len(measure.parts) for name, measure in config.sensors.measures().items()}
        if not sensors.items() <= values.items():
            raise ConfigMismatchError(
                f"the world's sensors are {values}; expected {sensors}: use its configuration"
            )


def env_to_policy_observation(observation: EnvObservation) -> Observation:
    """An observation for a policy: rows of `state` by name, with the user's stick (2,)."""
    if isinstance(observation, dict):
        return observation
    return {STATE_SENSE: observation, JOYSTICK_KEY: observation[0, 1:3].copy()}


def find_episode_delay_ticks(config: RunConfig, drawn: Drawn | None) -> int:
    """The delay from a command to the chair's motion, as drawn for an episode or configured."""
    if drawn is None or drawn.action_delay_ticks is None:
        return config.world.action_delay_ticks
    return drawn.action_delay_ticks


def _image_keys(keys: Iterable[str]) -> list[str]:
    """Those of images: each has the name of its camera before it, but for the first camera."""
    return [key for key in keys if key.rpartition("_")[2] in _IMAGES]


class FrameStacker:
    """Puts the last `frames` images of an episode into its observations, the newest last.

    The first image of an episode fills the window. IMU and joystick are the latest ones. With one
    frame, observations of any form pass unchanged.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._observations: deque[Observation] = deque(maxlen=frames)

    def reset(self) -> None:
        """Clear the window: the next observation begins an episode."""
        self._observations.clear()

    def add(self, observation: Observation) -> Observation:
        """Store an observation with images (1, H, W); returns it with its window (frames, H, W).

        Colours have three planes an image. Each array of Table 3 gets a dimension in front. The
        arrays of the window are new ones.
        """
        if self._frames == 1:
            return observation
        join = np.stack if policy_api.COLOURS_KEY in observation else np.concatenate
        missing = max(self._frames - len(self._observations), 1)
        self._observations.extend([observation] * missing)
        images: Observation = {
            key: join([old[key] for old in self._observations]) for key in _image_keys(observation)
        }
        return {**observation, **images}


def window_observation_space(space: spaces.Dict, frames: int) -> spaces.Dict:
    """The space of the observations that `FrameStacker` makes of those in `space`."""
    if frames == 1:
        return space
    parts = dict(space.spaces)
    for key in _image_keys(parts):
        planes, *size = space[key].shape or ()
        if policy_api.COLOURS_KEY in parts:
            parts[key] = spaces.Box(0.0, 1.0, (frames, planes, *size), np.float32)
        else:
            parts[key] = spaces.Box(0, 255, (frames * planes, *size), np.uint8)
    return spaces.Dict(parts)


def trim_frame_window(observation: policy_api.Observation, frames: int) -> policy_api.Observation:
    """The observation with the newest `frames` images of its window, as views.

    Raises PolicyError when the window holds fewer.
    """
    held = len(observation[DEPTH_KEY])
    if held < frames:
        raise PolicyError(
            f"an observation holds {held} images, this policy was trained on {frames}; expected at "
            f"least as many: set env.window={frames}"
        )
    if held == frames:
        return observation
    # An image may have several planes: colours have three.
    images = {
        key: observation[key][-frames * (len(observation[key]) // held) :]
        for key in _image_keys(observation)
    }
    if frames == 1:  # a picture of Table 3 has no dimension in front
        images = {key: value.reshape(-1, *value.shape[-2:]) for key, value in images.items()}
    return {**observation, **images}
