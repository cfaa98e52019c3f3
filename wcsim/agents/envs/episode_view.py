"""One wheelchair as an agent meets it: its frames, of the last ticks too, become observations, rewards and info.

All faces are made of this one piece, so what an agent sees and is paid does not depend on the face.
"""

from __future__ import annotations

import operator
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt

from wcsim.agents import policy_api
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, JOYSTICK_KEY, RGB_KEY, STATE_SENSE
from wcsim.config import RunConfig
from wcsim.core.reading import escaped_value
from wcsim.errors import BadActionError, ConfigMismatchError, PolicyError, ProtocolError
from wcsim.supervisor.actions import MAX_DISTANCE, action_set
from wcsim.supervisor.observation import NEAR, Observation, observation_of, state_of
from wcsim.supervisor.rewards import DISTANCE_TOLERANCE, RewardTerm, joystick_distance, reward
from wcsim.types import F32, ClientSnapshot, Command, Drawn, Joystick, RewardTerms

IMAGE_KEYS = (CLASS_KEY, DEPTH_KEY, RGB_KEY)  # of the compact forms


class FrameWindow:
    """Puts the last `frames` images of an episode into its observations, the newest last.

    The first image of an episode fills the window. IMU and joystick stay those of now. With one frame, observations of
    any form go through as they are.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._kept: deque[Observation] = deque(maxlen=frames)

    def reset(self) -> None:
        """Forget everything: the next observation begins an episode."""
        self._kept.clear()

    def add(self, observation: Observation) -> Observation:
        """The observation with its window, (frames, H, W) in fresh arrays, from one with (1, H, W); colours thrice."""
        if self._frames == 1:
            return observation
        missing = max(self._frames - len(self._kept), 1)  # all of them once, then one each time
        self._kept.extend([observation] * missing)
        images = {
            key: np.concatenate([old[key] for old in self._kept])
            for key in IMAGE_KEYS
            if key in observation
        }
        return {**observation, **images}


def windowed_space(space: gymnasium.spaces.Dict, frames: int) -> gymnasium.spaces.Dict:
    """The space of the observations that `FrameWindow` makes of the compact ones in `space`."""
    if frames == 1:
        return space
    parts = dict(space.spaces)
    for key in parts.keys() & set(IMAGE_KEYS):
        planes, *size = space[key].shape or ()
        shape = (frames * planes, *size)
        parts[key] = gymnasium.spaces.Box(0, 255, shape, np.uint8)
    return gymnasium.spaces.Dict(parts)


def newest(observation: policy_api.Observation, frames: int) -> policy_api.Observation:
    """The observation with the newest `frames` images of its window, as views.

    Raises PolicyError when the window holds fewer.
    """
    held = len(observation[DEPTH_KEY])
    if held < frames:
        raise PolicyError(
            f"an observation holds {held} images, this policy was trained on {frames}; expected at least as many: "
            f"set env.window={frames}"
        )
    if held == frames:
        return observation
    # An image may have several planes: colours have three for each moment.
    planes = {key: len(observation[key]) // held for key in IMAGE_KEYS if key in observation}
    return {
        key: value[-frames * planes[key] :] if key in planes else value
        for key, value in observation.items()
    }


Seen = Observation | F32
"""What an environment shows: pictures and numbers by name, or the rows of `state`."""
Info = dict[str, Any]
WORLD_RESTARTED = "world_restarted"


def named(seen: Seen) -> Observation:
    """The same, for a policy: the rows of `state` by name, and the user's stick (2,) beside them."""
    return (
        seen if isinstance(seen, dict) else {STATE_SENSE: seen, JOYSTICK_KEY: seen[0, 1:3].copy()}
    )


def delay_ticks(config: RunConfig, drawn: Drawn | None) -> int:
    """From a command to the chair that obeys it, in an episode for which `drawn` was drawn."""
    told = None if drawn is None else drawn.action_delay_ticks
    return config.world.action_delay_ticks if told is None else told


class EpisodeStep(NamedTuple):
    """What one step was, in the order of Gymnasium's `step`."""

    observation: Seen
    reward: float
    terminated: bool
    truncated: bool
    info: Info

    @property
    def done(self) -> bool:
        """Whether the episode ended with it."""
        return self.terminated or self.truncated


