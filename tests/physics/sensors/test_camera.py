"""The camera rig: where cameras look, when they shoot, and whose buffers they use."""

import itertools
import math
import threading
from dataclasses import replace

import numpy as np
import pytest

from tests.physics.renderer.render_oracle import actor
from tests.physics.rig import shoot
from tests.support.plants import plant_state
from tests.support.samples import USUAL_OUTLINE
from wcsim.agents.perception.depth_image import viewing_rays
from wcsim.config import CameraConfig
from wcsim.core.frames import quaternion_from_ypr
from wcsim.errors import ConfigError
from wcsim.physics.buffers import new_images
from wcsim.physics.renderer.instances import actor_instances, chair_pose
from wcsim.physics.renderer.raster import RasterRenderer
from wcsim.physics.sensors.base import Surroundings
from wcsim.physics.sensors.camera import CameraRig, FreeCamera
from wcsim.physics.sensors.camera_geometry import camera_matrix, focal_px, look_at, mount, pinhole, pose_matrix
from wcsim.types import ActorKind, ClassId

SMALL = CameraConfig(name="front", width_px=80, height_px=60)


def plant(x=0.0, y=5.5, z=0.12, yaw=0.0, pitch=0.0, roll=0.0):
    return plant_state(x, y, z, yaw, pitch, roll)


def seen(T_CW, p_W):
    """Right, down and ahead of a point, seen from a camera."""
    return T_CW[:, :3] @ np.asarray(p_W, float) + T_CW[:, 3]


def test_the_default_camera_sits_at_knee_height_and_looks_down():
    T_CW = camera_matrix(np.eye(3, 4), mount(CameraConfig()))
    assert seen(T_CW, (0.35, 0.0, 1.0)) == pytest.approx([0, 0, 0], abs=1e-12)
    down = math.radians(15)
    ahead = (0.35 + 5 * math.cos(down), 0.0, 1.0 - 5 * math.sin(down))
    assert seen(T_CW, ahead) == pytest.approx([0, 0, 5])
    assert seen(T_CW, (3.0, -1.0, 0.5))[0] > 0  # what is on the right of the chair is on the right
    assert seen(T_CW, (3.0, 0.0, 0.0))[1] > seen(T_CW, (3.0, 0.0, 1.0))[1]  # y points down


def test_a_camera_turns_with_its_yaw_and_with_its_chair():
    left = camera_matrix(np.eye(3, 4), mount(CameraConfig(yaw_deg=90.0, pitch_deg=0.0)))
    assert seen(left, (0.35, 4.0, 1.0)) == pytest.approx([0, 0, 4])
    turned = pose_matrix(np.array([1.0, 2.0, 0.0]), np.array(quaternion_from_ypr(math.pi / 2)))
    ahead = camera_matrix(turned, mount(CameraConfig(pitch_deg=0.0)))
    assert seen(ahead, (1.0, 2.35 + 3.0, 1.0)) == pytest.approx([0, 0, 3])


def test_a_rolled_camera_sees_the_street_turned_the_other_way():
    level = CameraConfig(pitch_deg=-15.0, yaw_deg=20.0)
    rolled = camera_matrix(np.eye(3, 4), mount(level.model_copy(update={"roll_deg": 90.0})))
    straight = camera_matrix(np.eye(3, 4), mount(level))
    for point in ((3.0, -1.0, 0.5), (4.0, 2.0, 0.0)):
        right, down, ahead = seen(straight, point)
        assert seen(rolled, point) == pytest.approx([down, -right, ahead])  # its right side is where down was
    rays = viewing_rays(CameraConfig(width_px=8, height_px=8, roll_deg=25.0, yaw_deg=-40.0, pitch_deg=10.0))
    own = camera_matrix(np.eye(3, 4), mount(CameraConfig(roll_deg=25.0, yaw_deg=-40.0, pitch_deg=10.0)))
    assert (own[:, :3] @ rays.T)[2] == pytest.approx(np.ones(64))
    first = (own[:, :3] @ rays[0])[:2]
    assert first[0] < 0.0 and first[1] < 0.0, "the first pixel is at the top left"


