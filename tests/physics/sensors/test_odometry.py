"""Wheel odometry: formulas, resolution, slip, errors, delay."""

import math
from itertools import pairwise

import numpy as np
import pytest

from tests.physics.rig import FORWARD, NEUTRAL, Rig, flat_street, mesh
from wcsim.config import ChairConfig, ImuConfig, OdometryConfig
from wcsim.physics.engine import Engine
from wcsim.physics.sensors.base import BodyMotion
from wcsim.physics.sensors.odometry import Odometry
from wcsim.physics.sensors.pixel_noise import child
from wcsim.physics.wheelchair.plant import plant_spec, varied
from wcsim.physics.wheelchair.wheelchair import Wheelchair
from wcsim.types import ClassId, Joystick

SPEC = plant_spec(ChairConfig())
EXACT = {"radius_error": 0.0, "speed_density_mps": 0.0, "turn_density_deg": 0.0}
FINE = {**EXACT, "ticks_per_turn": 1_000_000}
R_M, TRACK_M, TICK_S, STEPS = 0.16, 0.5, 0.1, 24
QUANTUM = 2.0 * math.pi * R_M / TICK_S  # of a wheel's speed in m/s, times ticks_per_turn


def readings(ticks: int, wheels_radps=(0.0, 0.0), episode=1, key=7, tick_s=TICK_S, **config) -> np.ndarray:
    """(ticks, 2) of wheels that turn steadily."""
    sensor = Odometry(OdometryConfig(**{**EXACT, **config}), R_M, TRACK_M, tick_s / STEPS)
    sensor.start(episode)
    out = np.empty((ticks, 2))
    for tick in range(ticks):
        for step in range(1, STEPS + 1):
            at_s = tick_s * (tick + step / STEPS)
            sensor.sample(BodyMotion(wheel_rad=(wheels_radps[0] * at_s, wheels_radps[1] * at_s)))
        out[tick] = sensor.end_tick(None if key is None else child(key, tick))
    return out


@pytest.mark.parametrize(
    "wheels, says",
    [((5.0, 5.0), (0.8, 0.0)), ((-2.0, 2.0), (0.0, 1.28)), ((4.0, 6.0), (0.8, 0.64)), ((-3.0, -3.0), (-0.48, 0.0))],
)
def test_speed_and_turn_rate_are_those_of_the_wheels(wheels, says):
    assert readings(20, wheels, ticks_per_turn=1_000_000).mean(axis=0) == pytest.approx(says, abs=1e-6)


@pytest.mark.parametrize("marks", [64, 512])
def test_the_resolution_is_a_mark_of_the_encoder(marks):
    wheels = np.array([math.sqrt(20.0), math.sqrt(17.0)])
    got = readings(4000, tuple(wheels), ticks_per_turn=marks)
    step = 0.5 * QUANTUM / marks  # of one wheel, half of it in their mean
    levels = got[:, 0] / step
    assert levels == pytest.approx(np.rint(levels), abs=1e-6)
    assert got[:, 0].mean() == pytest.approx(R_M * wheels.mean(), abs=step / 100)
    rest = np.mod(wheels * TICK_S * marks / (2.0 * math.pi), 1.0)  # of a mark that a tick leaves over
    wobble = math.sqrt((rest * (1.0 - rest)).sum())
    assert got[:, 0].std() == pytest.approx(step * wobble, rel=0.03)
    assert got[:, 1].std() == pytest.approx(2.0 * step * wobble / TRACK_M, rel=0.03)


@pytest.mark.parametrize("tick_s", [0.1, 0.05])
def test_white_noise_has_its_density(tick_s):
    got = readings(4000, tick_s=tick_s, speed_density_mps=0.004, turn_density_deg=0.3).std(axis=0)
    assert got == pytest.approx(np.array([0.004, math.radians(0.3)]) / math.sqrt(2.0 * tick_s), rel=0.05)


def test_a_wrong_radius_stays_through_an_episode_and_is_another_in_the_next():
    wheels, fine = (10.0, 10.0), {"radius_error": 0.02, "ticks_per_turn": 1_000_000}
    one = readings(5, wheels, **fine)
    assert np.ptp(one, axis=0) == pytest.approx([0.0, 0.0], abs=1e-4) and one[0, 0] != pytest.approx(1.6, abs=1e-4)
    drawn = np.array([readings(1, wheels, episode=e, **fine)[0] for e in range(600)]) - (1.6, 0.0)
    wheel_mps = 1.6 * 0.02  # how wrong the speed of one wheel is
    assert drawn.std(axis=0) == pytest.approx([wheel_mps / math.sqrt(2), wheel_mps * math.sqrt(2) / TRACK_M], rel=0.1)


