import math
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
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
    GOAL_RGB,
    WAY_RGB,
    CameraKind,
    PageLooks,
    StillPictures,
    StreetPictures,
    _Arm,
    _eased,
    _eye,
    _ground_points,
    _mark_goal,
    _Orbit,
    clamped,
    moment_of,
)

Draw = Callable[..., bytes]


@pytest.fixture
def session(corner: Path) -> Iterator[DriveSession]:
    with DriveSession(DriveStart(town=str(corner), policy="dwa", seed=4), ()) as drive:
        yield drive


def parts(message: bytes) -> dict[str, np.ndarray]:
    found, at = {}, 4
    while at < len(message):
        letter, size = struct.unpack_from("<cI", message, at)
        data = np.frombuffer(message, np.uint8, size, at + 5)
        found[letter.decode()] = cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]
        at += 5 + size
    return found


@pytest.fixture
def draw(session: DriveSession) -> Draw:
    """Draws the pictures of a page that has these looks."""
    pictures = StreetPictures(session.world.street, session.world.config.cameras[0])

    def drawn(after_s: float = 0.1, jumped: bool = False, **looks: object) -> bytes:
        moment = moment_of(session.world, session.client, session.route, session.done_m, jumped=jumped)
        return pictures.draw(moment, PageLooks(**looks), after_s)

    return drawn


def near(picture: np.ndarray, rgb: tuple[int, int, int]) -> int:
    return int((np.abs(picture.astype(int) - rgb).max(axis=2) < 40).sum())


def test_pictures_have_their_sizes_and_show_something(session: DriveSession, draw: Draw) -> None:
    session.tick(Wish())
    shown = parts(draw(width_px=640, height_px=360))
    assert {letter: picture.shape[:2] for letter, picture in shown.items()} == {
        "S": (360, 640),
        "C": (240, 320),
        "M": (320, 320),
    }
    assert all(picture.std() > 10.0 for picture in shown.values())
    assert near(shown["S"], WAY_RGB) > 20, "the way is dotted"
    less = parts(draw(camera=CameraKind.NOTHING, chart=False))
    assert set(less) == {"S"}


def test_the_street_moves_past_and_the_numbers_of_pictures_rise(session: DriveSession, draw: Draw) -> None:
    session.assist(False)
    before = draw()
    for _ in range(15):
        session.tick(Wish(stick=Joystick(0.0, 1.0)))
    after = draw()
    assert struct.unpack_from("<I", before) < struct.unpack_from("<I", after)
    changed = np.abs(parts(before)["S"].astype(int) - parts(after)["S"]).mean()
    assert changed > 0.3


def test_a_still_tells_whether_the_chair_faces_its_way(session: DriveSession) -> None:
    stills, told = StillPictures(session.world), set()
    session.assist(False)
    for _ in range(90):
        session.tick(Wish(stick=Joystick(1.0, 0.0)))
        assert stills.on_way is (abs(session.bearing_rad) < math.radians(30.0))
        told.add(stills.on_way)
    assert told == {True, False}, "it turns on the spot"


def test_the_camera_is_at_a_new_start_at_once(session: DriveSession, draw: Draw) -> None:
    """Whatever the start's heading: it does not fly there."""
    session.tick(Wish())
    draw()
    session.new_place()
    session.tick(Wish())
    first = parts(draw(0.02, jumped=True))["S"]
    later = parts(draw(5.0))["S"]
    assert (first == later).all()


@pytest.mark.parametrize("kind", [CameraKind.CLASSES, CameraKind.DEPTH])
def test_classes_and_depth_are_what_the_policy_gets(draw: Draw, kind: CameraKind) -> None:
    shown = parts(draw(camera=kind))["C"]
    assert shown.shape == (240, 320, 3)
    block = shown[100:104, 100:104]
    assert np.ptp(block.reshape(-1, 3).astype(int), axis=0).max() < 40, "pixels of the policy's 80 x 60, enlarged"
    assert (shown[-90:, :140].min(axis=2) > 200).any() == (kind is CameraKind.CLASSES), "names of the classes"


def test_the_way_lies_ahead_on_the_ground(session: DriveSession) -> None:
    grid = session.world.street.grid
    points = _ground_points(session.route, 0.0, grid)
    assert np.allclose(points[-1][:2], session.route.points_W_m[-1])
    assert len(points) > 10
    assert len(_ground_points(session.route, float(session.route.arc_m[-1]), grid)) == 1


