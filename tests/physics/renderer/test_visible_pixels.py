"""Who is who in a picture: the image of instances, and how many pixels each actor has in it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.physics.renderer.render_oracle import CAMERA, actor, crowd
from tests.physics.rig import shoot
from tests.physics.sensors.test_camera import SMALL, plant
from tests.support.samples import USUAL_OUTLINE, strip_street
from wcsim.config import CameraConfig
from wcsim.physics.buffers import Images, new_images
from wcsim.physics.renderer.instances import actor_instances, chair_pose
from wcsim.physics.renderer.tiny_renderer import TinyRenderer, corner_shift
from wcsim.physics.sensors.camera import CameraRig, _shown_px
from wcsim.physics.sensors.camera_geometry import look_along
from wcsim.types import ActorKind, ActorLook, ClassId

MOBILE = (
    ClassId.PERSON, ClassId.RIDER, ClassId.CAR, ClassId.TRUCK, ClassId.BUS, ClassId.TRAIN, ClassId.MOTORCYCLE,
    ClassId.BICYCLE, ClassId.DYNAMIC,
)  # fmt: skip
POSES = [look_along((x, 5.5 * side, 1.1), yaw, -0.15) for x, side, yaw in ((0, 1, 0.0), (30, -1, 0.4), (60, 0, 3.0))]


def shot(renderer, T_CW, actors, rgb=False, instance=True) -> Images:
    out = new_images(320, 240, rgb=rgb, instance=instance)
    renderer.render(CAMERA, T_CW, actor_instances(actors), out)
    return out


@pytest.mark.parametrize("T_CW", POSES)
def test_the_pixels_of_all_actors_are_those_of_the_mobile_classes(raster, T_CW):
    """The sample street has nothing of these classes that stands; so each of their pixels is somebody's."""
    actors = crowd(4)
    out = shot(raster, T_CW, actors)
    mobile = np.isin(out.class_id, MOBILE)
    assert mobile.sum() > 2000
    np.testing.assert_array_equal(out.instance >= 0, mobile)
    for kind, class_id in (
        (ActorKind.PEDESTRIAN, ClassId.PERSON),
        (ActorKind.CAR, ClassId.CAR),
        (ActorKind.BUS, ClassId.BUS),
        (ActorKind.TRAM, ClassId.TRAIN),
        (ActorKind.TRUCK, ClassId.TRUCK),
    ):
        rows = [i for i, one in enumerate(actors) if one.kind is kind]
        theirs = np.isin(out.instance, rows)
        assert (out.class_id[theirs] == class_id).all()
        if kind is not ActorKind.PEDESTRIAN:  # riders and wheelchairs' users are people too
            np.testing.assert_array_equal(theirs, out.class_id == class_id)


def test_every_pixel_is_that_of_the_nearest_actor(raster):
    """Against pictures of one actor at a time."""
    actors, T_CW = crowd(5, 30), POSES[0]
    together = shot(raster, T_CW, actors)
    alone = np.stack([np.where((o := shot(raster, T_CW, [one])).instance == 0, o.depth_m, np.inf) for one in actors])
    street = shot(raster, T_CW, []).depth_m
    expected = np.where(alone.min(axis=0) < street, alone.argmin(axis=0), -1)
    assert len(np.unique(expected)) > 6
    assert (together.instance == expected).mean() > 0.999  # two at the same depth may be either


@pytest.mark.parametrize("rgb", [False, True])
def test_asking_who_is_who_changes_no_picture(raster, rgb):
    with_it, without = (shot(raster, POSES[0], crowd(6), rgb, instance) for instance in (True, False))
    assert without.instance is None
    assert with_it.depth_m.tobytes() == without.depth_m.tobytes()
    assert with_it.class_id.tobytes() == without.class_id.tobytes()
    assert not rgb or with_it.rgb.tobytes() == without.rgb.tobytes()


def test_nobody_is_seen_beyond_the_range(raster):
    out = shot(raster, look_along((0, 0, 1), 0.0, 0.0), [actor(ActorKind.BUS, 60.0, 0.0)])
    assert (out.instance == -1).all()
    out = shot(raster, look_along((0, 0, 1), 0.0, 0.0), [actor(ActorKind.BUS, CAMERA.range_m, 3.0, yaw=0.0)])
    np.testing.assert_array_equal(out.instance == 0, out.class_id == ClassId.BUS)  # its rear alone is in range
    assert (out.instance == 0).sum() > 0


