"""What was touched, and whether the picture showed it: in the street of `tests/support/samples.py`."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.crashes.in_picture import BODY_M, Sight, actor_points, clipped, in_picture, street_points
from tests.bridge.reaction.roads import actor, walker
from tests.physics.rig import shoot
from tests.support.plants import plant_state
from tests.support.samples import strip_street
from wcsim.config import CameraConfig
from wcsim.physics.sensors.camera import CameraRig
from wcsim.physics.sensors.camera_geometry import camera_matrix, mount, pinhole, pose_matrix
from wcsim.types import ActorKind, Outline

STREET = strip_street()
CAMERA = CameraConfig(width_px=80, height_px=60)
NOISY = CameraConfig(width_px=80, height_px=60, noise="typical")
OUTLINE = Outline(length_m=1.1, width_m=0.6, height_m=1.3, middle_x_m=0.25)


def plant(x, y, yaw_deg=0.0, z=0.0):
    return plant_state(x, y, z, math.radians(yaw_deg))


def sight(chair, actors=(), camera=CAMERA):
    with CameraRig(STREET.mesh, (camera,), seats=1) as rig:
        depth_m = shoot(rig, 0, 1, chair, tuple(actors), ())[0].depth_m.copy()
    T_CW = camera_matrix(pose_matrix(chair.p_WB_m, chair.q_WB), mount(camera))
    return Sight(depth_m=depth_m, T_CW=T_CW)


def shows(points, chair, actors=(), camera=CAMERA, more_m=0.0):
    return in_picture(points, sight(chair, actors, camera), pinhole(camera), more_m)


def test_a_contact_ahead_is_in_the_picture_and_one_behind_is_not():
    touched = street_points(STREET, "kerb", plant(10.0, 3.3, 90.0), OUTLINE)
    assert touched.name == "KERB"
    assert np.allclose(touched.points_W_m[:, 1], 4.0) and (touched.points_W_m[:, 2] <= 0.121).all()
    for camera in (CAMERA, NOISY):
        assert shows(touched.points_W_m, plant(10.0, 1.5, 90.0), camera=camera)
        assert not shows(touched.points_W_m, plant(10.0, 1.5, -90.0), camera=camera)
        assert not shows(touched.points_W_m, plant(10.0, 3.3, 0.0), camera=camera)  # right beside it


def test_a_wall_in_front_hides_what_is_behind_it():
    """A bus across the way takes the place of the kerb in the depth picture."""
    kerb = street_points(STREET, "kerb", plant(10.0, 3.3, 90.0), OUTLINE).points_W_m
    bus = actor(ActorKind.BUS, x=10.0, y=2.6, yaw=0.0, size=(12.0, 1.0, 3.2), name="v:bus")
    assert shows(kerb, plant(10.0, -1.0, 90.0))
    assert not shows(kerb, plant(10.0, -1.0, 90.0), [bus])


@pytest.mark.parametrize(("x", "y", "yaw_deg", "name"), [(60.0, 8.2, 90.0, "BUILDING"), (24.3, 6.7, 0.0, "POLE")])
def test_walls_and_poles_are_found_where_the_chair_stands_before_them(x, y, yaw_deg, name):
    kind = {"BUILDING": "building", "POLE": "static"}[name]
    touched = street_points(STREET, kind, plant(x, y, yaw_deg, 0.12), OUTLINE)
    assert touched.name == name
    back = math.radians(yaw_deg)
    assert shows(touched.points_W_m, plant(x - math.cos(back), y - math.sin(back), yaw_deg, 0.12))
    away = plant(x - 5.0 * math.cos(back), y - 5.0 * math.sin(back), yaw_deg)
    assert not street_points(STREET, kind, away, OUTLINE).name


def test_points_lie_around_the_chair_alone():
    touched = street_points(STREET, "building", plant(60.0, 8.2, 90.0, 0.12), OUTLINE)
    assert np.abs(touched.points_W_m[:, 0] - 60.0).max() < 0.5 * OUTLINE.width_m + 0.41
    assert touched.points_W_m[:, 2].max() < 0.12 + OUTLINE.height_m + 1e-6


@pytest.mark.parametrize("kind", list(ActorKind))
def test_an_actor_ahead_is_seen_and_one_aside_or_hidden_is_not(kind):
    size = (0.4, 0.5, 1.7) if kind is ActorKind.PEDESTRIAN else (2.0, 0.8, 1.5)
    ahead = actor(kind, x=14.0, y=0.0, speed=0.0, size=size)
    beside = replace(ahead, p_W_m=np.array([10.0, 6.0, 0.0]))
    chair = plant(10.0, 0.0)
    for camera in (CAMERA, NOISY):
        assert shows(actor_points(ahead), chair, [ahead], camera, BODY_M)
        assert not shows(actor_points(beside), chair, [beside], camera, BODY_M)
    truck = actor(ActorKind.TRUCK, x=12.5, y=0.0, speed=0.0, yaw=0.5 * math.pi, size=(7.0, 1.0, 3.0))
    assert not shows(actor_points(ahead), chair, [ahead, truck], more_m=BODY_M)


def test_points_of_an_actor_lie_on_its_box_or_its_middle():
    points = actor_points(walker(3.0, 4.0, yaw=0.7))
    off = (points[:, :2] - (3.0, 4.0)) @ np.array([[math.cos(0.7), -math.sin(0.7)], [math.sin(0.7), math.cos(0.7)]])
    on_side = np.isclose(np.abs(off[:, 0]), 0.15) | np.isclose(np.abs(off[:, 1]), 0.25)
    assert (on_side | np.isclose(off[:, 1], 0.0)).all() and (np.abs(off) <= (0.15 + 1e-9, 0.25 + 1e-9)).all()
    assert points[:, 2].max() < 1.7


def test_a_triangle_is_clipped_to_a_box():
    low, high = np.zeros(3), np.ones(3)
    wide = np.array([[-9.0, 0.5, -9.0], [9.0, 0.5, -9.0], [0.0, 0.5, 30.0]])
    part = clipped(wide, low, high)
    assert {tuple(np.round(corner, 9)) for corner in part} == {(x, 0.5, z) for x in (0.0, 1.0) for z in (0.0, 1.0)}
    assert len(clipped(wide + np.array([0.0, 2.0, 0.0]), low, high)) == 0
    inside = np.array([[0.1, 0.1, 0.1], [0.9, 0.1, 0.2], [0.5, 0.8, 0.3]])
    assert np.array_equal(clipped(inside, low, high), inside)
