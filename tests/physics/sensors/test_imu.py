"""The inertial sensor: definition, filter, noise, and its independence of the physics step."""

import math

import numpy as np
import pytest

from tests.physics.rig import FORWARD, NEUTRAL, rig, step_street
from wcsim.config import ImuConfig
from wcsim.core.frames import LEVEL, matrix_from_quaternion, quaternion_from_ypr, rpy_from_matrix
from wcsim.errors import PhysicsError
from wcsim.physics.sensors.base import BodyMotion
from wcsim.physics.sensors.imu import Imu
from wcsim.types import ClassId

STILL, AHEAD = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)


def imu(dt_s: float = 1 / 240, **config) -> Imu:
    return Imu(ImuConfig(**config), (0.0, 0.0, 0.5), dt_s)


def test_at_rest_it_feels_one_g_upwards(on_flat):
    on_flat.drive(NEUTRAL, 8)
    frame = on_flat.chair.imu()
    assert frame.accel_mean_mps2 == pytest.approx([0.0, 0.0, 9.81], abs=0.01)
    assert frame.accel_peak_mps2 == pytest.approx(STILL, abs=0.01)
    assert frame.gyro_radps == pytest.approx(STILL, abs=1e-3)


def test_right_after_it_was_placed_it_reads_like_one_at_rest(on_flat):
    frame = on_flat.place(yaw=0.5).chair.imu()
    assert frame.accel_mean_mps2 == pytest.approx([0.0, 0.0, 9.81])
    assert (frame.roll_rad, frame.pitch_rad, frame.yaw_rad) == pytest.approx((0.0, 0.0, 0.5))


def test_speeding_up_and_turning_have_the_right_signs(on_flat):
    on_flat.drive(FORWARD, 5)
    assert on_flat.chair.imu().accel_mean_mps2[0] == pytest.approx(1.0, abs=0.1)
    on_flat.drive(FORWARD, 20)
    on_flat.drive(NEUTRAL, 6)
    assert on_flat.chair.imu().accel_mean_mps2[0] == pytest.approx(-1.5, abs=0.15)


def still(sensor, up):
    """What is felt in a tick at rest."""
    sensor.reset(BodyMotion(up))
    for _ in range(24):
        sensor.sample(BodyMotion(up, STILL, STILL))
    return sensor.end_tick(None)


def test_tilted_it_feels_gravity_along_its_axes():
    sensor = imu()
    up = matrix_from_quaternion(quaternion_from_ypr(0.3, math.radians(10.0)))  # nose up
    frame = still(sensor, up)
    expected = [9.81 * math.sin(math.radians(10)), 0.0, 9.81 * math.cos(math.radians(10))]
    assert frame.accel_mean_mps2 == pytest.approx(expected)
    assert frame.pitch_rad == pytest.approx(math.radians(10.0))
    assert frame.accel_peak_mps2 == pytest.approx(STILL)


def feel(sensor, v_W_mps, w_W_radps=STILL):
    """One substep of a level chair that moves so."""
    sensor.sample(BodyMotion(LEVEL, v_W_mps, w_W_radps))


