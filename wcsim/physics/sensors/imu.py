"""The inertial sensor of one chair.

The accelerometer feels the specific force at its mount, R^T (dv/dt - g), sampled every substep. Per
tick it gives the mean (gravity included) and, per axis, the largest magnitude of the same signal
without gravity behind two first-order low-passes in a row. The raw difference quotient is an
artefact of the step (a wall gives 92, 181 and 358 m/s2 at 120, 240 and 480 Hz), the low-passed peak
is not. Noise is on what the agent sees (means, turn rates, tilt), not on the peak.

A chair knows its tilt ideally, from where the accelerometer feels down, or from that and the
gyroscope. Roll is right side down positive, pitch nose up positive. An accelerometer cannot
distinguish gravity from braking: at 1.5 m/s2 it sees the nose 8.7 degrees down. The complementary
filter turns with the gyroscope and follows the accelerometer slowly, so a short braking moves it
less.
"""

import math
from typing import cast

import numpy as np

from wcsim.config import ImuConfig
from wcsim.core.constants import GRAVITY_MPS2
from wcsim.core.frames import Rotation, Vec3, deg2rad, rpy_from_matrix
from wcsim.core.jit import compile_exact_kernel
from wcsim.errors import PhysicsError
from wcsim.physics.sensors.base import BodyMotion, Sensor
from wcsim.physics.sensors.camera_geometry import turn_of
from wcsim.physics.sensors.pixel_noise import child, normals
from wcsim.types import F64, ImuFrame

Tilt = tuple[float, float]  # roll, pitch
_UPRIGHT = 1e-3  # cosine of the pitch below which roll and yaw are one turn
ROW = 15  # numbers of a substep: rotation R_WB row by row, velocity and angular velocity in W
STATE = 9  # velocity of the mount in W, the two stages of the low-pass
RESULT = 12  # see `_filter_tick`
STANDARD_GRAVITY_MPS2 = 9.80665  # the g of data sheets
_DRAWS = 14  # of a tick: accelerometer 3, gyroscope 3, drift of each 3, tilt 2


