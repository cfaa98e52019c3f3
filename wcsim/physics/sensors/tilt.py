"""How a chair knows its tilt: ideally, from where the accelerometer feels down, or from that and the gyroscope.

Roll is right side down positive, pitch nose up positive. An accelerometer cannot tell gravity from braking: at 1.5 m/s2
it sees the nose 8.7 degrees down. The complementary filter turns with the gyroscope and follows the accelerometer
slowly, so a short braking moves it less.
"""

from __future__ import annotations

import math

from wcsim.config import ImuConfig
from wcsim.core.frames import rad
from wcsim.types import F64

Tilt = tuple[float, float]  # roll, pitch
_UPRIGHT = 1e-3  # cosine of the pitch below which roll and yaw cannot be told apart


def tilt_felt(force_B_mps2: F64) -> Tilt:
    """Roll and pitch of something at rest that feels this specific force (3,).

    >>> import numpy as np
    >>> roll, pitch = tilt_felt(np.array([-1.5, 0.0, 9.81]))
    >>> roll, round(math.degrees(pitch), 1)
    (0.0, -8.7)
    """
    x, y, z = (float(part) for part in force_B_mps2)
    return math.atan2(y, z), math.atan2(x, math.hypot(y, z))


def tilt_turned(tilt: Tilt, w_B_radps: F64, dt_s: float) -> Tilt:
    """Roll and pitch after turning for a short time."""
    roll, pitch = tilt
    p, q, r = (float(part) for part in w_B_radps)
    slope = math.sin(pitch) / max(math.cos(pitch), _UPRIGHT)
    across = q * math.sin(roll) + r * math.cos(roll)
    return roll + dt_s * (p - across * slope), pitch - dt_s * (q * math.cos(roll) - r * math.sin(roll))


class TiltSensor:
    """The tilt sensor of one chair in the configured mode.

    Args:
        config: Mode, time constant and errors.
    """

    def __init__(self, config: ImuConfig) -> None:
        self._config = config
        self._bias: Tilt = (0.0, 0.0)
        self._now: Tilt | None = None

    def start(self, drawn: F64) -> None:
        """Begin an episode with a mounting error; `drawn` (2,) is standard normal, zero for none."""
        scale = rad(self._config.tilt_bias_deg)
        self._bias = (scale * float(drawn[0]), scale * float(drawn[1]))
        self._now = None

    def reset(self) -> None:
        """Forget how the chair stood."""
        self._now = None

    def read(self, true: Tilt, force_B_mps2: F64, w_B_radps: F64, dt_s: float, drawn: F64) -> Tilt:
        """What the sensor says at the end of a tick.

        Args:
            true: Roll and pitch.
            force_B_mps2: (3,) tick mean of the accelerometer, gravity included.
            w_B_radps: (3,) tick mean of the gyroscope.
            dt_s: Length of the tick, 0 when there was none.
            drawn: (2,) standard normal, zero for no noise.
        """
        roll, pitch = self._felt(true, force_B_mps2, w_B_radps, dt_s, drawn)
        most = rad(self._config.tilt_range_deg)
        return min(max(roll, -most), most), min(max(pitch, -most), most)

    def _felt(self, true: Tilt, force_B_mps2: F64, w_B_radps: F64, dt_s: float, drawn: F64) -> Tilt:
        """What it would say without a range."""
        if self._config.tilt == "ideal":
            return true
        felt = tilt_felt(force_B_mps2)
        if self._config.tilt == "complementary" and self._now is not None:
            ahead = tilt_turned(self._now, w_B_radps, dt_s)
            share = 1.0 - math.exp(-dt_s / self._config.tilt_tau_s)
            turn = math.remainder(felt[0] - ahead[0], 2.0 * math.pi)  # the short way round
            felt = (math.remainder(ahead[0] + share * turn, 2.0 * math.pi), ahead[1] + share * (felt[1] - ahead[1]))
        self._now = felt
        scale = rad(self._config.tilt_noise_deg)
        return (
            felt[0] + self._bias[0] + scale * float(drawn[0]),
            felt[1] + self._bias[1] + scale * float(drawn[1]),
        )
