"""The errors of the IMU: white noise by its density, biases, drift, and their keys."""

import math

import numpy as np
import pytest

from wcsim.config import ImuConfig
from wcsim.core.frames import LEVEL
from wcsim.physics.sensors.base import BodyMotion
from wcsim.physics.sensors.imu import STANDARD_GRAVITY_MPS2, Imu
from wcsim.physics.sensors.pixel_noise import child

STILL = (0.0, 0.0, 0.0)
EXACT = {"accel_density_ug": 0.0, "gyro_density_deg": 0.0, "accel_bias_mg": 0.0, "gyro_bias_deg": 0.0}
EXACT |= {"accel_instability_mg": 0.0, "gyro_instability_deg": 0.0}
MG = 1e-3 * STANDARD_GRAVITY_MPS2


def readings(ticks: int, episode: int = 1, key: int = 7, tick_s: float = 0.1, **config) -> np.ndarray:
    """(ticks, 6) errors of accelerometer and gyroscope at rest; one sample a tick, because nothing moves."""
    sensor = Imu(ImuConfig(**{**EXACT, **config}), (0.18, 0.0, 0.5), tick_s)
    sensor.start(episode)
    out = np.empty((ticks, 6))
    for tick in range(ticks):
        sensor.sample(BodyMotion(LEVEL, STILL, STILL))
        frame = sensor.end_tick(child(key, tick))
        out[tick] = np.r_[frame.accel_mean_mps2 - (0.0, 0.0, 9.81), frame.gyro_radps]
    return out


@pytest.mark.parametrize("tick_s", [0.1, 0.05])
def test_white_noise_has_its_density(tick_s):
    got = readings(4000, tick_s=tick_s, accel_density_ug=300.0, gyro_density_deg=0.005).std(axis=0)
    bandwidth = math.sqrt(0.5 / tick_s)  # a mean over T passes 1 / (2 T)
    assert got[:3] == pytest.approx(np.full(3, 300e-6 * STANDARD_GRAVITY_MPS2 * bandwidth), rel=0.05)
    assert got[3:] == pytest.approx(np.full(3, math.radians(0.005) * bandwidth), rel=0.05)


def test_a_bias_stays_through_an_episode_and_is_another_in_the_next():
    one = readings(5, accel_bias_mg=20.0, gyro_bias_deg=0.5)
    assert (one == one[0]).all() and (one[0] != 0.0).all()
    drawn = np.array([readings(1, episode=e, accel_bias_mg=20.0, gyro_bias_deg=0.5)[0] for e in range(600)])
    assert drawn.std(axis=0) == pytest.approx(np.r_[np.full(3, 20 * MG), np.full(3, math.radians(0.5))], rel=0.1)
    assert np.abs(np.corrcoef(drawn.T) - np.eye(6)).max() < 0.15


def test_the_drift_forgets_itself_in_its_time_constant():
    drift = readings(40_000, accel_instability_mg=10.0, gyro_instability_deg=0.1, bias_tau_s=5.0)
    assert drift.std(axis=0) == pytest.approx(np.r_[np.full(3, 10 * MG), np.full(3, math.radians(0.1))], rel=0.1)
    for lag_s in (2.5, 5.0):
        lag = round(lag_s / 0.1)
        kept = (drift[:-lag] * drift[lag:]).mean(axis=0) / drift.var(axis=0)
        assert kept == pytest.approx(np.full(6, math.exp(-lag_s / 5.0)), abs=0.1)


def test_noise_depends_on_its_keys_alone():
    noisy = {"accel_density_ug": 300.0, "gyro_density_deg": 0.005, "accel_bias_mg": 5.0, "accel_instability_mg": 1.0}
    first = readings(20, **noisy)
    assert (readings(20, **noisy) == first).all()
    assert (readings(20, key=8, **noisy) != first)[:, :3].all()
    assert (readings(20, episode=2, **noisy) != first)[:, :3].all()


def test_without_noise_a_key_changes_no_bit():
    def ride(noise: bool, key: int | None) -> bytes:
        sensor = Imu(ImuConfig(noise=noise, tilt="complementary"), (0.1, 0.0, 0.4), 1 / 240)
        sensor.start(key)
        out = b""
        for tick in range(5):
            for k in range(24):
                sensor.sample(BodyMotion(LEVEL, (math.sin(tick + k / 24), 0.1, 0.0), (0.0, 0.1 * k, 0.2)))
            frame = sensor.end_tick(None if key is None else child(key, tick))
            out += np.r_[frame.accel_mean_mps2, frame.accel_peak_mps2, frame.gyro_radps].tobytes()
            out += np.array([frame.roll_rad, frame.pitch_rad]).tobytes()
        return out

    assert ride(False, 3) == ride(False, None) == ride(True, None)
    assert ride(True, 3) != ride(False, 3)