class Chair:
    """A seat of a world, driven by actions of the set; `now` is its frame, None before its first one."""

    def __init__(self, config: RunConfig, terms: Sequence[RewardTerm] = ()) -> None:
        """A chair of this configuration; `terms` are the user's own reward terms, for this chair alone."""
        self.now: ClientSnapshot | None = None
        self._config = config
        self._actions = action_set(config.env.lattice)
        self._any_stick, self._state = (
            config.env.actions == "stick",
            config.env.observation == "state",
        )
        self.terms = tuple(terms)
        self._window = FrameWindow(config.env.frames)
        self._seen: Seen = {}  # the last observation
        self._given = Joystick(0.0, 0.0)
        self._arrived = False  # at a destination of this episode

    @property
    def ready(self) -> bool:
        """Whether an episode is on."""
        return self.now is not None and self.now.first is None

    @property
    def picture(self) -> npt.NDArray[np.uint8] | None:
        """What the camera of networks sees in colours, (H, W, 3) uint8, where colours are drawn; an array of its own.

        A film needs pictures for longer, and the camera draws into the same buffers again.
        """
        place = self._config.cameras.index(self._config.eye)
        frames = () if self.now is None else self.now.sensors.cameras
        drawn = frames[place].rgb if frames else None
        return None if drawn is None else drawn.copy()

    def begin(self, first: ClientSnapshot) -> tuple[Seen, Info]:
        """Begin an episode with its first frame.

        Raises:
            ConfigMismatchError: The world's cameras are not those of this configuration.
        """
        self._check(first)
        self.now = first
        for term in self.terms:
            term.reset()
        self._window.reset()
        self._arrived = False
        self._seen = self._observed(first)
        return self._seen, self._info(first, None, 0.0)

    def begin_next(self) -> tuple[Seen, Info]:
        """Begin the episode whose first frame came with the last one of the episode before.

        Raises:
            ProtocolError: The episode before has not ended.
        """
        if self.now is None or self.now.first is None:
            raise ProtocolError("the next episode is not there yet; expected one that has ended")
        return self.begin(self.now.first)

    def checked(self, action: object) -> int:
        """An action's index in the set, of what a learner chose.

        Raises:
            ProtocolError: No episode is on.
            BadActionError: It is no integer, or not in the set.
        """
        self._frame()
        index, most = _integer(action), len(self._actions) - 1
        if index is None or not 0 <= index <= most:
            got = escaped_value(action)
            raise BadActionError(
                f"action {got} is not in the action set; expected an integer from 0 to {most}"
            )
        return index

    def stick(self, action: object) -> Joystick:
        """The joystick position that an action stands for, or is. Raises what `checked` raises."""
        if not self._any_stick:
            return Joystick(*self._actions.points[self.checked(action)].tolist())
        self._frame()
        try:
            real = not any(
                isinstance(part, complex | np.complexfloating) for part in np.ravel(action)
            )  # type: ignore[call-overload]
            xy = np.asarray(action, np.float64) if real else np.empty(0)
        except (TypeError, ValueError, OverflowError):
            xy = np.empty(0)
        if xy.shape != (2,) or not (np.abs(xy) <= 1.0).all():  # no number is not within either
            raise BadActionError(
                f"action {escaped_value(action)} is no stick; expected x and y from -1 to 1"
            )
        # The gate of a joystick is round: what lies beyond it is pushed that way, as far as it goes.
        return Joystick(*(xy / max(1.0, float(np.hypot(*xy)))).tolist())

    def command(self, action: object) -> Command:
        """An action as the command of the tick of now. Raises what `checked` raises."""
        now, self._given = self._frame(), self.stick(action)
        return Command(seat=now.seat, tick=now.tick, joystick=self._given)

    def take(self, after: ClientSnapshot) -> EpisodeStep:
        """What came of the action that was commanded, with the seat's next frame."""
        before = self.now
        if before is None:
            raise ProtocolError("nothing was commanded; expected command() before take()")
        self.now, asked, events, config = after, before.user, after.events, self._config.reward
        gap = np.array([asked.x, asked.y]), np.array([self._given.x, self._given.y])
        distance = joystick_distance(*gap, config)
        terms = reward(distance, after.sensors.imu, after.plant, events, config)
        if self.terms:
            terms = replace(
                terms, extra=sum(float(term.reward(before, after)) for term in self.terms)
            )
        self._seen = self._observed(after)
        self._arrived = self._arrived or events.arrived
        far = min(float(np.hypot(*(gap[1] - gap[0]))), MAX_DISTANCE)
        info = self._info(after, terms, far, (asked, self._given))
        # An episode that crashed has ended: nothing is left that could be cut off.
        truncated = events.truncated and not events.crashed
        return EpisodeStep(self._seen, float(terms.total), events.crashed, truncated, info)

    def cut(self) -> EpisodeStep:
        """The end of an episode whose world began again: the last observation once more, truncated, worth nothing.

        Raises:
            ProtocolError: There is no episode.
        """
        if self.now is None:
            raise ProtocolError("there is no episode to cut; expected one that has begun")
        last, self.now = self.now, None
        nothing = replace(
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
        info = self._info(replace(last, events=nothing, contacts=()), None, 0.0)
        return EpisodeStep(self._seen, 0.0, False, True, {**info, "reason": WORLD_RESTARTED})

    def _observed(self, frame: ClientSnapshot) -> Seen:
        return (
            state_of(frame)
            if self._state
            else self._window.add(observation_of(frame, self._config))
        )

    def _frame(self) -> ClientSnapshot:
        """The frame of now. Raises ProtocolError where no episode is on."""
        if self.now is None or self.now.first is not None:
            raise ProtocolError(
                "step() came before reset(), or after the episode's end; call reset() first"
            )
        return self.now

    def _info(
        self,
        snapshot: ClientSnapshot,
        terms: RewardTerms | None,
        distance: float,
        sticks: tuple[Joystick, Joystick] | None = None,
    ) -> Info:
        """What an agent is told beside its observation; `sticks` are the user's and its own answer to it."""
        plant, user = snapshot.plant, (snapshot.user.x, snapshot.user.y)
        asked, given = sticks or (None, None)
        return {
            "state": plant,
            "imu": snapshot.sensors.imu,
            **{reading.name: reading.values for reading in snapshot.sensors.readings},
            "user_action": np.array(user, np.float32)
            if self._any_stick
            else self._actions.nearest(user),
            "joystick_distance": distance,
            "asked": asked,
            "given": given,
            "reward_terms": terms,
            "rewards": {
                name: getattr(terms, name) if terms else 0.0 for name in RewardTerms.__slots__
            },
            # An episode goes on behind a destination: at its end the last step says whether one was reached.
            "is_success": self._arrived and not snapshot.events.crashed,
            "truth": snapshot.truth,
            "drawn": snapshot.drawn,
            "warning": snapshot.truth.danger if snapshot.truth else None,
            "intervening": distance > self._config.reward.max_follow_distance + DISTANCE_TOLERANCE,
            "events": snapshot.events,
            "help": snapshot.events.help_asked,
            "contacts": snapshot.contacts,
            "progress_m": snapshot.events.progress_m,
            "speed_mps": float(np.hypot(plant.v_B_mps[0], plant.v_B_mps[1])),
        }

    def _check(self, first: ClientSnapshot) -> None:
        """Pictures of another size would leave the observation space without a word."""
        wanted = [
            (camera.name, (camera.height_px, camera.width_px)) for camera in self._config.cameras
        ]
        if self._state and not any(camera.rgb for camera in self._config.cameras):
            wanted = []
        given = {reading.name: len(reading.values) for reading in first.sensors.readings}
        if self._state and NEAR not in given:
            raise ConfigMismatchError(
                "env.observation=state, but this seat's world does not say what is near; policies see pictures: "
                "expected env.observation=compact, your own class with senses = ('state',) and no such setting, or a "
                "seat with near=True"
            )
        got = [(frame.name, frame.depth_m.shape) for frame in first.sensors.cameras]
        if got != wanted:
            raise ConfigMismatchError(
                f"the world's cameras are {got}; expected {wanted}: use its configuration"
            )
        sensors = {
            name: len(measure.parts) for name, measure in self._config.sensors.measures().items()
        }
        if not sensors.items() <= given.items():
            raise ConfigMismatchError(
                f"the world's sensors are {given}; expected {sensors}: use its configuration"
            )


def _integer(value: object) -> int | None:
    """The integer that a number or an array of one number is; None for anything else, 1.0 included."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(())[()]
    try:
        return operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        return None
