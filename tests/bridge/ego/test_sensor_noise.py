"""Sensor noise in a world: exact when off, the same for a seed, and none of another chair's business."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.worlds import follow, open_world
from wcsim.errors import ConfigError
from wcsim.types import ClientSnapshot

OFF = ("world.demand_scale=0", "imu.noise=false", "imu.tilt=complementary")
ON = ("world.demand_scale=0", "cameras.0.noise=typical", "imu.tilt=complementary")


def told(client: ClientSnapshot) -> list[bytes]:
    """What the sensors of a seat say: depth, classes, IMU."""
    (camera,), imu = client.sensors.cameras, client.sensors.imu
    felt = np.r_[imu.accel_mean_mps2, imu.gyro_radps, imu.roll_rad, imu.pitch_rad]
    return [camera.depth_m.tobytes(), camera.class_id.tobytes(), felt.tobytes()]


def ride(town: Path, *overrides: str, seats: int = 1, seed: int = 3, ticks: int = 4) -> list[list[bytes]]:
    """What the first seat's sensors say in each tick."""
    with open_world(town, *overrides, seats=seats, seed=seed) as world:
        out = [told(world.snapshot.clients[0])]
        out += [told(follow(world).clients[0]) for _ in range(ticks)]
    return out


def test_without_noise_two_runs_are_alike_to_the_bit(corner):
    assert ride(corner, *OFF) == ride(corner, *OFF)


def test_noise_is_that_of_the_seed_whoever_else_is_there(corner):
    alone = ride(corner, *ON)
    assert ride(corner, *ON) == alone
    exact = ride(corner, *OFF)
    for noisy, plain in zip(alone, exact, strict=True):
        assert all(a != b for a, b in zip(noisy, plain, strict=True))
    two, two_exact = ride(corner, *ON, seats=2), ride(corner, *OFF, seats=2)
    same = [a == b for a, b in zip(exact, two_exact, strict=True)]  # the other chair is not in the picture
    assert all(same), "choose a seed whose chairs do not meet"
    assert two == alone


def test_a_new_epoch_of_a_seed_has_its_noise_again(corner):
    with open_world(corner, *ON, seed=3) as world:
        first = [told(follow(world).clients[0]) for _ in range(3)]
        world.rebuild(4)
        assert told(follow(world).clients[0])[0] != first[0][0]
        world.rebuild(3)
        assert [told(follow(world).clients[0]) for _ in range(3)] == first


def test_a_camera_inside_the_chair_is_refused_before_the_first_tick(corner):
    with pytest.raises(ConfigError, match=r"p_BC_m \(0\.18, 0, 0\.42\) m is inside"):
        open_world(corner, "cameras.0.p_BC_m=[0.18, 0.0, 0.42]")
