from __future__ import annotations

import math

import numpy as np
import pytest

from wcsim.drive.drawing.orbit import Orbit
from wcsim.drive.drawing.pictures import Arm
from wcsim.physics.buffers import Images
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.instances import Instances
from wcsim.types import F64, Bool

HERE = np.array([5.0, 2.0, 1.0])


class Wall:
    """Stands at a distance in every direction below a height above the horizon; fills a share of the rows."""

    def __init__(self, away_m: float, below_rad: float, share: float = 1.0) -> None:
        self.away_m, self.below_rad, self.share = away_m, below_rad, share

    def render(self, camera: Pinhole, T_CW: F64, instances: Instances, out: Images, shown: Bool | None = None) -> None:
        out.depth_m[:] = 0.0
        if math.asin(T_CW[2, 2]) < self.below_rad:
            out.depth_m[: round(self.share * camera.height_px)] = self.away_m


def test_where_nothing_stands_the_view_is_as_it_was_asked_for() -> None:
    asked = Orbit(turn_rad=0.4, distance_m=8.0)
    assert Arm(Wall(50.0, 0.0)).held(HERE, 1.0, asked, math.inf) == asked


def test_before_a_low_wall_the_camera_goes_over_it() -> None:
    held = Arm(Wall(1.0, math.radians(40.0))).held(HERE, 0.0, Orbit(), math.inf)
    assert held.tilt_rad > math.radians(40.0) and held.distance_m == Orbit().distance_m


@pytest.mark.parametrize("away_m", [4.5, 2.0])
def test_where_walls_are_everywhere_it_comes_nearer(away_m: float) -> None:
    held = Arm(Wall(away_m, math.pi)).held(HERE, 0.0, Orbit(), math.inf)
    assert 1.0 < held.distance_m < away_m


def test_a_pole_does_not_move_it() -> None:
    assert Arm(Wall(1.0, math.pi, share=0.3)).held(HERE, 0.0, Orbit(), math.inf) == Orbit()


def test_it_glides_and_comes_to_rest() -> None:
    wall = Wall(50.0, math.pi)
    arm = Arm(wall)
    assert arm.held(HERE, 0.0, Orbit(), 0.1) == Orbit()
    wall.away_m = 2.0
    ways = [arm.held(HERE, 0.0, Orbit(), 0.1).distance_m for _ in range(40)]
    assert all(np.diff(ways) < 0.0) and ways[0] > 4.0
    assert ways[-1] == pytest.approx(1.7, abs=1e-3)


def test_a_person_who_turns_the_view_gets_there_at_once() -> None:
    arm = Arm(Wall(2.0, math.pi))
    arm.held(HERE, 0.0, Orbit(distance_m=1.7), 0.1)
    assert arm.held(HERE, 0.0, Orbit(), 0.0).distance_m == pytest.approx(1.7)
