"""A chair that rolls without the engine goes where the same chair goes in it, and comes back without a blow."""

import copy
import math
from collections.abc import Iterator

import numpy as np
import pytest

from wcsim.chair_check.rig import FORWARD, NEUTRAL, ChairTestRig
from wcsim.chair_check.row import TrialSetup
from wcsim.config import ChairConfig, OdometryConfig
from wcsim.core.frames import matrix_from_quaternion, rotate_vector, rpy_from_matrix
from wcsim.physics.sensors.base import BodyMotion
from wcsim.physics.sensors.odometry import Odometry
from wcsim.physics.wheelchair.plant import varied
from wcsim.physics.wheelchair.rolling import Plane, RolledTick
from wcsim.physics.wheelchair.wheelchair import Wheelchair
from wcsim.types import Joystick

HZ, STEPS = 120, 12
SLOPES_DEG = [(0.0, 0.0), (4.0, 0.0), (-2.0, 4.0)]


def open_rig(plant: str = "rwd", slope_deg: tuple[float, float] = (0.0, 0.0), rolling: bool = False) -> ChairTestRig:
    ahead, left = map(math.radians, slope_deg)
    return ChairTestRig(TrialSetup(chair=ChairConfig(plant=plant), hz=HZ, rolling=rolling), slope_rad=(ahead, left))


def plane_below(chair: Wheelchair, slope_deg: tuple[float, float] = (0.0, 0.0)) -> Plane:
    ahead, left = (math.tan(math.radians(turn)) for turn in slope_deg)
    x_m, y_m, _ = chair.state().p_WB_m
    return Plane(x_m * ahead + y_m * left, ahead, left)


def sticks(seed: int, ticks: int) -> Iterator[Joystick]:
    """A driver who changes his mind every 1.5 s; at times he turns on the spot, or backs."""
    rng = np.random.default_rng(seed)
    for tick in range(ticks):
        if tick % 15 == 0:
            way = rng.uniform(-math.pi, math.pi) if rng.random() < 0.3 else rng.normal(0.0, 0.4)
            size = math.sqrt(rng.uniform(0.0, 1.0)) if rng.random() > 0.15 else 0.0
            stick = Joystick(size * math.sin(way), size * math.cos(way))
        yield stick


def ends_at(tick: RolledTick, com_B_m: tuple[float, float, float]) -> tuple[np.ndarray, float, float]:
    """Where a tick of rolling leads the chair's origin to, its yaw and pitch."""
    rotation = matrix_from_quaternion(tick.motion.q_WB)
    _, pitch_rad, yaw_rad = rpy_from_matrix(rotation)
    return np.subtract(tick.motion.p_W_m, rotate_vector(rotation, *com_B_m)), yaw_rad, pitch_rad


@pytest.mark.parametrize("slope_deg", SLOPES_DEG)
@pytest.mark.parametrize("plant", ["rwd", "mwd", "whill"])
def test_one_tick_is_that_of_the_engine(plant, slope_deg):
    found = []
    with open_rig(plant, slope_deg) as rig:
        chair = rig.chair
        for stick in sticks(1, 200):
            if np.abs(chair.state().p_WB_m[:2]).max() > 30.0:
                rig.place(0.0)
            plane = plane_below(chair, slope_deg)
            chair.command(stick)
            guess = chair.rolled(plane, STEPS) if chair.can_roll(plane) else None
            imu = copy.deepcopy(chair.sensors._sensors["imu"])
            after = rig.drive(stick, 0.1).states[-1]
            if guess is not None:
                imu.sample_rows(guess.rows, (0.0, 0.0))
                peak_mps2 = imu.end_tick(None).accel_peak_mps2 - chair.imu().accel_peak_mps2
                place_m, yaw_rad, pitch_rad = ends_at(guess, chair.spec.frame_com_m)
                turned = math.remainder(yaw_rad - after.yaw_rad, math.tau)
                wheels = np.array([guess.motion.joints[side][1] for side in (0, 1)]) - after.wheel_radps
                found.append([*(place_m - after.p_WB_m), turned, pitch_rad - after.pitch_rad, *wheels, *peak_mps2])
    assert len(found) > 100
    rms = np.sqrt((np.array(found) ** 2).mean(axis=0))
    x_m, y_m, z_m, yaw_rad, pitch_rad, left_radps, right_radps, *peaks_mps2 = rms
    assert np.hypot(x_m, y_m) < 0.001 and z_m < 0.0003
    assert yaw_rad < 0.0015 and pitch_rad < 0.004 and max(left_radps, right_radps) < 0.015
    # On springs the engine's peaks are softer: an arm gives way before the whole chair nods.
    assert max(peaks_mps2) < (0.7 if plant == "mwd" else 0.3)


def test_looking_ahead_changes_nothing():
    with open_rig() as rig, open_rig() as other:
        for stick in sticks(2, 60):
            if rig.chair.can_roll(plane_below(rig.chair)):
                rig.chair.rolled(plane_below(rig.chair), STEPS)
            one, two = rig.drive(stick, 0.1).states[-1], other.drive(stick, 0.1).states[-1]
            assert one.p_WB_m.tolist() == two.p_WB_m.tolist() and one.yaw_rad == two.yaw_rad


