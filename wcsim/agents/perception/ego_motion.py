"""How a chair moves by its own senses: wheel odometry and turn rates, else its own commands.

Its place is in the odometric frame O, which starts at the chair's first place in the episode, x
ahead, y left. It drifts as the senses do.
"""

import math
from collections import deque
from typing import Final

import numpy as np

from wcsim.agents.perception.arcs import integrate_drive_motion
from wcsim.agents.policy_api import IMU_KEY, ODOMETRY_KEY, Observation
from wcsim.core.joystick import target_speeds
from wcsim.types import F64

# Of odometry and turn rates in an observation, in m/s and rad/s.
SPEED_FULL_SCALE: Final = 4.0
TURN_FULL_SCALE: Final = 4.0
GYRO_Z: Final = 7  # in the IMU vector with turn rates, behind acceleration and tilt
# Sizes of an IMU vector with turn rates, without and with the heading.
_GYRO_SIZES: Final = (8, 10)
# Weight of a tick's measured mean against the drive's law.
TRUST: Final = 0.8
MOVES_MPS: Final = 0.05  # slower is standing


class EgoMotionEstimator:
    """Speed, turn rate and place of one chair from tick to tick, and the commands on their way.

    Args:
        limits: (8,) of the drive, see `wcsim.core.joystick`.
        tick_s: Time between two observations.
        delay_ticks: From a command to the chair that obeys it; a new value holds from `reset` on.
    """

    def __init__(self, limits: F64, tick_s: float, delay_ticks: int) -> None:
        self._limits, self._tick_s, self.delay_ticks = limits, tick_s, delay_ticks
        self.reset()

    def reset(self) -> None:
        """Stand still at the origin of O; nothing is on its way."""
        self.motion = np.zeros(3)  # v in m/s, w in rad/s, acceleration in m/s^2: now
        self.pose_O = np.zeros(3)  # x, y in m, yaw in rad
        self.way_m = 0.0  # driven in this episode, forwards or back
        self._waiting = deque[F64]()
        self._started = False

    @property
    def waiting(self) -> F64:
        """(M, 2) shaped commands that the chair obeys before the next one, one a tick."""
        return np.array(self._waiting, np.float64).reshape(-1, 2)

    def observe(self, observation: Observation, user_stick: F64) -> None:
        """Take the observation of a new tick.

        Args:
            observation: What the chair senses now.
            user_stick: (2,) shaped. A chair that moves already in the first tick obeyed it so far.
        """
        speed_mps, turn_radps = _measured(observation)
        # 1. The first tick of an episode starts from what is measured.
        if not self._started:
            self._started = True
            if speed_mps is None:
                # The user's stick alone tells the speed: assume that it is reached.
                self.motion[:2] = target_speeds(user_stick[0], user_stick[1], 0.0, self._limits)
            else:
                self.motion[0] = speed_mps
            if turn_radps is not None:
                self.motion[1] = turn_radps
            moves = speed_mps is None or abs(speed_mps) > MOVES_MPS
            self._waiting.extend([user_stick if moves else np.zeros(2)] * self.delay_ticks)
            return
        # 2. A later tick: the drive's law, corrected towards what is measured.
        before = self.motion.copy()
        integrate_drive_motion(self.motion, self._waiting.popleft(), self._limits, self._tick_s)
        mean = 0.5 * (before[:2] + self.motion[:2])
        for index, measured in enumerate((speed_mps, turn_radps)):
            if measured is not None:
                self.motion[index] += TRUST * (measured - mean[index])
                mean[index] = measured
        mean_speed_mps, mean_turn_radps = mean.tolist()
        way_m, turn = mean_speed_mps * self._tick_s, mean_turn_radps * self._tick_s
        heading = self.pose_O[2] + 0.5 * turn
        self.pose_O += way_m * math.cos(heading), way_m * math.sin(heading), turn
        self.way_m += abs(way_m)

    def command(self, shaped: F64) -> None:
        """Take the command (2,) that is sent now."""
        self._waiting.append(shaped)


def _measured(observation: Observation) -> tuple[float | None, float | None]:
    """Speed and turn rate of the last tick; None for what is not in the observation."""
    speed_mps = turn_radps = None
    if ODOMETRY_KEY in observation:
        speed, turn = observation[ODOMETRY_KEY]
        speed_mps = float(speed) * SPEED_FULL_SCALE
        turn_radps = float(turn) * TURN_FULL_SCALE
    imu = observation[IMU_KEY]
    if len(imu) in _GYRO_SIZES:
        turn_radps = float(imu[GYRO_Z]) * TURN_FULL_SCALE
    return speed_mps, turn_radps


def odometric_to_body(points_O_m: F64, pose_O: F64) -> F64:
    """Points (n, 2) of O in B, the frame of a chair at a pose (x, y, yaw)."""
    cos, sin = math.cos(pose_O[2]), math.sin(pose_O[2])
    turned: F64 = (points_O_m - pose_O[:2]) @ np.array([[cos, -sin], [sin, cos]])
    return turned


def body_to_odometric(points_B_m: F64, pose_O: F64) -> F64:
    """Points (n, 2) of B in O, with the chair at a pose (x, y, yaw)."""
    cos, sin = math.cos(pose_O[2]), math.sin(pose_O[2])
    turned: F64 = points_B_m @ np.array([[cos, sin], [-sin, cos]])
    return turned + pose_O[:2]
