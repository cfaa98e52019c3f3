"""A journal as an MCAP file: commands have the stamps of the sticks they answer, cameras move with episodes."""

import numpy as np
import pytest

from tests.bridge.recording.test_ros import messages, stamp_ns
from tests.support.journals import JournaledWorld
from wcsim.bridge.ego.randomization import moved
from wcsim.bridge.recording.convert import convert_to_mcap
from wcsim.physics.sensors.camera_geometry import mount
from wcsim.types import SeatSpec


@pytest.fixture(scope="module")
def bag(corner, tmp_path_factory):
    """By topic: stamp in ns and message; and what the clients saw before each tick: its time in ns, seat, frame."""
    folder = tmp_path_factory.mktemp("bag")
    saw = []
    with JournaledWorld(corner, folder, "vary.camera_shift_m=[-0.05,0.05]", seats=2) as it:
        cameras = it.world.config.cameras

        def drive(ticks):
            for _ in range(ticks):
                at = round(it.now.time_s * 1e9)
                saw.extend((at, client.seat, client.first or client) for client in it.now.clients)
                it.tick(1)

        it.admit(0, SeatSpec(profile="tremor", max_steps=6))
        drive(8)
        it.admit(1, SeatSpec(profile="tremor", max_steps=50))
        drive(3)
        it.respawn(1)
        drive(5)
    counts = convert_to_mcap(folder / "journal", folder / "a.mcap")
    found = {}
    for topic, _, at, message in messages(folder / "a.mcap"):
        found.setdefault(topic, []).append((at, message))
    return counts, found, saw, cameras


def test_a_command_and_the_stick_that_it_answers_have_one_stamp(bag):
    counts, found, saw, _ = bag
    assert len({frame.events.episode for _, seat, frame in saw if seat == 0}) >= 3
    for seat in (0, 1):
        mine = [(at, frame.user) for at, its, frame in saw if its == seat]
        for name in ("joy", "joy_command"):
            assert [at for at, _ in mine] == [stamp_ns(told.header) for _, told in found[f"/chair_{seat}/{name}"]]
        told = [told.axes.tolist() for _, told in found[f"/chair_{seat}/joy"]]
        assert told == [pytest.approx([-user.x, user.y]) for _, user in mine]
        assert counts[f"/chair_{seat}/joy"] == counts[f"/chair_{seat}/odom"] == len(mine)


def test_a_camera_is_where_its_episode_has_it(bag):
    _, found, saw, cameras = bag
    for at, seat, frame in saw:
        (camera,) = moved(cameras, frame.drawn)
        told = [t for stamp, m in found["/tf_static"] if stamp <= at for t in m.transforms]
        place = [t.transform for t in told if t.child_frame_id.startswith(f"chair_{seat}/camera_")][-1].translation
        assert np.allclose((place.x, place.y, place.z), camera.p_BC_m)
        assert np.allclose(mount(camera)[:, 3], camera.p_BC_m)
