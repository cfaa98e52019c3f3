"""Who is who in a picture: every kind at the pixel where it must be, and looks that a camera can tell apart."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from tests.physics.renderer.render_oracle import SIZES, actor
from tests.physics.rig import shoot
from tests.support.plants import plant_state
from tests.support.samples import strip_street
from wcsim.config import CameraConfig
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.instances import _figures, actor_instances
from wcsim.physics.renderer.models.catalog import Template, template_of
from wcsim.physics.sensors.camera import CameraRig, FreeCamera
from wcsim.physics.sensors.camera_geometry import camera_matrix, look_at, mount, pinhole, pose_matrix
from wcsim.types import ActorKind, ActorLook, ClassId

CAMERA = CameraConfig(width_px=320, height_px=240)


@pytest.mark.parametrize(
    "kind, classes, slack_m",
    [
        (ActorKind.PEDESTRIAN, {ClassId.PERSON}, 0.3),
        (ActorKind.BICYCLE, {ClassId.BICYCLE, ClassId.RIDER}, 0.4),
        (ActorKind.CAR, {ClassId.CAR}, 0.95),
        (ActorKind.BUS, {ClassId.BUS}, 1.3),
    ],
)
def test_it_is_seen_in_depth_and_class_at_the_predicted_pixel(kind, classes, slack_m):
    """Across the view of a chair, at eight places: its middle must be seen where a pinhole sees the point."""
    with CameraRig(strip_street().mesh, (CAMERA,), seats=1) as rig:
        for number, (yaw, along, aside) in enumerate(itertools.product((0.0, 2.5), (6.0, 10.0), (-1.5, 2.0))):
            here = plant_state(30.0, 0.0, yaw=yaw)
            ahead, left = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
            x, y = here.p_WB_m[:2] + along * ahead + aside * left
            one = actor(kind, x, y, 0.0, yaw + math.pi / 2, speed=0.0, number=number)
            point = np.array([x, y, 0.62 * one.size_lwh_m[2]])
            T_CW = camera_matrix(pose_matrix(here.p_WB_m, here.q_WB), mount(CAMERA))
            cx, cy, cz = T_CW @ [*point, 1.0]
            hole = pinhole(CAMERA)
            u = int(hole.focal_px * cx / cz + hole.width_px / 2)
            v = int(hole.focal_px * cy / cz + hole.height_px / 2)
            assert 0 <= u < hole.width_px and 0 <= v < hole.height_px, "the test must ask for a pixel of the picture"
            frame = shoot(rig, here, (one,), tick=number)[0]
            assert frame.class_id[v, u] in classes
            assert cz - slack_m <= frame.depth_m[v, u] <= cz + 0.1
            empty = shoot(rig, here, tick=100 + number)[0]
            assert empty.class_id[v, u] not in classes and empty.depth_m[v, u] > frame.depth_m[v, u] + 0.3


def camera_of(store, focal_px: float, width_px: int = 160, height_px: int = 120) -> FreeCamera:
    return FreeCamera(
        store, Pinhole(width_px=width_px, height_px=height_px, focal_px=focal_px, near_m=0.1, range_m=60.0)
    )


def silhouette(store, kind, look, size) -> tuple[np.ndarray, np.ndarray]:
    """Class and depth from the side ahead, everything scaled to the same box, so that shape alone counts."""
    one = replace(actor(kind, 30.0, 0.0, 20.0, yaw=-2.5, speed=0.0, size=size), look=look)
    view = look_at((24.0, -1.0, 21.2), (30.0, 0.0, 20.8))
    images = camera_of(store, 150.0).look(view, actor_instances([one]))
    return images.class_id, images.depth_m


def test_every_two_shapes_differ_in_class_or_depth(store):
    """Taxi and police car are cars: they differ in colour and in the thing on their roofs."""
    pieces = (ActorLook.FRONT, ActorLook.MIDDLE, ActorLook.REAR)  # these are made to look like parts of the whole
    shapes = [(kind, look) for kind in ActorKind for look in ActorLook if look not in pieces]
    shapes = [s for s in shapes if s[1] is ActorLook.USUAL or template_of(*s) is not template_of(s[0])]
    pictures = {shape: silhouette(store, *shape, (3.0, 1.2, 1.6)) for shape in shapes}
    for (a, (class_a, depth_a)), (b, (class_b, depth_b)) in itertools.combinations(pictures.items(), 2):
        seen = (class_a != ClassId.SKY) | (class_b != ClassId.SKY)
        differs = (class_a != class_b) | (np.abs(depth_a - depth_b) > 0.05)
        assert (differs & seen).sum() > 0.02 * seen.sum(), f"{a} looks like {b}"


def test_riders_are_riders_and_what_they_ride_is_not(store):
    for kind, thing in ((ActorKind.MOTORCYCLE, 32), (ActorKind.BICYCLE, 33), (ActorKind.SCOOTER, 32)):
        class_id, _ = silhouette(store, kind, ActorLook.USUAL, SIZES[kind])
        rows = [np.nonzero(class_id == number)[0].mean() for number in (ClassId.RIDER, thing)]
        assert rows[0] < rows[1] - 5, "the rider is above"
    moped, _ = silhouette(store, ActorKind.MOTORCYCLE, ActorLook.MOPED, (2.1, 0.78, 1.7))
    assert {ClassId.RIDER, ClassId.MOTORCYCLE} <= set(moped.ravel().tolist())


def test_a_taxi_is_yellow_and_a_police_car_has_a_blue_light(store):
    camera = camera_of(store, 120.0)

    def share(look, wanted):
        found = []
        for number in range(6):
            one = replace(actor(ActorKind.CAR, 30.0, 0.0, number=number), look=look)
            images = camera.look(look_at((24.0, -3.0, 1.4), (30.0, 0.0, 0.8)), actor_instances([one]))
            pixels = images.rgb[images.class_id == ClassId.CAR].astype(int)
            found.append(wanted(*pixels.T).mean())
        return min(found)

    assert share(ActorLook.TAXI, lambda r, g, b: (r > 1.15 * g) & (g > 2 * b)) > 0.35
    assert share(ActorLook.POLICE, lambda r, g, b: (b > 1.5 * r) & (b > 100)) > 0.03


def legs(store, phase_m: float, speed: float, size=(0.29, 0.51, 1.78)) -> float:
    """How far apart the feet are along the way, metres, seen from the side."""
    camera = camera_of(store, 900.0, 240, 320)
    one = actor(ActorKind.PEDESTRIAN, 30.0 + phase_m, 0.0, 20.0, speed=speed, size=size)
    images = camera.look(look_at((30.0 + phase_m, -6.0, 20.9), (30.0 + phase_m, 0.0, 20.9)), actor_instances([one]))
    rows, columns = np.nonzero(images.class_id == ClassId.PERSON)
    feet = columns[rows > rows.max() - 0.12 * np.ptp(rows)]
    return float(np.ptp(feet) * 6.0 / 900.0)


def test_legs_move_with_the_distance_walked_and_stand_when_standing(store):
    walking = [legs(store, 0.05 * k, 1.3) for k in range(30)]
    assert 0.8 < max(walking) < 1.1 and min(walking) < 0.4, "a step of 0.7 m and a shoe"
    standing = {round(legs(store, 0.05 * k, 0.0), 2) for k in range(8)}
    assert max(standing) < 0.3 and len(standing) <= 2
    child = [legs(store, 0.05 * k, 1.2, (0.2, 0.34, 1.22)) for k in range(30)]
    assert 0.4 < max(child) < 0.75 * max(walking), "a child takes smaller steps"


def test_children_are_small_grown_ups_are_of_two_kinds_and_nobody_changes():
    heights = np.array([1.1, 1.3, 1.65, 1.78] * 50)
    seeds = np.random.default_rng(1).integers(0, 2**32, 200, dtype=np.uint32)
    chosen = _figures(heights, seeds)
    assert set(chosen[heights < 1.4].tolist()) == {2}
    assert 0.3 < chosen[heights > 1.4].mean() < 0.7
    assert np.array_equal(chosen, _figures(heights, seeds))


def test_a_look_that_does_not_fit_a_kind_is_the_usual_one():
    assert template_of(ActorKind.PEDESTRIAN, ActorLook.TAXI) is Template.PEDESTRIAN
    assert template_of(ActorKind.OTHER, ActorLook.REAR) is Template.OTHER
    assert template_of(ActorKind.TRUCK, ActorLook.VAN) is Template.DELIVERY
