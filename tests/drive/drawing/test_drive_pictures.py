from __future__ import annotations

import math
import struct

import cv2
import numpy as np
import pytest

from wcsim.drive.drawing.pictures import (
    GOAL_RGB,
    WAY_RGB,
    CameraKind,
    DrivePictures,
    PageLooks,
    StillPictures,
    _ground_points,
    _mark_goal,
)
from wcsim.drive.session import DriveSession, Wish
from wcsim.types import Joystick


def parts(message: bytes) -> dict[str, np.ndarray]:
    found, at = {}, 4
    while at < len(message):
        letter, size = struct.unpack_from("<cI", message, at)
        data = np.frombuffer(message, np.uint8, size, at + 5)
        found[letter.decode()] = cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]
        at += 5 + size
    return found


def near(picture: np.ndarray, rgb: tuple[int, int, int]) -> int:
    return int((np.abs(picture.astype(int) - rgb).max(axis=2) < 40).sum())


def test_pictures_have_their_sizes_and_show_something(session: DriveSession) -> None:
    session.tick(Wish())
    pictures = DrivePictures(session)
    shown = parts(pictures.draw(session, PageLooks(width_px=640, height_px=360), 0.1))
    assert {letter: picture.shape[:2] for letter, picture in shown.items()} == {
        "S": (360, 640),
        "C": (240, 320),
        "M": (320, 320),
    }
    assert all(picture.std() > 10.0 for picture in shown.values())
    assert near(shown["S"], WAY_RGB) > 20, "the way is dotted"
    less = parts(pictures.draw(session, PageLooks(camera=CameraKind.NOTHING, chart=False), 0.1))
    assert set(less) == {"S"}


def test_the_street_moves_past_and_the_numbers_of_pictures_rise(session: DriveSession) -> None:
    session.assist(False)
    pictures = DrivePictures(session)
    before = pictures.draw(session, PageLooks(), 0.1)
    for _ in range(15):
        session.tick(Wish(stick=Joystick(0.0, 1.0)))
    after = pictures.draw(session, PageLooks(), 0.1)
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


def test_the_camera_is_at_a_new_start_at_once(session: DriveSession) -> None:
    """Whatever the start's heading: it does not fly there."""
    pictures = DrivePictures(session)
    session.tick(Wish())
    pictures.draw(session, PageLooks(), 0.1)
    session.new_place()
    session.tick(Wish())
    first = parts(pictures.draw(session, PageLooks(), 0.02))["S"]
    later = parts(pictures.draw(session, PageLooks(), 5.0))["S"]
    assert (first == later).all()


@pytest.mark.parametrize("kind", [CameraKind.CLASSES, CameraKind.DEPTH])
def test_classes_and_depth_are_what_the_policy_gets(session: DriveSession, kind: CameraKind) -> None:
    pictures = DrivePictures(session)
    shown = parts(pictures.draw(session, PageLooks(camera=kind), 0.1))["C"]
    assert shown.shape == (240, 320, 3)
    block = shown[100:104, 100:104]
    assert np.ptp(block.reshape(-1, 3).astype(int), axis=0).max() < 40, "pixels of the policy's 80 x 60, enlarged"


def test_the_way_lies_ahead_on_the_ground(session: DriveSession) -> None:
    grid = session.world.street.grid
    points = _ground_points(session.route, 0.0, grid)
    assert np.allclose(points[-1][:2], session.route.points_W_m[-1])
    assert len(points) > 10
    assert len(_ground_points(session.route, float(session.route.arc_m[-1]), grid)) == 1


def test_a_far_destination_is_at_the_maps_edge() -> None:
    inside = _mark_goal(np.zeros((320, 320, 3), np.uint8), np.array([10.0, 0.0]), 60.0)
    outside = _mark_goal(np.zeros((320, 320, 3), np.uint8), np.array([0.0, -500.0]), 60.0)
    rows, columns = np.nonzero(np.abs(inside.astype(int) - GOAL_RGB).max(axis=2) < 9)
    assert 205 < columns.mean() < 235 and 135 < rows.mean() < 160
    rows, columns = np.nonzero(np.abs(outside.astype(int) - GOAL_RGB).max(axis=2) < 9)
    assert rows.mean() > 290 and abs(columns.mean() - 160) < 6