def test_the_reference_back_end_tells_the_same(store, raster):
    actors = crowd(1)
    with TinyRenderer(store) as tiny:
        for T_CW in (look_along((9.0, -3.2, 1.5), 0.3, -0.1), look_along((33.0, 0.7, 1.7), 2.9, -0.1)):
            theirs = shot(tiny, T_CW, actors)
            mine = shot(raster, corner_shift(T_CW, CAMERA.focal_px), actors)
            assert len(np.unique(mine.instance)) > 6
            assert (mine.instance == theirs.instance).mean() > 0.995


def test_pixels_are_those_of_320x240_whatever_the_size():
    numbers = np.full((60, 80), -1, np.int32)
    numbers[10, :5], numbers[11, :2], numbers[12, 0], numbers[13, :9] = 0, 1, 2, 3
    assert _shown_px(numbers, ("a", "b", "a")) == {"a": 16.0 * 6, "b": 16.0 * 2}  # the last row is nobody's
    assert _shown_px(np.full((240, 320), 1, np.int32), ("a", "b")) == {"b": 76800.0}
    assert _shown_px(numbers, ()) == {}


@pytest.mark.parametrize("size", [(640, 480), (160, 120), (80, 60)])
def test_the_same_actor_has_as_many_in_pictures_of_all_sizes(size):
    cameras = tuple(CameraConfig(name=str(w), width_px=w, height_px=h) for w, h in ((320, 240), size))
    person = (actor(ActorKind.PEDESTRIAN, 5.0, 5.2, 0.12, number=1),)
    shown = []
    for camera in cameras:
        with CameraRig(strip_street().mesh, (camera,), seats=1) as rig:
            shoot(rig, plant(), person, counted=True)
            shown.append(rig.shown_px(0)["pedestrian1"])
    assert shown[1] == pytest.approx(shown[0], rel=0.15)


def test_a_rig_counts_actors_and_other_chairs_in_all_its_cameras(store):
    left = SMALL.model_copy(update={"name": "left", "yaw_deg": 90.0})
    tram = actor(ActorKind.TRAM, 14.0, 0.0, number=1)
    pieces = (
        replace(tram, size_lwh_m=(9.0, 2.4, 3.2), look=ActorLook.FRONT),
        replace(tram, id="tram1~1", p_W_m=np.array([5.0, 0.0, 0.0]), piece=1, size_lwh_m=(9.0, 2.4, 3.2)),
    )
    actors = (*pieces, actor(ActorKind.CAR, 0.5, 11.0, 0.12), actor(ActorKind.BUS, -12.0, 5.5))  # beside, behind
    chairs = tuple(chair_pose(seat, plant(4.0 * seat), USUAL_OUTLINE) for seat in range(2))
    with CameraRig(store, (SMALL, left), seats=2) as rig:
        shoot(rig, plant(), actors, chairs, counted=True)
        both = rig.shown_px(0)
        assert set(both) == {"tram1", "car0", "w:1"}
        shoot(rig, plant(), actors, chairs, tick=1)
        assert rig.shown_px(0) == {}
    with CameraRig(store, (SMALL,), seats=2) as rig:
        shoot(rig, plant(), actors, chairs, counted=True)
        assert set(rig.shown_px(0)) == {"tram1", "w:1"} and rig.shown_px(1) == {}
        assert rig.shown_px(0)["w:1"] == both["w:1"]


def test_a_camera_that_repeats_its_picture_shows_what_is_in_it(store):
    slow = SMALL.model_copy(update={"every_ticks": 3})
    car = (actor(ActorKind.CAR, 6.0, 5.5, 0.12),)
    with CameraRig(store, (slow,), seats=1) as rig:
        for tick, actors in ((0, car), (1, ()), (2, ()), (3, ())):
            shoot(rig, plant(), actors, tick=tick, counted=True)
            assert bool(rig.shown_px(0)) == (tick < 3)


def test_a_bus_behind_a_house_is_not_shown(store):
    """The house stands from x = 50 to 70 m and y = 9 to 19 m."""
    with CameraRig(store, (SMALL,), seats=1) as rig:
        bus, north = actor(ActorKind.BUS, 60.0, 23.0, 0.12), math.pi / 2
        shoot(rig, plant(60.0, 0.0, 0.0, north), (bus,), counted=True)
        assert rig.shown_px(0) == {}
        before = replace(bus, p_W_m=np.array([60.0, 6.0, 0.12]))
        shoot(rig, plant(60.0, 0.0, 0.0, north), (before,), tick=1, counted=True)
        assert rig.shown_px(0)["bus0"] > 1000.0