def test_a_far_destination_is_at_the_maps_edge() -> None:
    inside = _mark_goal(np.zeros((320, 320, 3), np.uint8), np.array([10.0, 0.0]), 60.0)
    outside = _mark_goal(np.zeros((320, 320, 3), np.uint8), np.array([0.0, -500.0]), 60.0)
    (near_row, near_column), (row, column) = (
        np.argwhere(np.abs(shown.astype(int) - GOAL_RGB).max(axis=2) < 9).mean(axis=0) for shown in (inside, outside)
    )
    assert 205 < near_column < 235 and 135 < near_row < 160
    assert row > 290 and abs(column - 160) < 6


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
    asked = _Orbit(turn_rad=0.4, distance_m=8.0)
    assert _Arm(Wall(50.0, 0.0)).held(HERE, 1.0, asked, math.inf) == asked


def held(wall: Wall) -> _Orbit:
    return _Arm(wall).held(HERE, 0.0, _Orbit(), math.inf)


def test_before_a_low_wall_the_camera_goes_over_it() -> None:
    orbit = held(Wall(1.0, math.radians(40.0)))
    assert orbit.tilt_rad > math.radians(40.0) and orbit.distance_m == _Orbit().distance_m


@pytest.mark.parametrize("away_m", [4.5, 2.0])
def test_where_walls_are_everywhere_it_comes_nearer(away_m: float) -> None:
    assert 1.0 < held(Wall(away_m, math.pi)).distance_m < away_m


def test_a_pole_does_not_move_it() -> None:
    assert held(Wall(1.0, math.pi, share=0.3)) == _Orbit()


def test_it_glides_and_comes_to_rest() -> None:
    wall = Wall(50.0, math.pi)
    arm = _Arm(wall)
    assert arm.held(HERE, 0.0, _Orbit(), 0.1) == _Orbit()
    wall.away_m = 2.0
    ways = [arm.held(HERE, 0.0, _Orbit(), 0.1).distance_m for _ in range(40)]
    assert all(np.diff(ways) < 0.0) and ways[0] > 4.0
    assert ways[-1] == pytest.approx(1.7, abs=1e-3)


def test_a_person_who_turns_the_view_gets_there_at_once() -> None:
    arm = _Arm(Wall(2.0, math.pi))
    arm.held(HERE, 0.0, _Orbit(distance_m=1.7), 0.1)
    assert arm.held(HERE, 0.0, _Orbit(), 0.0).distance_m == pytest.approx(1.7)


def seen(T_CW: np.ndarray, point: tuple[float, float, float]) -> np.ndarray:
    return T_CW[:, :3] @ np.array(point) + T_CW[:, 3]


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, -2.5])
def test_the_camera_stands_behind_the_chair_and_looks_over_it(yaw_rad: float) -> None:
    here = np.array([10.0, -4.0, 1.5])
    T_CW = _eye(here, yaw_rad, _Orbit())
    stands = -T_CW[:, :3].T @ T_CW[:, 3]
    ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
    assert (stands[:2] - here[:2]) @ ahead < -4.0 and stands[2] > here[2] + AIM_M
    chair = seen(T_CW, (*here[:2].tolist(), here[2] + AIM_M))
    assert abs(chair[0]) < 1e-9 and chair[2] > 4.0, "in the middle, before the camera"
    farther = seen(T_CW, (*(here[:2] + 20.0 * ahead).tolist(), here[2]))
    assert farther[2] > chair[2]


def test_turning_to_the_left_side_shows_the_chair_from_there() -> None:
    T_CW = _eye(np.zeros(3), 0.0, _Orbit(turn_rad=-math.pi / 2))
    stands = -T_CW[:, :3].T @ T_CW[:, 3]
    assert stands[1] < -4.0 or stands[1] > 4.0
    assert abs(stands[0]) < 1e-6


def test_nobody_gets_below_the_ground_or_lost() -> None:
    wild = clamped(1e3, -9.0, 1e9)
    assert -math.pi <= wild.turn_rad <= math.pi and wild.tilt_rad > 0.0 and wild.distance_m == 40.0


def test_the_camera_comes_after_the_chair_the_short_way() -> None:
    yaw = 3.0
    for _ in range(100):
        yaw = _eased(yaw, -3.0, 0.1)
    assert yaw == pytest.approx(-3.0, abs=1e-6)
    assert abs(_eased(3.0, -3.0, 0.1)) > 3.0