def test_focal_length_gives_the_field_of_view():
    camera = pinhole(CameraConfig(width_px=320, hfov_deg=87.0))
    assert math.degrees(2 * math.atan(160 / camera.focal_px)) == pytest.approx(87.0)
    assert focal_px(100, math.pi / 2) == pytest.approx(50.0)


def test_the_camera_is_fixed_to_the_chair_in_pitch_and_roll(mesh):
    with CameraRig(mesh, (SMALL,), seats=1) as rig:
        level = shoot(rig, plant())[0].depth_m.copy()
        nose_up = shoot(rig, plant(pitch=math.radians(10)), tick=1)[0].depth_m.copy()
        rolled = shoot(rig, plant(roll=math.radians(10)), tick=2)[0].depth_m
        assert nose_up[59, 40] > level[59, 40]  # looks less steeply at the ground
        # Rolled to the right, the right half looks at nearer ground.
        assert rolled[59, 79] < level[59, 79] and rolled[59, 0] > level[59, 0]


def test_a_slower_camera_repeats_its_image_and_reset_wakes_it(mesh):
    slow = CameraConfig(name="slow", width_px=40, height_px=30, every_ticks=3)
    with CameraRig(mesh, (SMALL, slow), seats=1) as rig:
        taken = [shoot(rig, plant(x=tick), tick=tick) for tick in range(7)]
        assert [frames[0].taken_tick for frames in taken] == list(range(7))
        assert [frames[1].taken_tick for frames in taken] == [0, 0, 0, 3, 3, 3, 6]
        assert taken[4][1] is taken[3][1]
        rig.reset(0)
        assert shoot(rig, plant(), tick=7)[1].taken_tick == 7


def test_a_lost_picture_leaves_the_one_before_and_each_tick_has_its_chance(mesh):
    lossy = CameraConfig(name="lossy", width_px=40, height_px=30, lost_share=0.4)
    with CameraRig(mesh, (lossy,), seats=2) as rig:
        rig.begin(5)
        taken = [[shoot(rig, plant(x=tick), tick=tick, seat=s)[0].taken_tick for tick in range(200)] for s in (0, 1)]
        rig.begin(5)
        again = [shoot(rig, plant(x=tick), tick=tick)[0].taken_tick for tick in range(200)]
    assert taken[0] == again != taken[1]
    assert taken[0][0] == 0 and all(a in (b, tick) for tick, (b, a) in enumerate(itertools.pairwise(taken[0]), 1))
    assert sum(at != tick for tick, at in enumerate(taken[0])) == pytest.approx(80, abs=25)


def test_frames_outlive_two_more_shots_of_their_camera(mesh):
    with CameraRig(mesh, (SMALL,), seats=2) as rig:
        first = shoot(rig, plant())[0]
        kept = first.depth_m.copy()
        shoot(rig, plant(x=50.0, yaw=0.5), tick=1)
        shoot(rig, plant(x=50.0, yaw=0.7), tick=2)
        shoot(rig, plant(x=50.0, yaw=1.0), tick=2, seat=1)
        assert np.array_equal(first.depth_m, kept)
        shoot(rig, plant(x=50.0, yaw=0.5), tick=3)
        assert not np.array_equal(first.depth_m, kept)


def test_images_go_into_given_buffers_also_when_they_are_repeated(mesh):
    slow = CameraConfig(width_px=40, height_px=30, every_ticks=2, rgb=True)
    with CameraRig(mesh, (slow,), seats=1) as rig:
        a, b = new_images(40, 30, True), new_images(40, 30, True)
        first = shoot(rig, plant(), buffers=(a,))[0]
        again = shoot(rig, plant(), tick=1, buffers=(b,))[0]
        assert np.may_share_memory(first.depth_m, a.depth_m) and np.may_share_memory(again.depth_m, b.depth_m)
        assert again.taken_tick == 0
        for name in ("depth_m", "class_id", "rgb"):
            assert np.array_equal(getattr(a, name), getattr(b, name))
        assert np.may_share_memory(again.rgb, b.rgb)
        with pytest.raises(ConfigError, match="new_images"):
            shoot(rig, plant(), tick=2, buffers=(new_images(41, 30, True),))


