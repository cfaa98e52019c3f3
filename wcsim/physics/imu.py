"""The inertial sensor of one chair.

The accelerometer feels the specific force at its mount, R^T (dv/dt - g), sampled every substep. Per tick it says the
mean (gravity included) and, per axis, the largest magnitude of the same signal without gravity behind two first-order
low-passes in a row. The raw difference quotient is an artefact of the step (a wall gives 92, 181 and 358 m/s2 at 120,
240 and 480 Hz), the low-passed peak is not.
"""

from __future__ import annotations

import math

import numpy as np

from wcsim.config import ImuConfig
from wcsim.errors import PhysicsError
from wcsim.physics.pose import LEVEL, Rotation, euler, rotate, rotate_back, velocity_at
from wcsim.types import F64, ImuFrame

Vec3 = tuple[float, float, float]
_ZERO: Vec3 = (0.0, 0.0, 0.0)


class Imu:
    """Accelerometer, gyroscope and ideal tilt sensor at one mount.

    Args:
        config: Mount, filter, range and noise.
        com_B_m: The point in B whose velocity `sample` is given.
        dt_s: Physics step.
        gravity_mps2: Magnitude of gravity.
    """

    def __init__(self, config: ImuConfig, com_B_m: Vec3, dt_s: float, gravity_mps2: float) -> None:
        self._config = config
        mount = config.p_BI_m
        self._arm_B_m: Vec3 = (mount[0] - com_B_m[0], mount[1] - com_B_m[1], mount[2] - com_B_m[2])
        self._per_s = 1.0 / dt_s
        self._gravity_mps2 = gravity_mps2
        self._alpha = 1.0 - math.exp(-2.0 * math.pi * config.lowpass_hz * dt_s)
        self._force_sum = self._gyro_sum = self._peak = _ZERO
        self._samples = 0
        self.reset(LEVEL)

    def reset(self, rotation: Rotation) -> None:
        """Stand still at rotation R_WB: no velocity, quiet filters, a tick of no samples."""
        self._rotation = rotation
        self._v_W_mps: Vec3 = _ZERO
        self._stage1: Vec3 = _ZERO
        self._stage2: Vec3 = _ZERO
        self._begin_tick()

    def sample(self, rotation: Rotation, v_com_W_mps: Vec3, w_W_radps: Vec3) -> None:
        """Take the motion after a physics step into the tick."""
        arm_W_m = rotate(rotation, *self._arm_B_m)
        vx, vy, vz = velocity_at(arm_W_m, _ZERO, v_com_W_mps, w_W_radps)
        ox, oy, oz = self._v_W_mps
        k = self._per_s
        ax, ay, az = rotate_back(rotation, (vx - ox) * k, (vy - oy) * k, (vz - oz) * k)
        self._v_W_mps = (vx, vy, vz)
        self._rotation = rotation
        self._filter(ax, ay, az)
        g = self._gravity_mps2
        sx, sy, sz = self._force_sum
        self._force_sum = (sx + ax + rotation[6] * g, sy + ay + rotation[7] * g, sz + az + rotation[8] * g)
        gx, gy, gz = rotate_back(rotation, *w_W_radps)
        tx, ty, tz = self._gyro_sum
        self._gyro_sum = (tx + gx, ty + gy, tz + gz)
        self._samples += 1

    def end_tick(self, rng: np.random.Generator | None) -> ImuFrame:
        """Close the tick: means, peaks and tilt of its samples, noise on the means when `rng` is given.

        Raises:
            PhysicsError: The motion left the finite numbers.
        """
        config = self._config
        n = max(self._samples, 1)
        mean, gyro = np.array(self._force_sum) / n, np.array(self._gyro_sum) / n
        if self._samples == 0:  # a chair that was just placed: it stands
            mean = self._gravity_mps2 * np.array(self._rotation[6:9])
        peak = np.array(self._peak)
        if not np.isfinite([*mean, *peak, *gyro]).all():
            raise PhysicsError("the wheelchair's motion left the finite numbers; expected finite: rebuild the world")
        if rng is not None:
            mean += rng.normal(0.0, config.accel_noise_mps2, 3)
            gyro += rng.normal(0.0, config.gyro_noise_radps, 3)
        roll, pitch, yaw = euler(self._rotation)
        self._begin_tick()
        return ImuFrame(
            accel_mean_mps2=_clipped(mean, config.saturation_mps2),
            accel_peak_mps2=_clipped(peak, config.saturation_mps2),
            gyro_radps=gyro,
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
        )

    def _begin_tick(self) -> None:
        self._force_sum = self._gyro_sum = self._peak = _ZERO
        self._samples = 0

    def _filter(self, ax: float, ay: float, az: float) -> None:
        k = self._alpha
        x, y, z = self._stage1
        x, y, z = x + k * (ax - x), y + k * (ay - y), z + k * (az - z)
        self._stage1 = (x, y, z)
        u, v, w = self._stage2
        u, v, w = u + k * (x - u), v + k * (y - v), w + k * (z - w)
        self._stage2 = (u, v, w)
        px, py, pz = self._peak
        self._peak = (max(px, abs(u)), max(py, abs(v)), max(pz, abs(w)))


def _clipped(vector: F64, limit: float) -> F64:
    return np.asarray(np.clip(vector, -limit, limit))
