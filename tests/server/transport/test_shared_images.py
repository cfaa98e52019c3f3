import os
import stat
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.barrier.fake_world import FakeWorld
from tests.support.worlds import quick_config
from wcsim.config import CameraConfig
from wcsim.errors import ConfigError, DiskFullError, PicturesError, ProtocolError
from wcsim.server.protocol import messages as m
from wcsim.server.specs import WorldBuildSpec
from wcsim.server.transport.shared_images import SharedImageReader, SharedImageWriter
from wcsim.types import Command, Joystick, SeatSpec

ONE = quick_config("cameras.0.rgb=true")
BACK = CameraConfig(name="back", width_px=20, height_px=17)
CONFIG = ONE.model_copy(update={"cameras": (*ONE.cameras, BACK)})
PICTURES = CONFIG.cameras


SHORT = (SeatSpec(max_steps=2),)


def a_world(specs=SHORT):
    return FakeWorld(WorldBuildSpec(town="x", config=CONFIG, seed=1), specs, 1)


def drive(world, sink):
    sink.select_slot(world.snapshot.tick + 1)
    now = world.snapshot
    return world.tick(tuple(Command(seat=c.seat, tick=now.tick, joystick=Joystick(0, 1)) for c in now.clients), sink)


def opened(view, client, slot):
    """The frame as it comes out at the other end."""
    frame = m.decode_reply(m.encode_message(m.Frame(0, client.tick, 0, client, slot)), view)
    assert isinstance(frame, m.Frame)
    return frame.client


def test_a_client_sees_what_the_cameras_wrote_and_the_frame_before_stands(tmp_path):
    sink, world, alone = SharedImageWriter(tmp_path, 1, PICTURES), a_world(), a_world()
    view = SharedImageReader(sink.path(0))
    alone_commands = (Command(seat=0, tick=0, joystick=Joystick(0, 1)),)
    one = drive(world, sink).clients[0]
    seen_one = opened(view, one, sink.slot(1))
    expected_one = alone.tick(alone_commands).clients[0]
    assert seen_one == expected_one
    kept = [camera.depth_m.copy() for camera in seen_one.sensors.cameras]
    two = drive(world, sink).clients[0]  # the episode ends: with the first frame of the next one
    assert two.first is not None
    seen_two = opened(view, two, sink.slot(2))
    expected_two = alone.tick((replace(alone_commands[0], tick=1),)).clients[0]
    assert seen_two == expected_two
    assert seen_two.first == expected_two.first
    assert not np.shares_memory(seen_two.first.sensors.cameras[0].depth_m, seen_two.sensors.cameras[0].depth_m)
    assert all(np.array_equal(a, c.depth_m) for a, c in zip(kept, seen_one.sensors.cameras, strict=True))


def test_first_frames_of_joins_and_respawns_have_a_place_of_their_own(tmp_path):
    sink, world = SharedImageWriter(tmp_path, 2, PICTURES), a_world((SeatSpec(), None))
    view = SharedImageReader(sink.path(1))
    sink.select_slot(0)
    first = world.admit(1, SeatSpec(), sink)
    seen = opened(view, first, 0)
    assert seen == first
    assert seen.sensors.cameras[0].class_id[0, 0] == 1


def test_pictures_can_be_read_only_and_their_file_is_its_owners_alone(tmp_path):
    folder = tmp_path / "ring"
    sink = SharedImageWriter(folder, 1, PICTURES)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert stat.S_IMODE(sink.path(0).stat().st_mode) == 0o600
    world = a_world()
    client = view_of(sink, world)
    for camera in client.sensors.cameras:
        for image in (camera.depth_m, camera.class_id, *([] if camera.rgb is None else [camera.rgb])):
            assert not image.flags.writeable
            assert image.flags.aligned
    assert client.sensors.cameras[0].rgb.shape == (24, 32, 3)


def view_of(sink, world):
    client = drive(world, sink).clients[0]
    return opened(SharedImageReader(sink.path(0)), client, sink.slot(1))


def test_a_new_server_leaves_the_pictures_of_the_old_one_to_those_who_look_at_them(tmp_path):
    old = SharedImageWriter(tmp_path, 1, PICTURES)
    seen = view_of(old, a_world())
    before = seen.sensors.cameras[0].depth_m.copy()
    new = SharedImageWriter(tmp_path, 1, PICTURES)
    new.buffers(0, first=False)[0].depth_m[:] = 7.0
    assert np.array_equal(seen.sensors.cameras[0].depth_m, before)
    assert new.path(0) == old.path(0)
    assert [path.name for path in tmp_path.iterdir()] == ["seat-0"]


def test_what_is_no_ring_is_refused(tmp_path):
    sink = SharedImageWriter(tmp_path, 1, PICTURES)
    whole = sink.path(0).read_bytes()
    path = tmp_path / "other"
    for data in (b"", b"x" * 100, b"y" * 5000, whole[:-64], whole[:8] + b"\x09" + whole[9:], whole + b"\0"):
        path.write_bytes(data)
        with pytest.raises(ProtocolError, match="other"):
            SharedImageReader(path)
    with pytest.raises(ProtocolError, match="same machine"):
        SharedImageReader(tmp_path / "missing")
    client = drive(a_world(), sink).clients[0]
    view = SharedImageReader(sink.path(0))
    with pytest.raises(ProtocolError, match="<= 1"):
        opened(view, client, 2)
    with pytest.raises(ProtocolError, match="slot 2"):
        view.pictures(2, first=False)
    few = replace(client, sensors=replace(client.sensors, cameras=client.sensors.cameras[:1]))
    with pytest.raises(ProtocolError, match="1 cameras"):
        opened(view, few, 0)


def test_no_room_is_said_at_once(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(DiskFullError, match="No space left"):
        SharedImageWriter(tmp_path, 1, PICTURES)
    assert not any(tmp_path.iterdir())


def test_a_ring_has_the_same_bounds_for_who_writes_and_who_reads_it(tmp_path, monkeypatch):
    camera = CONFIG.cameras[0].model_copy(update={"width_px": 16, "height_px": 12})
    most = (camera,) * 64
    assert len(SharedImageReader(SharedImageWriter(tmp_path, 1, most).path(0)).pictures(0, first=True)) == 64
    more = (camera,) * 65
    with pytest.raises(ConfigError, match="65 of them; expected 64 at most"):
        SharedImageWriter(tmp_path, 1, more)
    monkeypatch.setattr("wcsim.server.transport.shared_images._fault", lambda pictures: "")
    path = SharedImageWriter(tmp_path, 1, more).path(0)
    monkeypatch.undo()
    with pytest.raises(PicturesError, match="65 cameras"):
        SharedImageReader(path)