def test_colours_are_taken_only_when_asked_for(mesh):
    coloured = CameraConfig(name="colour", width_px=40, height_px=30, rgb=True)
    with CameraRig(mesh, (SMALL, coloured), seats=1) as rig:
        plain, colour = shoot(rig, plant())
        assert plain.rgb is None
        assert colour.rgb is not None and colour.rgb.shape == (30, 40, 3) and colour.rgb.std() > 5


def test_a_chair_sees_the_others_but_not_itself(mesh):
    chairs = [chair_pose(seat, plant(3.0 * seat), USUAL_OUTLINE) for seat in range(2)]
    with CameraRig(mesh, (SMALL,), seats=2) as rig:
        me = shoot(rig, plant(), (), chairs[:1])[0].class_id.copy()
        both = shoot(rig, plant(), (), chairs, tick=1)[0].class_id
        assert not np.isin(me, (ClassId.PERSON, ClassId.DYNAMIC)).any()
        assert (both == ClassId.PERSON).any() and (both == ClassId.DYNAMIC).any()


def test_new_actors_are_seen_at_once_and_a_changed_list_too(mesh):
    with CameraRig(mesh, (SMALL,), seats=1) as rig:
        cars = [actor(ActorKind.CAR, 6.0, 5.5, 0.12)]
        assert (shoot(rig, plant(), tuple(cars))[0].class_id == ClassId.CAR).any()
        assert not (shoot(rig, plant(), tick=1)[0].class_id == ClassId.CAR).any()
        moving = []
        shoot(rig, plant(), moving, tick=2)
        moving.append(cars[0])
        assert (shoot(rig, plant(), moving, tick=3)[0].class_id == ClassId.CAR).any()


def test_two_rigs_draw_the_same_bytes(mesh):
    cars = (actor(ActorKind.CAR, 6.0, 2.0, 0.0, 0.4), actor(ActorKind.PEDESTRIAN, 5.0, 5.0, 0.12, 2.0))
    camera = SMALL.model_copy(update={"rgb": True})
    with CameraRig(mesh, (camera,), seats=1) as one, CameraRig(mesh, (camera,), seats=1) as two:
        a, b = shoot(one, plant(), cars)[0], shoot(two, plant(), cars)[0]
        assert a.depth_m.tobytes() == b.depth_m.tobytes()
        assert a.class_id.tobytes() == b.class_id.tobytes() and a.rgb.tobytes() == b.rgb.tobytes()


def test_the_reference_back_end_is_one_word_in_the_configuration(mesh):
    tiny = SMALL.model_copy(update={"renderer": "pybullet", "name": "tiny"})
    with CameraRig(mesh, (SMALL, tiny), seats=1) as rig:
        mine, other = shoot(rig, plant(), (actor(ActorKind.CAR, 6.0, 5.5, 0.12),))
        assert (mine.class_id == other.class_id).mean() > 0.95  # sample points differ by half a pixel


def test_a_rig_needs_cameras_and_seats(mesh):
    with pytest.raises(ConfigError, match="at least one"):
        CameraRig(mesh, (), seats=1)
    with pytest.raises(ConfigError, match="at least one"):
        CameraRig(mesh, (SMALL,), seats=0)
    with pytest.raises(ConfigError, match="-1 threads"):
        CameraRig(mesh, (SMALL,), seats=1, threads=-1)


def test_a_free_camera_has_its_target_in_the_middle(mesh):
    camera = FreeCamera(mesh, pinhole(CameraConfig(width_px=81, height_px=61)))
    images = camera.look(look_at((0, 0, 1.5), (8, 3, 0.5)), actor_instances([actor(ActorKind.OTHER, 8, 3)]))
    assert images.class_id[30, 40] == ClassId.DYNAMIC and images.rgb is not None


PLACES = [(1.5 * seat, 5.5 - 0.8 * (seat % 2)) for seat in range(5)]
PEOPLE = tuple(actor(ActorKind.PEDESTRIAN, 5.0 + 0.3 * i, 3.0 + 0.4 * i, 0.12, number=i) for i in range(8))