@pytest.mark.parametrize("plant", ["rwd", "mwd"])
def test_in_and_out_of_the_engine_no_speed_is_lost_and_no_blow_felt(plant):
    with open_rig(plant) as rig:
        rig.place(-30.0)
        rig.drive(FORWARD, 4.0)
        peaks_mps2, speeds_mps, changes = [], [], 0
        for tick in range(160):
            plane = plane_below(rig.chair)
            # By turns of seven ticks, so that each phase of a step falls on a change.
            if tick // 7 % 2 == 0 and rig.chair.can_roll(plane):
                rig.chair.command(FORWARD)
                rig.chair.roll(rig.chair.rolled(plane, STEPS))
                rig.chair.end_tick(None)
                changes += tick % 7 == 0
            else:
                rig.drive(FORWARD, 0.1)
            peaks_mps2.append(rig.chair.imu().accel_peak_mps2.max())
            speeds_mps.append(rig.chair.state().v_B_mps[0])
        assert changes >= 11
        assert max(peaks_mps2) < 1.0
        assert min(speeds_mps) > 1.6 and max(speeds_mps) < 1.75
        assert not rig.chair.contacts() and not rig.chair.hanging


def test_the_body_lies_aside_while_it_rolls_and_stands_where_it_is_said_to_after():
    with open_rig() as rig:
        rig.drive(FORWARD, 1.0)
        rig.chair.command(FORWARD)
        rig.chair.roll(rig.chair.rolled(plane_below(rig.chair), STEPS))
        (_, _, z_m), _ = rig.bullet.getBasePositionAndOrientation(rig.body)
        assert z_m < -100.0
        said = rig.chair.state()
        rig.chair.stop_rolling()
        rig.chair.stop_rolling()
        rig.chair._read()
        after = rig.chair.state()
        assert np.allclose([after.p_WB_m, after.v_B_mps], [said.p_WB_m, said.v_B_mps])


def test_who_leans_hangs_slips_or_is_parked_cannot_roll():
    with open_rig() as rig:
        rig.drive(NEUTRAL, 1.0)
        plane = plane_below(rig.chair)
        assert rig.chair.can_roll(plane)
        assert not rig.chair.can_roll(plane._replace(z_m=0.02))
        assert not rig.chair.can_roll(plane._replace(rise_x=0.04))  # it stands level
        rig.bullet.resetBaseVelocity(rig.body, (0.3, 0.0, 0.0), (0.0, 0.0, 0.0))
        rig.chair._read()
        assert not rig.chair.can_roll(plane)  # its wheels stand, and it moves
        rig.chair.park()
        assert not rig.chair.can_roll(plane)


def test_on_steep_or_slippery_ground_nobody_rolls():
    for slope_deg in ((12.0, 0.0), (0.0, 12.0)):
        with open_rig("rwd", slope_deg) as rig:
            rig.drive(NEUTRAL, 1.0)
            assert not rig.chair.can_roll(plane_below(rig.chair, slope_deg))
    with open_rig() as rig:
        rig.chair.become(varied(rig.chair.spec, {"wheel.friction": 0.4}))
        rig.place(0.0)
        rig.drive(NEUTRAL, 1.0)
        assert not rig.chair.can_roll(plane_below(rig.chair))


def test_wheels_turn_and_are_where_the_chair_is():
    with open_rig() as rig:
        rig.place(-10.0)
        rig.drive(FORWARD, 4.0)
        radius_m = rig.chair.spec.wheel.radius_m
        odometry = Odometry(OdometryConfig(), radius_m, 0.56, 1.0 / HZ)
        rig.chair.command(FORWARD)
        ticks = []
        for _ in range(10):
            ticks.append(rig.chair.rolled(plane_below(rig.chair), STEPS))
            rig.chair.roll(ticks[-1])
        turned_rad = [(tick.motion.joints[0][0], tick.motion.joints[1][0]) for tick in ticks]
        odometry.reset(BodyMotion(wheel_rad=turned_rad[0]))
        odometry.sample_rows(ticks[1].rows, turned_rad[1])
        assert odometry.end_tick(None) == pytest.approx([1.67, 0.0], abs=0.02)
        places_m, speeds_mps = rig.chair.wheel_track()
        assert np.allclose(speeds_mps[-20:], 1.67, atol=0.02)
        assert np.allclose(np.diff(places_m[-20:, :, 0], axis=0), 1.67 * 0.05, atol=0.002)
        hubs_m = places_m[-1] - rig.chair.state().p_WB_m
        assert np.allclose(hubs_m, rig.chair.wheels_m, atol=0.02)


def test_a_cruise_is_not_quieter_than_in_the_engine():
    """The blows of the ground's triangles, as `test_ride` finds them in a town: rare, 0.1 to 1 m/s2."""
    with open_rig(rolling=True) as rig:
        rig.place(-30.0)
        rig.drive(FORWARD, 4.0)
        peaks = np.array(rig.drive(FORWARD, 20.0).peaks_mps2)
        each = np.sqrt((peaks**2).mean(axis=0))
        assert (each > 0.02).all() and (each < 0.3).all() and np.median(peaks) < 0.05