@pytest.mark.parametrize("hz", [120, 240, 480])
def test_a_sudden_stop_gives_the_peak_of_two_low_passes_in_a_row(hz):
    sensor = imu(1 / hz)
    feel(sensor, AHEAD)
    for _ in range(hz):  # forget the start
        feel(sensor, AHEAD)
    sensor.end_tick(None)
    for _ in range(hz // 10):
        feel(sensor, STILL)
    peak = sensor.end_tick(None).accel_peak_mps2
    assert peak[0] == pytest.approx(2 * math.pi * 20.0 / math.e, rel=0.1)  # of the continuous filter, for 1 m/s
    assert peak[1:] == pytest.approx([0.0, 0.0])


def test_the_filter_goes_on_over_the_end_of_a_tick():
    sensor = imu()
    feel(sensor, AHEAD)
    sensor.end_tick(None)
    feel(sensor, AHEAD)
    assert sensor.end_tick(None).accel_peak_mps2[0] > 10.0


def test_turning_moves_a_mount_off_the_centre():
    sensor = imu(p_BI_m=(0.5, 0.0, 0.5))
    spin = (0.0, 0.0, 2.0)
    feel(sensor, STILL, spin)
    sensor.end_tick(None)
    quarter = matrix_from_quaternion(quaternion_from_ypr(2.0 / 240))
    sensor.sample(BodyMotion(quarter, STILL, spin))
    frame = sensor.end_tick(None)
    assert frame.accel_mean_mps2[0] == pytest.approx(-0.5 * 4.0, rel=0.02)  # towards the centre
    assert frame.gyro_radps == pytest.approx([0.0, 0.0, 2.0])


def test_noise_is_on_the_means_only_and_saturation_holds():
    sensor = imu(saturation_mps2=5.0)
    frames = []
    for key in (11, 11, 12):
        sensor.reset(BodyMotion(LEVEL))
        feel(sensor, (0.01, 0.0, 0.0))
        frames.append(sensor.end_tick(key))
        sensor.start(1)
    assert np.array_equal(frames[0].accel_peak_mps2, frames[2].accel_peak_mps2)
    assert frames[0].accel_mean_mps2[0] != frames[2].accel_mean_mps2[0]
    assert frames[0].accel_mean_mps2[2] == 5.0


def test_a_fast_turn_ends_at_the_range_of_the_gyroscope():
    sensor = imu(gyro_range_deg=250.0, noise=False)
    feel(sensor, STILL, (0.0, -9.0, 3.0))
    assert sensor.end_tick(None).gyro_radps == pytest.approx([0.0, -math.radians(250), 3.0])


def test_the_low_pass_can_be_read_substep_by_substep():
    sensor = imu(noise=False)
    for k in range(24):
        feel(sensor, (0.0 if k < 12 else 1.0, 0.0, 0.0))
    peak = sensor.end_tick(None).accel_peak_mps2
    assert sensor.lowpass_mps2.shape == (24, 3)
    assert np.abs(sensor.lowpass_mps2[:12]).max() == 0.0
    assert np.abs(sensor.lowpass_mps2).max(axis=0) == pytest.approx(peak)


def braking(sensor: Imu, ticks: int = 1):
    """One frame after ticks of braking at 1.5 m/s2 on level ground."""
    feel(sensor, (3.0, 0.0, 0.0))
    sensor.end_tick(None)
    for tick in range(ticks):
        for k in range(1, 25):
            feel(sensor, (3.0 - 1.5 * (tick + k / 24) / 10, 0.0, 0.0))
        frame = sensor.end_tick(None)
    return frame


def test_what_is_penalised_can_be_the_mean_and_can_have_gravity_in_it():
    assert braking(imu(), 8).accel_peak_mps2 == pytest.approx([1.5, 0.0, 0.0], rel=1e-3)
    assert braking(imu(accel_window="tick_mean")).accel_peak_mps2 == pytest.approx([1.5, 0.0, 0.0])
    assert braking(imu(gravity="included"), 8).accel_peak_mps2 == pytest.approx([1.5, 0.0, 9.81], rel=1e-3)
    mean = braking(imu(accel_window="tick_mean", gravity="included")).accel_peak_mps2
    assert mean == pytest.approx([1.5, 0.0, 9.81])


def test_gravity_can_be_taken_out_of_what_the_agent_sees():
    assert braking(imu(mean_gravity="removed")).accel_mean_mps2 == pytest.approx([-1.5, 0.0, 0.0])
    assert braking(imu()).accel_mean_mps2 == pytest.approx([-1.5, 0.0, 9.81])


def test_gravity_in_the_peak_does_not_ring_in_at_a_start():
    sensor = imu(gravity="included")
    up = matrix_from_quaternion(quaternion_from_ypr(0.0, 0.2))
    sensor.reset(BodyMotion(up))
    gravity = pytest.approx([9.81 * math.sin(0.2), 0.0, 9.81 * math.cos(0.2)])
    assert sensor.end_tick(None).accel_peak_mps2 == gravity
    sensor.sample(BodyMotion(up, STILL, STILL))
    assert sensor.end_tick(None).accel_peak_mps2 == gravity


def test_numbers_that_are_not_finite_are_refused():
    sensor = imu()
    feel(sensor, (math.nan, 0.0, 0.0))
    with pytest.raises(PhysicsError, match="finite"):
        sensor.end_tick(None)


def test_peaks_do_not_depend_on_the_physics_step():
    def peaks(hz: int) -> np.ndarray:
        with rig(step_street(2.0, wall=ClassId.BUILDING), hz, v_max_mps=1.0) as r:
            wall = r.place(1.0).drive(FORWARD, 25).peaks(10)[0]
        with rig(step_street(0.04), hz, v_max_mps=1.0) as r:
            kerb = r.place(1.6).drive(FORWARD, 28).peaks(10).max()
        return np.array([wall, kerb])

    reference = peaks(240)
    for hz in (120, 480):
        assert peaks(hz) == pytest.approx(reference, rel=0.15)


def test_angles_come_back_from_the_rotation():
    for yaw, pitch in ((0.3, 0.2), (-3.0, -0.4), (1.6, 0.0)):
        assert rpy_from_matrix(matrix_from_quaternion(quaternion_from_ypr(yaw, pitch))) == pytest.approx(
            (0.0, pitch, yaw)
        )


def test_a_turned_sensor_feels_in_its_own_axes_and_what_is_judged_stays():
    tilted = matrix_from_quaternion(quaternion_from_ypr(0.3, math.radians(10.0)))
    frames = []
    for turns in ((0.0, 0.0, 0.0), (0.0, 0.0, 90.0), (0.0, -10.0, 0.0)):
        sensor = imu(rpy_deg=turns, mean_gravity="included", noise=False)
        sensor.reset(BodyMotion(tilted))
        for v in range(24):
            sensor.sample(BodyMotion(tilted, (0.001 * v, 0.0, 0.0), (0.2, 0.0, 0.5)))
        frames.append(sensor.end_tick(None))
    straight, left, level = frames
    x, y, z = straight.accel_mean_mps2
    assert left.accel_mean_mps2 == pytest.approx([y, -x, z])  # looks to the left of the chair
    p, q, r = straight.gyro_radps
    assert left.gyro_radps == pytest.approx([q, -p, r])
    assert math.degrees(left.roll_rad) == pytest.approx(-10.0)  # the chair's nose is its right side
    assert left.pitch_rad == pytest.approx(0.0, abs=1e-9) and left.yaw_rad == straight.yaw_rad
    assert level.pitch_rad == pytest.approx(0.0, abs=1e-9)  # mounted nose down on a chair with its nose up
    assert all(np.array_equal(frame.accel_peak_mps2, straight.accel_peak_mps2) for frame in frames)


@pytest.mark.parametrize("mode", ["ideal", "accelerometer", "complementary"])
def test_the_tilt_sensor_ends_at_its_range(mode):
    sensor = imu(tilt=mode, tilt_range_deg=6.0, noise=False)
    up = matrix_from_quaternion(quaternion_from_ypr(0.0, math.radians(10.0), math.radians(-3.0)))
    frame = still(sensor, up)
    assert math.degrees(frame.pitch_rad) == pytest.approx(6.0)
    assert math.degrees(frame.roll_rad) == pytest.approx(-3.0, abs=0.1)
