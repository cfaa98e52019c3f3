"""Wheel odometry: how fast the encoders of the drive wheels say that the chair goes and turns.

With the wheels' turning w_l and w_r over a tick, their radii r_l and r_r and the track,
v = (r_l w_l + r_r w_r) / 2 and w = (r_r w_r - r_l w_l) / track, counter-clockwise. Radius and track
are those of the plant as configured. So odometry does not notice a wheel that slips, or is worn.
"""

import math
from collections import deque

import numpy as np

from wcsim.config import OdometryConfig
from wcsim.core.frames import deg2rad
from wcsim.physics.sensors.base import BodyMotion, Sensor
from wcsim.physics.sensors.pixel_noise import child, normals
from wcsim.types import F64


class Odometry(Sensor):
    """Encoders on both drive wheels of one chair.

    Args:
        config: Resolution, errors and delay.
        wheel_radius_m: Of the drive wheels, as the sensor believes.
        track_m: Between them.
        dt_s: Physics step.
    """

    def __init__(
        self, config: OdometryConfig, wheel_radius_m: float, track_m: float, dt_s: float
    ) -> None:
        self._config = config
        self._nominal_m = wheel_radius_m
        self._track_m = track_m
        self._dt_s = dt_s
        self._per_rad = config.ticks_per_turn / (2.0 * math.pi)
        self._density = np.array([config.speed_density_mps, deg2rad(config.turn_density_deg)])
        self.start(None)
        self.reset(BodyMotion())

    def set_step(self, step_s: float) -> None:
        """See `Sensor`."""
        self._dt_s = step_s

    def start(self, noise_key: int | None) -> None:
        """Draw how wrong the radii of both wheels are in this episode."""
        drawn = np.zeros(2) if noise_key is None else normals(child(noise_key, 0), 2)
        self._radii_m = self._nominal_m * (1.0 + self._config.radius_error * drawn)

    def reset(self, motion: BodyMotion) -> None:
        """Stand still; what is under way because of the delay is lost."""
        self._wheel_rad = motion.wheel_rad
        self._counts = self._counted()
        self._steps = 0
        self._late = deque([np.zeros(2)] * self._config.delay_ticks)

    def sample(self, motion: BodyMotion) -> None:
        """Store how far the wheels have turned."""
        self._wheel_rad = motion.wheel_rad
        self._steps += 1

    def end_tick(self, noise_key: int | None) -> F64:
        """(2,) forward speed (m/s) and turn rate (rad/s) of the tick, or `delay_ticks` before."""
        before, self._counts = self._counts, self._counted()
        tick_s = self._steps * self._dt_s
        self._steps = 0
        now = np.zeros(2)
        if tick_s > 0.0:
            wheels_mps = self._radii_m * (self._counts - before) / (self._per_rad * tick_s)
            left_mps, right_mps = wheels_mps.tolist()
            now = np.array([0.5 * (left_mps + right_mps), (right_mps - left_mps) / self._track_m])
            if noise_key is not None:
                # A density: the longer the tick, the more of the noise is averaged away.
                now += self._density / math.sqrt(2.0 * tick_s) * normals(noise_key, 2)
        self._late.append(now)
        return self._late.popleft()

    def _counted(self) -> F64:
        """(2,) whole marks that have passed by the encoders: left, right."""
        # Whole marks only: the rest of a turn shows in the next tick, as with a real encoder.
        counts: F64 = np.floor(np.array(self._wheel_rad) * self._per_rad)
        return counts