class Imu(Sensor):
    """Accelerometer, gyroscope and tilt sensor at one mount.

    Args:
        config: Mount, filter, range and noise.
        com_B_m: The point in B that has the velocity of `sample`.
        dt_s: Physics step.
    """

    def __init__(self, config: ImuConfig, com_B_m: Vec3, dt_s: float) -> None:
        self._config = config
        self._arm_B_m = np.array(config.p_BI_m) - np.array(com_B_m)
        self.set_step(dt_s)
        self._felt_mps2 = GRAVITY_MPS2 if config.gravity == "included" else 0.0
        self._errors = _Errors(config)
        self._tilt = _TiltSensor(config)
        # None costs nothing.
        self._R_BS = None
        if any(config.rpy_deg):
            roll, pitch, yaw = map(deg2rad, config.rpy_deg)
            self._R_BS = turn_of(yaw, pitch, roll)
        self._low = np.zeros((0, 3))
        self.reset(BodyMotion())

    @property
    def lowpass_mps2(self) -> F64:
        """The low-passed signal after each substep of the last closed tick, (n, 3)."""
        return self._low

    def set_step(self, step_s: float) -> None:
        """See `Sensor`."""
        self._dt_s = step_s
        # Exact for a held input: the cut-off stays where it is with any physics step.
        self._alpha = 1.0 - math.exp(-2.0 * math.pi * self._config.lowpass_hz * step_s)

    def start(self, noise_key: int | None) -> None:
        """Switch on for an episode: draw the biases that stay through it, none without a key."""
        if not self._config.noise:
            noise_key = None
        self._errors.start(noise_key)
        self._tilt.start(np.zeros(2) if noise_key is None else normals(child(noise_key, 1), 2))

    def reset(self, motion: BodyMotion) -> None:
        """Stand still as it is turned: no velocity, quiet filters, a tick of no samples."""
        self._rotation = motion.rotation
        self._state = np.zeros(STATE)
        # The filters have settled on gravity: from zero each episode would begin with a swing.
        self._state[3:6] = self._state[6:9] = self._felt_mps2 * np.array(self._rotation[6:9])
        self._tilt.reset()
        self._rows: list[float] = []

    def sample(self, motion: BodyMotion) -> None:
        """Take the motion after a physics step into the tick."""
        # Stored and no more, as it is called every substep.
        self._rotation = motion.rotation
        self._rows += motion.rotation
        self._rows += motion.v_com_W_mps
        self._rows += motion.w_W_radps

    def sample_rows(self, rows: F64, wheel_rad: tuple[float, float]) -> None:
        """See `Sensor`."""
        self._rotation = cast(Rotation, tuple(rows[-1, :9].tolist()))
        self._rows += rows.ravel().tolist()

    def end_tick(self, noise_key: int | None) -> ImuFrame:
        """Close the tick: means, peaks and tilt of its samples.

        `noise_key` (64 bits) selects the noise; without a key there is none.

        Raises:
            PhysicsError: The motion left the finite numbers.
        """
        # 1. Filter the samples.
        config, felt = self._config, self._felt_mps2
        rows = np.array(self._rows, np.float64).reshape(-1, ROW)
        self._rows = []
        count = len(rows)
        self._low = np.empty((count, 3))
        sums = _filter_tick(
            rows,
            self._state,
            self._arm_B_m,
            1.0 / self._dt_s,
            GRAVITY_MPS2,
            felt,
            self._alpha,
            self._low,
        )
        # One number that is not finite makes the sum so: a single test serves all.
        if not math.isfinite(sums.sum()):
            raise PhysicsError(
                "the wheelchair's motion is not finite; expected finite numbers: rebuild the world"
            )

        # 2. Means and peak in B. A chair that was just placed has no samples: it stands.
        means = sums / max(count, 1)
        accel, gravity, gyro = means[0:3], means[3:6], means[9:12]
        peak = sums[6:9]
        if count == 0:
            gravity = GRAVITY_MPS2 * np.array(self._rotation[6:9])
            peak = np.abs(self._state[6:9])
        if config.accel_window == "tick_mean":
            peak = np.abs(accel + gravity if felt else accel)

        # 3. In the sensor's frame: row vectors of B. The peak, which is judged, stays in B.
        roll, pitch, yaw = rpy_from_matrix(self._rotation)
        if self._R_BS is not None:
            accel = accel @ self._R_BS
            gravity = gravity @ self._R_BS
            gyro = gyro @ self._R_BS
            turned = np.array(self._rotation).reshape(3, 3) @ self._R_BS
            roll, pitch, _ = rpy_from_matrix(cast(Rotation, tuple(turned.ravel().tolist())))

        # 4. Errors.
        tick_s = count * self._dt_s
        key = noise_key if config.noise else None
        force, gyro, drawn = self._errors.on(accel + gravity, gyro, tick_s, key)
        roll, pitch = self._tilt.read((roll, pitch), force, gyro, tick_s, drawn)
        return ImuFrame(
            accel_mean_mps2=force if config.mean_gravity == "included" else force - gravity,
            accel_peak_mps2=_clipped(peak, config.saturation_mps2),
            gyro_radps=gyro,
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
        )


def _tilt_felt(force_B_mps2: F64) -> Tilt:
    """Roll and pitch of something at rest that feels this specific force (3,).

    >>> import numpy as np
    >>> roll, pitch = _tilt_felt(np.array([-1.5, 0.0, 9.81]))
    >>> roll, round(math.degrees(pitch), 1)
    (0.0, -8.7)
    """
    x, y, z = force_B_mps2.tolist()
    return math.atan2(y, z), math.atan2(x, math.hypot(y, z))