def scenes(tick):
    """Five chairs that see each other and a crowd, every other one looks back; two of them count whom they see."""
    turns = [0.1 * seat + math.pi * (seat % 2) for seat in range(len(PLACES))]
    plants = [plant(x + 0.1 * tick, y, yaw=yaw) for (x, y), yaw in zip(PLACES, turns, strict=True)]
    chairs = tuple(chair_pose(seat, here, USUAL_OUTLINE) for seat, here in enumerate(plants))
    return {
        seat: Surroundings(
            tick=tick, plant=here, actors=PEOPLE, chairs=chairs, signals=(), buffers=None, counted=seat % 2 == 1
        )
        for seat, here in enumerate(plants)
    }


def taken(mesh, threads, together, ticks=4):
    """What five chairs with a noisy colour camera and a slow one saw: all bytes, and whom they counted."""
    bright = CameraConfig(name="colour", width_px=64, height_px=48, rgb=True, noise="typical")
    slow = CameraConfig(name="slow", width_px=40, height_px=30, every_ticks=2, yaw_deg=40.0)
    seen = []
    with CameraRig(mesh, (bright, slow), len(PLACES), threads=threads) as rig:
        rig.begin(3)
        rig.mount(1, (bright, slow), 0.6)
        for tick in range(ticks):
            now = scenes(tick)
            if together:
                rig.shoot_all(now)
            for seat, scene in now.items():
                for frame in rig.frames(seat, scene):
                    colours = b"" if frame.rgb is None else frame.rgb.tobytes()
                    seen.append((frame.taken_tick, frame.depth_m.tobytes(), frame.class_id.tobytes(), colours))
                seen.append(rig.shown_px(seat))
    return seen


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_pictures_are_the_same_bytes_with_any_number_of_threads_and_taken_one_by_one(mesh, threads):
    alone = taken(mesh, 1, together=False)
    assert any(shown for shown in alone if isinstance(shown, dict)), "nobody was counted"
    assert taken(mesh, threads, together=True) == alone


def rig_of(mesh, threads):
    return CameraRig(mesh, (SMALL,), len(PLACES), threads=threads)


def shown_of(rig, pair):
    return [(rig.frames(seat, scene)[0].depth_m.tobytes(), rig.shown_px(seat)) for seat, scene in pair.items()]


def test_two_pictures_at_once_do_not_meet(mesh, monkeypatch):
    pair = {seat: scene for seat, scene in scenes(0).items() if scene.counted}
    with rig_of(mesh, 2) as rig:
        alone = shown_of(rig, pair)
    assert len(pair) == 2 and alone[0] != alone[1] and alone[0][1]
    with rig_of(mesh, 2) as rig:
        both, render = threading.Barrier(2, timeout=20.0), RasterRenderer.render

        def drawn_and_waited(*all):
            render(*all)
            both.wait()  # neither goes on before the other has drawn

        monkeypatch.setattr(RasterRenderer, "render", drawn_and_waited)
        rig.shoot_all(pair)
        seen = shown_of(rig, pair)
    assert seen == alone


def test_pictures_taken_together_are_not_taken_again(mesh, monkeypatch):
    shots = []
    render = RasterRenderer.render
    monkeypatch.setattr(RasterRenderer, "render", lambda *all: shots.append(1) or render(*all))
    with rig_of(mesh, 2) as rig:
        del shots[:]  # one to warm up
        now = scenes(0)
        rig.shoot_all(now)
        frames = [rig.frames(seat, scene)[0] for seat, scene in now.items()]
        assert len(shots) == len(PLACES) and rig.frames(2, now[2])[0] is frames[2]
        rig.frames(2, scenes(1)[2])
        assert len(shots) == len(PLACES) + 1


def test_buffers_that_do_not_fit_are_refused_in_every_thread(mesh):
    with rig_of(mesh, 3) as rig:
        wrong = (new_images(40, 30, False),)
        with pytest.raises(ConfigError, match="new_images"):
            rig.shoot_all({seat: replace(scene, buffers=wrong) for seat, scene in scenes(0).items()})
        assert shoot(rig, plant(), tick=1)[0].taken_tick == 1
