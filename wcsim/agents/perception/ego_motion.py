"""How a chair moves, as far as it can tell: wheel odometry and turn rates where it has them, else its own commands.

The place is in the odometric frame O: where the chair stood when the episode began, x ahead, y left. It drifts as the
senses do.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from wcsim.agents.perception.arcs import follow
from wcsim.agents.policy_api import IMU_KEY, ODOMETRY_KEY, Observation
from wcsim.core.joystick import target_speeds
from wcsim.types import F64

SPEED_FULL_SCALE, TURN_FULL_SCALE = 4.0, 4.0  # of odometry and turn rates in an observation
GYRO_Z = 7  # in the IMU vector with turn rates, behind acceleration and tilt
_GYRO_SIZES = (8, 10)  # of an IMU vector that has turn rates, without and with the heading
TRUST = 0.8  # in what is measured, of a tick's mean, against what the drive's law says
MOVES_MPS = 0.05


class EgoMotion:
    """Speed, turn rate and place of one chair from tick to tick, and the commands that are on their way to it.

    Args:
        limits: (8,) of the drive, see `wcsim.core.joystick`.
        tick_s: Time between two observations.
        delay_ticks: From a command to the chair that obeys it; another one holds from the next `reset` on.
    """

    def __init__(self, limits: F64, tick_s: float, delay_ticks: int) -> None:
        self._limits, self._tick_s, self.delay_ticks = limits, tick_s, delay_ticks
        self.reset()

    def reset(self) -> None:
        """Stand still at the origin of O; nothing is on its way."""
        self.motion = np.zeros(3)  # v in m/s, w in rad/s, acceleration in m/s^2: now
        self.pose_O = np.zeros(3)  # x, y in m, yaw in rad
        self.way_m = 0.0  # driven since the episode began, forwards or back
        self._waiting = deque[F64]()
        self._begun = False

    @property
    def waiting(self) -> F64:
        """(M, 2) shaped commands that the chair obeys before the next one, one a tick."""
        return np.array(self._waiting, np.float64).reshape(-1, 2)

    def observe(self, observation: Observation, asked: F64) -> None:
        """Take the observation of a new tick.

        Args:
            observation: What the chair senses now.
            asked: (2,) the user's stick, shaped: in a chair that moves already, who drove so far had it obeyed. Without
                odometry that is all that says how fast it moves when it is taken over.
        """
        speed_mps, turn_radps = _measured(observation)
        if not self._begun:
            self._begin(speed_mps, turn_radps, asked)
            return
        before = self.motion.copy()
        follow(self.motion, self._waiting.popleft(), self._limits, self._tick_s)
        mean = 0.5 * (before[:2] + self.motion[:2])
        for index, measured in enumerate((speed_mps, turn_radps)):
            if measured is not None:
                self.motion[index] += TRUST * (measured - mean[index])
                mean[index] = measured
        self._move(*mean.tolist())

    def command(self, shaped: F64) -> None:
        """Say which command (2,) is sent now."""
        self._waiting.append(shaped)

    def _begin(self, speed_mps: float | None, turn_radps: float | None, asked: F64) -> None:
        self._begun = True
        if (
            speed_mps is None
        ):  # then it has come to what its user asks for, as far as anybody can tell
            self.motion[:2] = target_speeds(asked[0], asked[1], 0.0, self._limits)
        else:
            self.motion[0] = speed_mps
        if turn_radps is not None:
            self.motion[1] = turn_radps
        moves = speed_mps is None or abs(speed_mps) > MOVES_MPS
        self._waiting.extend([asked if moves else np.zeros(2)] * self.delay_ticks)

    def _move(self, speed_mps: float, turn_radps: float) -> None:
        way_m, turn = speed_mps * self._tick_s, turn_radps * self._tick_s
        heading = self.pose_O[2] + 0.5 * turn
        self.pose_O += way_m * math.cos(heading), way_m * math.sin(heading), turn
        self.way_m += abs(way_m)


def _measured(observation: Observation) -> tuple[float | None, float | None]:
    """Speed and turn rate of the last tick; None for what is not in the observation."""
    speed_mps = turn_radps = None
    if ODOMETRY_KEY in observation:
        speed_mps, turn_radps = (
            float(value) * full
            for value, full in zip(
                observation[ODOMETRY_KEY], (SPEED_FULL_SCALE, TURN_FULL_SCALE), strict=True
            )
        )
    imu = observation[IMU_KEY]
    if len(imu) in _GYRO_SIZES:
        turn_radps = float(imu[GYRO_Z]) * TURN_FULL_SCALE
    return speed_mps, turn_radps


def in_body(points_O_m: F64, pose_O: F64) -> F64:
    """Points (n, 2) of O in B, the frame of a chair at a pose (x, y, yaw)."""
    cos, sin = math.cos(pose_O[2]), math.sin(pose_O[2])
    turned: F64 = (points_O_m - pose_O[:2]) @ np.array([[cos, -sin], [sin, cos]])
    return turned


def in_odometric(points_B_m: F64, pose_O: F64) -> F64:
    """Points (n, 2) of B in O, with the chair at a pose (x, y, yaw)."""
    cos, sin = math.cos(pose_O[2]), math.sin(pose_O[2])
    turned: F64 = points_B_m @ np.array([[cos, sin], [-sin, cos]])
    return turned + pose_O[:2]