def _tilt_turned(tilt: Tilt, w_B_radps: F64, dt_s: float) -> Tilt:
    """Roll and pitch after turning for a short time."""
    roll, pitch = tilt
    p, q, r = w_B_radps.tolist()
    slope = math.sin(pitch) / max(math.cos(pitch), _UPRIGHT)
    across = q * math.sin(roll) + r * math.cos(roll)
    down = q * math.cos(roll) - r * math.sin(roll)
    return roll + dt_s * (p - across * slope), pitch - dt_s * down


class _TiltSensor:
    """The tilt sensor of one chair in the configured mode.

    Args:
        config: Mode, time constant and errors.
    """

    def __init__(self, config: ImuConfig) -> None:
        self._config = config
        self._bias: Tilt = (0.0, 0.0)
        self._now: Tilt | None = None

    def start(self, drawn: F64) -> None:
        """Begin an episode with a mounting error; `drawn` (2,) is standard normal, 0 for none."""
        roll, pitch = (deg2rad(self._config.tilt_bias_deg) * drawn).tolist()
        self._bias = roll, pitch
        self._now = None

    def reset(self) -> None:
        """Forget how the chair stood."""
        self._now = None

    def read(self, true: Tilt, force_B_mps2: F64, w_B_radps: F64, dt_s: float, drawn: F64) -> Tilt:
        """Roll and pitch as measured at the end of a tick.

        Args:
            true: Roll and pitch.
            force_B_mps2: (3,) tick mean of the accelerometer, gravity included.
            w_B_radps: (3,) tick mean of the gyroscope.
            dt_s: Length of the tick, 0 when there was none.
            drawn: (2,) standard normal, zero for no noise.
        """
        config = self._config
        roll, pitch = true
        if config.tilt != "ideal":
            roll, pitch = _tilt_felt(force_B_mps2)
            # The first reading has nothing to start from: it is the accelerometer's alone.
            if config.tilt == "complementary" and self._now is not None:
                roll_ahead, pitch_ahead = _tilt_turned(self._now, w_B_radps, dt_s)
                # The exact step of a first-order filter: its time constant does not depend on the
                # tick. Roll goes the short way round.
                share = 1.0 - math.exp(-dt_s / config.tilt_tau_s)
                turn = math.remainder(roll - roll_ahead, math.tau)
                roll = math.remainder(roll_ahead + share * turn, math.tau)
                pitch = pitch_ahead + share * (pitch - pitch_ahead)
            self._now = roll, pitch
            roll_noise, pitch_noise = (deg2rad(config.tilt_noise_deg) * drawn).tolist()
            roll = roll + self._bias[0] + roll_noise
            pitch = pitch + self._bias[1] + pitch_noise
        most = deg2rad(config.tilt_range_deg)
        return min(max(roll, -most), most), min(max(pitch, -most), most)