def test_the_same_keys_give_the_same_bytes():
    noisy = {"radius_error": 0.02, "speed_density_mps": 0.01, "turn_density_deg": 1.0}
    first = readings(20, (3.0, 4.0), **noisy)
    assert readings(20, (3.0, 4.0), **noisy).tobytes() == first.tobytes()
    assert (readings(20, (3.0, 4.0), key=8, **noisy) != first).all()
    assert (readings(20, (3.0, 4.0), episode=2, **noisy) != first).all()


def test_a_late_sensor_says_what_was():
    sensor = Odometry(OdometryConfig(**FINE, delay_ticks=3), R_M, TRACK_M, TICK_S)
    turned, said = 0.0, []
    for tick in range(8):
        turned += TICK_S * tick
        sensor.sample(BodyMotion(wheel_rad=(turned, turned)))
        said.append(sensor.end_tick(None)[0])
    assert said == pytest.approx([R_M * max(0, tick - 3) for tick in range(8)], abs=1e-5)
    sensor.reset(BodyMotion())
    assert [sensor.end_tick(None).tolist() for _ in range(4)] == [[0.0, 0.0]] * 4


def ridden(r: Rig, stick: Joystick, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """(ticks, 2) what the odometry of a chair says and what is true: forward speed of the axle and turn rate."""
    said, true = [], []
    for _ in range(ticks):
        ride = r.drive(stick, 1)
        said.append(r.chair.sensors.felt("odometry"))
        true.append((ride.speed[0], ride.yaw_rate[0]))
    return np.array(said), np.array(true)


def rigged(engine: Engine, street=None, **config) -> Rig:
    r = Rig(engine, flat_street() if street is None else street, ChairConfig())
    r.chair.remove()
    section = OdometryConfig(**{**FINE, **config})
    r.chair = Wheelchair(engine, ChairConfig(), ImuConfig(), seat=0, others={"odometry": section})
    return r.place()


@pytest.mark.parametrize("stick, moving", [(FORWARD, 0), (Joystick(0.8, 0.0), 1), (Joystick(0.4, 0.7), 0)])
def test_a_wheel_that_rolls_tells_the_truth(engine, stick, moving):
    said, true = ridden(rigged(engine), stick, 60)
    (v_mps, w_radps), (says_v_mps, says_w_radps) = true[30:].mean(axis=0), said[30:].mean(axis=0)
    assert abs((v_mps, w_radps)[moving]) > 0.3
    assert says_w_radps == pytest.approx(w_radps, rel=0.02, abs=0.005)
    # In a turn a tyre stands on one of its edges, so that the middle of the track is not that of the contacts.
    assert says_v_mps == pytest.approx(v_mps, rel=0.01, abs=0.01 + 0.05 * abs(w_radps))


def test_wheels_turn_on_beyond_a_whole_turn(engine):
    said, true = ridden(rigged(engine), FORWARD, 150)
    assert said[:, 0].sum() * TICK_S / R_M > 4.0 * math.pi
    assert max(abs(b - a) for a, b in pairwise(said[60:, 0])) < 0.05 < true[-1, 0]


def test_a_wheel_that_slips_is_believed():
    ice = varied(SPEC, {"wheel.friction": 0.05})
    with Engine(1 / 240) as engine:
        r = rigged(engine)
        r.chair.become(ice)
        said, true = ridden(r.place(), FORWARD, 15)
        assert (said[5:, 0] > true[5:, 0] + 0.05).all()
    slope = mesh([(-60, -10, -12), (20, -10, 4), (20, 10, 4), (-60, 10, -12)], [[0, 1, 2], [0, 2, 3]], ClassId.ROAD)
    with Engine(1 / 240) as engine:
        r = rigged(engine, slope)
        r.chair.become(ice)
        said, true = ridden(r.place(), NEUTRAL, 20)
        assert true[-1, 0] < -0.5  # it slides backwards down the slope while its wheels hardly turn
        assert (np.abs(said[10:, 0]) < 0.2 * np.abs(true[10:, 0])).all()


def test_the_nominal_radius_is_the_configured_one_whatever_was_drawn(engine):
    worn = varied(SPEC, {"wheel.radius_m": 0.9 * SPEC.wheel.radius_m})
    r = rigged(engine)
    r.chair.become(worn)
    said, true = ridden(r.place(), FORWARD, 40)
    assert said[20:, 0].mean() == pytest.approx(true[20:, 0].mean() / 0.9, rel=0.02)


def test_a_chair_without_odometry_has_none(on_flat):
    assert on_flat.chair.sensors.names == ("imu",)
