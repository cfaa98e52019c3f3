from __future__ import annotations

import math

import numpy as np
import pytest

from wcsim.drive.drawing.orbit import AIM_M, Orbit, clamped, eased, eye


def seen(T_CW: np.ndarray, point: tuple[float, float, float]) -> np.ndarray:
    return T_CW[:, :3] @ np.array(point) + T_CW[:, 3]


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, -2.5])
def test_the_camera_stands_behind_the_chair_and_looks_over_it(yaw_rad: float) -> None:
    here = np.array([10.0, -4.0, 1.5])
    T_CW = eye(here, yaw_rad, Orbit())
    stands = -T_CW[:, :3].T @ T_CW[:, 3]
    ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
    assert (stands[:2] - here[:2]) @ ahead < -4.0 and stands[2] > here[2] + AIM_M
    chair = seen(T_CW, (*here[:2].tolist(), here[2] + AIM_M))
    assert abs(chair[0]) < 1e-9 and chair[2] > 4.0, "in the middle, before the camera"
    farther = seen(T_CW, (*(here[:2] + 20.0 * ahead).tolist(), here[2]))
    assert farther[2] > chair[2]


def test_turning_to_the_left_side_shows_the_chair_from_there() -> None:
    T_CW = eye(np.zeros(3), 0.0, Orbit(turn_rad=-math.pi / 2))
    stands = -T_CW[:, :3].T @ T_CW[:, 3]
    assert stands[1] < -4.0 or stands[1] > 4.0
    assert abs(stands[0]) < 1e-6


def test_nobody_gets_below_the_ground_or_lost() -> None:
    wild = clamped(1e3, -9.0, 1e9)
    assert -math.pi <= wild.turn_rad <= math.pi and wild.tilt_rad > 0.0 and wild.distance_m == 40.0


def test_the_camera_comes_after_the_chair_the_short_way() -> None:
    yaw = 3.0
    for _ in range(100):
        yaw = eased(yaw, -3.0, 0.1)
    assert yaw == pytest.approx(-3.0, abs=1e-6)
    assert abs(eased(3.0, -3.0, 0.1)) > 3.0
