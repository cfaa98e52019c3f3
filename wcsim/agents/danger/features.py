"""The inputs of the danger network at one tick, made from a chair's observation and what it remembers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.agents.danger.street_map import PLANES, SIDE, StreetMap, hull_and_wheels
from wcsim.agents.policies.dynamic_window.surroundings import StreetSense
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, IMU_KEY, JOYSTICK_KEY, ODOMETRY_KEY, Observation
from wcsim.config import RunConfig
from wcsim.errors import PolicyError
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.actions import action_set
from wcsim.types import F32, F64, U8

COMMANDS: Final = 3  # last ones that are an input
TILT: Final = slice(3, 5)  # roll and pitch in the IMU vector
TURNS: Final = slice(5, 8)  # turn rates there
FULL_MOTION: Final = (1.67, 1.5, 2.0)  # speed, turn rate and acceleration that are 1 in the vector
_KEYS: Final = (DEPTH_KEY, CLASS_KEY, IMU_KEY, JOYSTICK_KEY, ODOMETRY_KEY)
_STARTS: Final = 4  # v, w, acceleration, delay
VECTOR: Final = 2 + 3 + _STARTS + 2 * COMMANDS
MIRRORED: Final = (0, 2, 4, 6, *range(9, VECTOR, 2))  # numbers that change their sign when left and right change places


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Features:
    """One tick of one chair."""

    picture: U8  # (PLANES, SIDE, SIDE) see `street_map`
    vector: F32  # (VECTOR,) roll, pitch, turn rates, v, w, acceleration, delay, the last commands (x, y)
    start: F32  # (6,) where roll-outs begin, see `sweep`
    frames: U8  # (T, 2, H, W) class ids and depth of the last T ticks, the newest last; the first one fills the window


class FeatureExtractor:
    """Makes the features of one chair, from tick to tick: `extract`, then `command`.

    Args:
        config: Of the run: its first camera is seen, and its chair driven.
        delay_ticks: From a command to the chair that obeys it; as the configuration says when it is None.
        street: Whether it makes the street map, and over which cells of it each action sweeps.
        pictures: How many of the last ticks' pictures are shown as they are.
    """

    def __init__(
        self, config: RunConfig, delay_ticks: int | None = None, street: bool = True, pictures: int = 0
    ) -> None:
        self.street, self._pictures = street, pictures
        self._shape = (2, config.cameras[0].height_px, config.cameras[0].width_px)
        self._actions = action_set(config.env.actions)
        spec = plant_spec(config.chair)
        self.around = StreetSense(config, self._actions, spec.outline, delay_ticks)
        around = self.around
        self._map = StreetMap(around.rays, around.eye_B_m, around.far_m)
        self.chair = hull_and_wheels(around.box_B_m, np.array(spec.stand_m(), np.float64))
        self.forget()

    def forget(self) -> None:
        """Stand still, and know nothing of the street."""
        self.around.forget()
        self._map.forget()
        self._sent = np.zeros((COMMANDS, 2))
        self._frames: U8 = np.empty((0, *self._shape), np.uint8)

    def extract(self, observation: Observation) -> Features:
        """Take the observation of a new tick. Raises PolicyError when it lacks a sense, or is of another camera."""
        self._require(observation)
        picture = np.zeros((PLANES, SIDE, SIDE), np.uint8)
        if self.street:
            around = self.around
            around.move(observation)
            self._map.see(around.depth_m, around.classes(observation), around.ego.pose_O)
            self._map.picture(around.ego.pose_O, picture)
        else:
            self.around.feel(observation)
        start, later_s = self.around.start()
        return Features(
            picture=picture,
            vector=self._vector(observation, later_s),
            start=start.astype(np.float32),
            frames=self._seen(observation),
        )

    def command(self, action: int) -> None:
        """Say which action is sent now."""
        self.around.command(action)
        self._sent = np.roll(self._sent, 1, axis=0)
        self._sent[0] = self._actions.points[action]

    def _seen(self, observation: Observation) -> U8:
        """The window of pictures with this one in it."""
        if self._pictures:
            now = np.stack([observation[key][-1] for key in (CLASS_KEY, DEPTH_KEY)]).reshape(1, *self._shape)
            # The first picture fills the window, as in `dataset._frame_windows`: learning and driving see the same.
            before = self._frames if len(self._frames) else np.repeat(now, self._pictures - 1, axis=0)
            self._frames = np.concatenate([before, now])[-self._pictures :]
        return self._frames

    def _require(self, observation: Observation) -> None:
        lacks = [key for key in _KEYS if key not in observation]
        if lacks or len(observation[IMU_KEY]) < TURNS.stop:
            what = f"no {', '.join(lacks)}" if lacks else f"{len(observation[IMU_KEY])} numbers of the IMU"
            raise PolicyError(
                f"a danger network got {what}; expected pictures with classes, tilt, turn rates, odometry, joystick: "
                "set sensors.odometry=typical, env.observe_gyro=true and env.classes as in its training"
            )
        shapes = {key: tuple(observation[key].shape[-2:]) for key in (DEPTH_KEY, CLASS_KEY)}
        if set(shapes.values()) != {self._shape[1:]}:
            raise PolicyError(
                f"a danger network got pictures of {shapes}; expected {self._shape[1:]} (rows, columns): test it with "
                "the camera of its training"
            )

    def _vector(self, observation: Observation, later_s: float) -> F32:
        imu, motion = observation[IMU_KEY], self.around.ego.motion
        vector: F64 = np.concatenate(
            # Tilts are a few hundredths of the half turn that is 1 in the observation.
            [10.0 * imu[TILT], imu[TURNS], motion / FULL_MOTION, [later_s], self._sent.reshape(-1)]
        )
        # A fault of a sensor must not carry the network beyond what it has learned from.
        return np.clip(vector, -2.0, 2.0).astype(np.float32)
