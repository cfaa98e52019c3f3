import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from wcsim.drive.session import DriveSession, Wish
from wcsim.drive.starting import DriveStart
from wcsim.physics.buffers import Images
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.instances import Instances
from wcsim.types import F64, Bool, Joystick
from wcsim.view.street_pictures import (
    AIM_M,
    DISTANCE_M,
    WAY_RGB,
    StillPictures,
    StreetPictures,
    _eye,
    _ground_points,
    _held,
    moment_of,
)


@pytest.fixture
def session(corner: Path) -> Iterator[DriveSession]:
    with DriveSession(DriveStart(town=str(corner), policy="dwa", seed=4), ()) as drive:
        yield drive


@pytest.fixture
def draw(session: DriveSession) -> Callable[..., np.ndarray]:
    """Draws the street from behind the chair."""
    pictures = StreetPictures(session.world.street)

    def drawn() -> np.ndarray:
        moment = moment_of(session.world, session.client, session.route, session.done_m)
        return pictures.behind(moment, 640, 360).picture

    return drawn


def near(picture: np.ndarray, rgb: tuple[int, int, int]) -> int:
    return int((np.abs(picture.astype(int) - rgb).max(axis=2) < 40).sum())


def test_a_picture_has_its_size_and_the_way_is_dotted(session: DriveSession, draw: Callable[..., np.ndarray]) -> None:
    session.tick(Wish())
    shown = draw()
    assert shown.shape == (360, 640, 3) and shown.std() > 10.0
    assert near(shown, WAY_RGB) > 20


def test_the_street_moves_past(session: DriveSession, draw: Callable[..., np.ndarray]) -> None:
    session.assist(False)
    before = draw()
    for _ in range(15):
        session.tick(Wish(stick=Joystick(0.0, 1.0)))
    assert np.abs(before.astype(int) - draw()).mean() > 0.3


def test_a_still_tells_whether_the_chair_faces_its_way(session: DriveSession) -> None:
    stills, told = StillPictures(session.world), set()
    session.assist(False)
    for _ in range(90):
        session.tick(Wish(stick=Joystick(1.0, 0.0)))
        assert stills.on_way is (abs(session.bearing_rad) < math.radians(30.0))
        told.add(stills.on_way)
    assert told == {True, False}, "it turns on the spot"


def test_the_way_lies_ahead_on_the_ground(session: DriveSession) -> None:
    grid = session.world.street.grid
    points = _ground_points(session.route, 0.0, grid)
    assert np.allclose(points[-1][:2], session.route.points_W_m[-1])
    assert len(points) > 10
    assert len(_ground_points(session.route, float(session.route.arc_m[-1]), grid)) == 1


HERE = np.array([5.0, 2.0, 1.0])


class Wall:
    """Stands at a distance in every direction below a height above the horizon; fills a share of the rows."""

    def __init__(self, away_m: float, below_rad: float, share: float = 1.0) -> None:
        self.away_m, self.below_rad, self.share = away_m, below_rad, share

    def render(self, camera: Pinhole, T_CW: F64, instances: Instances, out: Images, shown: Bool | None = None) -> None:
        out.depth_m[:] = 0.0
        if math.asin(T_CW[2, 2]) < self.below_rad:
            out.depth_m[: round(self.share * camera.height_px)] = self.away_m


def held(wall: Wall) -> tuple[float, float]:
    return _held(wall, HERE, 0.0)


USUAL = held(Wall(50.0, 0.0))


def test_where_nothing_stands_the_view_is_as_usual() -> None:
    assert (math.radians(22.0), DISTANCE_M) == USUAL


def test_before_a_low_wall_the_camera_goes_over_it() -> None:
    tilt_rad, distance_m = held(Wall(1.0, math.radians(40.0)))
    assert tilt_rad > math.radians(40.0) and distance_m == DISTANCE_M


@pytest.mark.parametrize("away_m", [4.5, 2.0])
def test_where_walls_are_everywhere_it_comes_nearer(away_m: float) -> None:
    assert 1.0 < held(Wall(away_m, math.pi))[1] < away_m


def test_a_pole_does_not_move_it() -> None:
    assert held(Wall(1.0, math.pi, share=0.3)) == USUAL


def seen(T_CW: np.ndarray, point: tuple[float, float, float]) -> np.ndarray:
    return T_CW[:, :3] @ np.array(point) + T_CW[:, 3]


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, -2.5])
def test_the_camera_stands_behind_the_chair_and_looks_over_it(yaw_rad: float) -> None:
    here = np.array([10.0, -4.0, 1.5])
    T_CW = _eye(here, yaw_rad, *USUAL)
    stands = -T_CW[:, :3].T @ T_CW[:, 3]
    ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
    assert (stands[:2] - here[:2]) @ ahead < -4.0 and stands[2] > here[2] + AIM_M
    chair = seen(T_CW, (*here[:2].tolist(), here[2] + AIM_M))
    assert abs(chair[0]) < 1e-9 and chair[2] > 4.0, "in the middle, before the camera"
    farther = seen(T_CW, (*(here[:2] + 20.0 * ahead).tolist(), here[2]))
    assert farther[2] > chair[2]
