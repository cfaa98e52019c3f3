"""MCAP files are read by somebody else's reader: as many messages as ticks, the right stamps, frames and numbers."""

import math
import struct
import sys
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from tests.log.drives import tick, write_drive
from wcsim.bridge.recording.ros_bag import RosBag
from wcsim.bridge.recording.ros_chairs import RosChair, _quaternion_of, drive_bag, trace_bag
from wcsim.config import resolve
from wcsim.core.frames import matrix_from_quaternion, quaternion_from_ypr
from wcsim.errors import ConfigError, JournalError
from wcsim.log.drive import read_drive
from wcsim.log.records import WorldState
from wcsim.physics.sensors.camera_geometry import mount
from wcsim.types import CameraFrame, Joystick

STORE = get_typestore(Stores.ROS2_HUMBLE)
TICKS = 1000


def messages(path):
    """(topic, kind, nanoseconds, message) of each message, in the order of their time."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
            made = STORE.deserialize_cdr(message.data, schema.name)
            yield channel.topic, schema.name, message.log_time, made


def stamp_ns(header):
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    ticks = [tick(k, warning=k == 7, helped=k == 9, yaw_rad=0.001 * k) for k in range(1, TICKS + 1)]
    drive = read_drive(write_drive(folder / "a.drive", ticks))
    counts = drive_bag(drive, folder / "a.mcap")
    return counts, list(messages(folder / "a.mcap")), folder


def test_a_drive_of_a_thousand_ticks_is_read_back(bag):
    counts, found, folder = bag
    assert counts == Counter(topic for topic, *_ in found)
    assert counts == {
        "/tf_static": 1, "/joy": TICKS, "/joy_intent": TICKS, "/joy_command": TICKS, "/odom": TICKS, "/tf": TICKS,
    }  # fmt: skip
    kinds = {topic: kind for topic, kind, *_ in found}
    assert kinds["/odom"] == "nav_msgs/msg/Odometry" and kinds["/tf"] == "tf2_msgs/msg/TFMessage"
    assert kinds["/joy"] == "sensor_msgs/msg/Joy"
    assert sorted(path.name for path in folder.iterdir()) == ["a.drive", "a.mcap"]


def test_stamps_are_those_of_the_ticks(bag):
    for topic, first in (("/odom", 1), ("/joy", 0)):
        rows = [(at, stamp_ns(message.header)) for name, _, at, message in bag[1] if name == topic]
        assert [stamp for _, stamp in rows] == [100_000_000 * k for k in range(first, first + TICKS)]
        assert all(at == stamp for at, stamp in rows)


def test_frames_and_numbers_are_those_of_rep_103_and_105(bag):
    by_topic = {}
    for topic, _, _, message in bag[1]:
        by_topic.setdefault(topic, []).append(message)
    odom = by_topic["/odom"][499]
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    place, turn = odom.pose.pose.position, odom.pose.pose.orientation
    assert (place.x, place.y, place.z) == (50.0, 2.0, 0.05)
    assert 2.0 * math.atan2(turn.z, turn.w) == pytest.approx(0.5)
    assert odom.twist.twist.linear.x == 1.0 and odom.twist.twist.angular.z == pytest.approx(0.01)
    (moved,) = by_topic["/tf"][499].transforms
    assert (moved.header.frame_id, moved.child_frame_id, moved.transform.translation.x) == ("odom", "base_link", 50.0)
    (fixed,) = by_topic["/tf_static"][0].transforms
    assert (fixed.header.frame_id, fixed.child_frame_id, fixed.transform.rotation.w) == ("map", "odom", 1.0)
    assert by_topic["/joy"][499].axes.tolist() == pytest.approx([-0.499, 0.5])  # to the left, as ROS has it
    assert by_topic["/joy_command"][6].buttons.tolist() == [1, 0] and by_topic["/joy"][8].buttons.tolist() == [1, 0]
    assert not any(message.buttons.any() for message in by_topic["/joy_command"][7:])


def test_several_chairs_of_a_trace_have_frames_of_their_own(tmp_path):
    plants = np.arange(30.0).reshape(2, 15)
    plants[:, 3:7] = (0.0, 0.0, 0.0, 1.0)
    record = WorldState(
        epoch=0, tick=1, commands=np.array([[0.5, 0.25], [0.0, 1.0]]), plants=plants, actor_ids=(),
        actors=np.zeros((0, 8)), state_hash="", time_s=30.1, seats=(0, 3),
    )  # fmt: skip
    counts = trace_bag(0.1, [record, record], tmp_path / "a.mcap")
    assert counts["/chair_3/odom"] == counts["/chair_0/joy_command"] == 2 and counts["/tf_static"] == 2
    odom = [made for topic, _, _, made in messages(tmp_path / "a.mcap") if topic == "/chair_3/odom"]
    assert (odom[0].header.frame_id, odom[0].child_frame_id) == ("chair_3/odom", "chair_3/base_link")
    assert odom[0].pose.pose.position.x == 15.0 and odom[0].twist.twist.angular.x == 25.0


def test_pictures_have_their_encoding_and_ideal_cameras_their_numbers(tmp_path):
    depth = np.arange(12, dtype=np.float32).reshape(3, 4)
    with RosBag(tmp_path / "a.mcap") as made:
        made.image("/d", 1.5, "c", depth, "32FC1")
        made.image("/c", 1.5, "c", np.arange(36, dtype=np.uint8).reshape(3, 4, 3), "rgb8")
        made.camera_info("/i", 1.5, "c", (4, 3), 2.0)
        made.imu("/imu", 1.5, "imu_link", np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.array([0.0, 0.0, 9.81]))
    found = {topic: message for topic, _, _, message in messages(tmp_path / "a.mcap")}
    assert (found["/d"].height, found["/d"].width, found["/d"].step, found["/d"].encoding) == (3, 4, 16, "32FC1")
    assert struct.unpack("<12f", found["/d"].data.tobytes()) == tuple(depth.ravel().tolist())
    assert (found["/c"].step, found["/c"].data.tolist()) == (12, list(range(36)))
    assert found["/i"].k.tolist() == [2.0, 0.0, 1.5, 0.0, 2.0, 1.0, 0.0, 0.0, 1.0]
    assert found["/imu"].linear_acceleration.z == 9.81


def test_the_file_in_a_bags_metadata_is_the_one_that_is_there(bag):
    with (bag[2] / "a.mcap").open("rb") as file:
        told = [each.metadata["serialized_metadata"] for each in make_reader(file).iter_metadata()]
    assert len(told) == 1 and "a.mcap" in told[0] and "bag.mcap" not in told[0]


def test_depth_is_infinite_where_nothing_is_in_range_and_no_number_where_nothing_was_measured(tmp_path):
    """REP 118; wcsim's own pictures have the range and 0 there."""
    config = resolve("quick")
    camera = config.cameras[0]
    depth = np.full((camera.height_px, camera.width_px), 7.5, np.float32)
    depth[0, 0], depth[0, 1] = camera.range_m, 0.0
    frame = CameraFrame(name=camera.name, taken_tick=1, depth_m=depth, class_id=np.zeros(depth.shape, np.uint8))
    imu = SimpleNamespace(
        yaw_rad=0.0, pitch_rad=0.0, roll_rad=0.0, gyro_radps=np.zeros(3), accel_mean_mps2=np.array([0.0, 0.0, 9.81])
    )
    client = SimpleNamespace(tick=1, sensors=SimpleNamespace(imu=imu, cameras=(frame,)))
    with RosBag(tmp_path / "a.mcap") as made:
        RosChair(made, None, 0.0).sensed(0.1, client, config)
    (told,) = [m for topic, _, _, m in messages(tmp_path / "a.mcap") if topic.endswith("depth/image_raw")]
    seen = told.data.view(np.float32)
    assert seen[0] == np.inf and np.isnan(seen[1]) and (seen[2:] == 7.5).all()
    assert depth[0, 0] == camera.range_m, "the picture itself is left as it is"