class _Errors:
    """White noise, turn-on bias and drifting bias of accelerometer and gyroscope.

    White noise of density N (per root hertz) has the standard deviation N / sqrt(2 T) in a mean
    over T seconds. The drift is a Gauss-Markov process that is stationary from its start.
    """

    def __init__(self, config: ImuConfig) -> None:
        # (6,) each: three of the accelerometer, three of the gyroscope.
        mg, deg = 1e-3 * STANDARD_GRAVITY_MPS2, deg2rad(1.0)
        density = 1e-3 * mg * config.accel_density_ug, deg * config.gyro_density_deg
        drift = mg * config.accel_instability_mg, deg * config.gyro_instability_deg
        self._tau_s = config.bias_tau_s
        self._density = np.repeat(density, 3)
        self._turn_on = np.repeat([mg * config.accel_bias_mg, deg * config.gyro_bias_deg], 3)
        self._drift = np.repeat(drift, 3)
        self._most_mps2 = config.saturation_mps2
        self._most_radps = deg2rad(config.gyro_range_deg)
        self.start(None)

    def start(self, noise_key: int | None) -> None:
        """Draw the biases of an episode."""
        drawn = np.zeros(12) if noise_key is None else normals(child(noise_key, 0), 12)
        self._bias = self._turn_on * drawn[:6]
        self._drifted = self._drift * drawn[6:]

    def on(
        self, force_mps2: F64, gyro_radps: F64, tick_s: float, noise_key: int | None
    ) -> tuple[F64, F64, F64]:
        """Force and turn rate as measured, and two standard normal numbers for the tilt sensor."""
        drawn = np.zeros(_DRAWS)
        if noise_key is not None:
            drawn = normals(noise_key, _DRAWS)
            # The exact step of the process: its spread does not depend on the length of a tick.
            stays = math.exp(-tick_s / self._tau_s)
            fresh = math.sqrt(1.0 - stays * stays) * self._drift * drawn[6:12]
            self._drifted = stays * self._drifted + fresh
            error = self._bias + self._drifted
            if tick_s > 0.0:
                error += self._density / math.sqrt(2.0 * tick_s) * drawn[:6]
            force_mps2 = force_mps2 + error[:3]
            gyro_radps = gyro_radps + error[3:]
        force_mps2 = _clipped(force_mps2, self._most_mps2)
        return force_mps2, _clipped(gyro_radps, self._most_radps), drawn[12:]


def _clipped(vector: F64, limit: float) -> F64:
    return np.minimum(np.maximum(vector, -limit), limit)


@compile_exact_kernel
def _filter_tick(
    rows: F64,
    state: F64,
    arm_B_m: F64,
    per_s: float,
    gravity_mps2: float,
    felt_mps2: float,
    alpha: float,
    low: F64,
) -> F64:
    """Specific force, its low-passed peak and the turn rate at the mount.

    Args:
        rows: (n, ROW) the motion after each substep.
        state: (STATE,) carried from tick to tick, updated in place.
        arm_B_m: (3,) from the point whose velocity is given to the mount.
        per_s: Substeps per second.
        gravity_mps2: Gravity in the mean.
        felt_mps2: Gravity in the low-passed signal, 0 to leave it out.
        alpha: Share of a step that each stage of the low-pass goes.
        low: (n, 3) takes the low-passed signal.

    Returns:
        (RESULT,) sums of acceleration 0:3, gravity 3:6, turn rate 9:12; peak magnitude 6:9.
    """
    out = np.zeros(RESULT)
    v_W = np.empty(3)
    a_W = np.empty(3)
    for n in range(len(rows)):
        row = rows[n]
        x = row[0] * arm_B_m[0] + row[1] * arm_B_m[1] + row[2] * arm_B_m[2]
        y = row[3] * arm_B_m[0] + row[4] * arm_B_m[1] + row[5] * arm_B_m[2]
        z = row[6] * arm_B_m[0] + row[7] * arm_B_m[1] + row[8] * arm_B_m[2]
        v_W[0] = row[9] + row[13] * z - row[14] * y
        v_W[1] = row[10] + row[14] * x - row[12] * z
        v_W[2] = row[11] + row[12] * y - row[13] * x
        for k in range(3):
            a_W[k] = (v_W[k] - state[k]) * per_s
            state[k] = v_W[k]
        for k in range(3):
            a_B = row[k] * a_W[0] + row[3 + k] * a_W[1] + row[6 + k] * a_W[2]
            state[3 + k] += alpha * (a_B + row[6 + k] * felt_mps2 - state[3 + k])
            state[6 + k] += alpha * (state[3 + k] - state[6 + k])
            low[n, k] = state[6 + k]
            out[k] += a_B
            out[3 + k] += row[6 + k] * gravity_mps2
            out[6 + k] = max(out[6 + k], abs(state[6 + k]))
            out[9 + k] += row[k] * row[12] + row[3 + k] * row[13] + row[6 + k] * row[14]
    return out
