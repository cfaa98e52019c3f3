"""The tilt sensor: signs, what braking does to it, how it follows a real tilt, and its errors."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.config import ImuConfig
from wcsim.core.frames import LEVEL, integrate_quaternion, matrix_from_quaternion, quaternion_from_ypr, rpy_from_matrix
from wcsim.physics.sensors.base import BodyMotion
from wcsim.physics.sensors.imu import Imu, _tilt_felt, _tilt_turned, _TiltSensor
from wcsim.physics.sensors.pixel_noise import child

STILL = (0.0, 0.0, 0.0)
NONE = np.zeros(2)
angle = st.floats(-1.2, 1.2)


@given(angle, angle, st.floats(-3, 3))
def test_at_rest_gravity_gives_the_tilt(roll, pitch, yaw):
    rotation = matrix_from_quaternion(quaternion_from_ypr(yaw, pitch, roll))
    assert _tilt_felt(9.81 * np.array(rotation[6:9])) == pytest.approx(rpy_from_matrix(rotation)[:2], abs=1e-9)


@given(angle, angle, st.tuples(*[st.floats(-2, 2)] * 3))
def test_the_gyroscope_turns_the_tilt_as_the_body_turns(roll, pitch, w_B):
    q, dt_s = quaternion_from_ypr(0.4, pitch, roll), 1e-4
    r = np.array(matrix_from_quaternion(q)).reshape(3, 3)
    after = rpy_from_matrix(matrix_from_quaternion(integrate_quaternion(q, tuple(r @ w_B), dt_s)))
    assert _tilt_turned((roll, pitch), np.array(w_B), dt_s) == pytest.approx(after[:2], abs=5e-7)


def test_braking_fools_the_accelerometer_and_the_filter_slowly():
    resting, braking, pitch = np.array([0.0, 0.0, 9.81]), np.array([-1.5, 0.0, 9.81]), {}
    for mode in ("ideal", "accelerometer", "complementary"):
        sensor = _TiltSensor(ImuConfig(tilt=mode, tilt_tau_s=1.0))
        forces = [resting] + [braking] * 5 + [resting] * 30
        pitch[mode] = [math.degrees(sensor.read((0.0, 0.0), f, np.zeros(3), 0.1, NONE)[1]) for f in forces]
    assert not any(pitch["ideal"])
    assert pitch["accelerometer"][5] == pytest.approx(-8.7, abs=0.05) and pitch["accelerometer"][6] == 0.0
    assert pitch["complementary"][5] == pytest.approx(-8.69 * (1 - math.exp(-0.5)), abs=0.05)
    assert abs(pitch["complementary"][-1]) < 0.2


def test_the_filter_follows_a_real_tilt_at_once():
    sensor = _TiltSensor(ImuConfig(tilt="complementary"))
    sensor.read((0.0, 0.0), np.array([0.0, 0.0, 9.81]), np.zeros(3), 0.0, NONE)
    for k in range(1, 6):  # 10 degrees nose up and 5 to the right in half a second
        truth = (math.radians(1.0 * k), math.radians(2.0 * k))
        rotation = matrix_from_quaternion(quaternion_from_ypr(0.0, truth[1], truth[0]))
        rate = np.array([math.radians(10.0), -math.radians(20.0), 0.0])
        got = sensor.read(truth, 9.81 * np.array(rotation[6:9]), rate, 0.1, NONE)
        assert got == pytest.approx(truth, abs=math.radians(0.3))


def test_a_chair_on_its_back_does_not_confuse_the_filter():
    sensor = _TiltSensor(ImuConfig(tilt="complementary"))
    for roll in (math.radians(178), math.radians(-178), math.radians(178)):
        force = 9.81 * np.array([0.0, math.sin(roll), math.cos(roll)])
        got = sensor.read((roll, 0.0), force, np.zeros(3), 0.1, NONE)
        assert abs(abs(got[0]) - math.pi) < math.radians(3)


@pytest.mark.parametrize("mode", ["accelerometer", "complementary"])
def test_noise_and_bias_have_their_size(mode):
    exact = {"accel_density_ug": 0.0, "accel_bias_mg": 0.0, "accel_instability_mg": 0.0, "gyro_bias_deg": 0.0}
    sensor = Imu(ImuConfig(tilt=mode, **exact), (0.18, 0.0, 0.5), 0.1)
    means, spread = [], []
    for episode in range(200):
        sensor.reset(BodyMotion(LEVEL))
        sensor.start(child(5, episode))
        tilts = []
        for tick in range(10):
            sensor.sample(BodyMotion(LEVEL, STILL, STILL))
            frame = sensor.end_tick(child(6, 100 * episode + tick))
            tilts.append((frame.roll_rad, frame.pitch_rad))
        means.append(np.degrees(tilts).mean(axis=0))
        spread.append(np.degrees(tilts).var(axis=0, ddof=1))
    assert np.sqrt(np.mean(spread, axis=0)) == pytest.approx([0.3, 0.3], rel=0.1)
    assert np.std(means, axis=0) == pytest.approx([0.5, 0.5], rel=0.15)


def test_the_ideal_sensor_has_no_errors():
    sensor = Imu(ImuConfig(), (0.18, 0.0, 0.5), 0.1)
    sensor.start(3)
    up = matrix_from_quaternion(quaternion_from_ypr(0.0, 0.1, -0.05))
    sensor.reset(BodyMotion(up))
    sensor.sample(BodyMotion(up, STILL, STILL))
    frame = sensor.end_tick(4)
    assert (frame.roll_rad, frame.pitch_rad) == pytest.approx((-0.05, 0.1), abs=1e-12)