def test_a_camera_looks_along_z_of_its_frame(tmp_path):
    config = resolve("quick")
    with RosBag(tmp_path / "a.mcap") as made:
        RosChair(made, None, 0.0).mounted(0.0, config.imu, config.cameras)
    told = [message for *_, message in messages(tmp_path / "a.mcap")]
    moves = {each.child_frame_id: each for each in told[-1].transforms}  # who comes late gets the last one alone
    assert set(moves) == {"odom", "imu_link", *(f"camera_{camera.name}_optical_frame" for camera in config.cameras)}
    camera = config.cameras[0]
    seat = moves[f"camera_{camera.name}_optical_frame"]
    turn = seat.transform.rotation
    R = np.array(matrix_from_quaternion((turn.x, turn.y, turn.z, turn.w))).reshape(3, 3)
    assert np.allclose(R[:, 2], mount(camera)[:, 0]) and np.allclose(R[:, 0], -mount(camera)[:, 1])
    at = seat.transform.translation
    assert np.allclose((at.x, at.y, at.z), camera.p_BC_m)


@pytest.mark.parametrize("angles", [(0.3, 0.2, -0.1), (3.0, -0.5, 2.9), (-1.6, 1.2, 0.0)])
def test_a_quaternion_is_that_of_its_matrix(angles):
    turn = np.array(matrix_from_quaternion(quaternion_from_ypr(*angles))).reshape(3, 3)
    assert np.allclose(np.array(matrix_from_quaternion(tuple(_quaternion_of(turn).tolist()))).reshape(3, 3), turn)


def test_static_transforms_are_offered_as_those_who_listen_to_them_ask(bag):
    """Listeners of ROS 2 ask for transient local, and are told nothing by what is volatile, as a default is."""
    with (bag[2] / "a.mcap").open("rb") as file:
        channels = make_reader(file).get_summary().channels.values()
    offered = {channel.topic: channel.metadata["offered_qos_profiles"] for channel in channels}
    assert "durability: 1" in offered["/tf_static"] and "reliability: 1" in offered["/tf_static"]
    assert offered["/tf"] == ""


def test_without_the_extra_it_is_said_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(ConfigError, match=r"pip install 'wcsim\[bag\]'"):
        RosBag(tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_a_stick_that_is_commanded_is_the_same_forward(tmp_path):
    drive = read_drive(write_drive(tmp_path / "a.drive", [tick(1, commanded=Joystick(-0.5, 0.75), intent=None)]))
    counts = drive_bag(drive, tmp_path / "a.mcap")
    assert "/joy_intent" not in counts
    (told,) = [m for topic, _, _, m in messages(tmp_path / "a.mcap") if topic == "/joy_command"]
    assert told.axes.tolist() == [0.5, 0.75]


def test_a_time_before_0_is_refused_in_a_line(tmp_path):
    with pytest.raises(JournalError, match=r"-0.1 s; expected 0 or later"), RosBag(tmp_path / "a.mcap") as bag:
        bag.joy("/joy", -0.1, (0.0, 0.0))
