"""Wheelchairs as ROS 2 sees them: topics and frames, and a recording's ticks in them.

One chair has `odom` and
`base_link`; of several, those of seat n stand behind `chair_n/`. `base_link` is wcsim's frame B
(below the middle of the drive axle; x forward, y left, z up), `map` its frame W (x east, y north, z
up). Odometry is the truth, so `odom` stays on `map`.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from wcsim.bridge.recording.ros_bag import RosBag
from wcsim.config import CameraConfig, ImuConfig, RunConfig
from wcsim.core.frames import quaternion_from_ypr, wrap_angle
from wcsim.log.drive import DriveRecording
from wcsim.log.records import DriveTick, WorldState
from wcsim.physics.sensors.camera_geometry import camera_matrix, mount, pinhole
from wcsim.types import F32, F64, ClientSnapshot, Joystick

_MAP, _ODOM, _BASE = "map", "odom", "base_link"
_LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
# Of a row in a trace: place, turn, speed, turn rate.
_PLANT = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)


class RosChair:
    """Writes one wheelchair's messages into a bag."""

    def __init__(self, bag: RosBag, seat: int | None, start_s: float) -> None:
        """The only chair where `seat` is None; `start_s` is when the recording starts."""
        self._bag = bag
        self._space = "" if seat is None else f"chair_{seat}/"
        bag.transform(start_s, (_MAP, self.frame(_ODOM)), (np.zeros(3), _LEVEL), fixed=True)

    def frame(self, name: str) -> str:
        """The name of one of the chair's frames."""
        return f"{self._space}{name}"

    def topic(self, name: str) -> str:
        """The name of one of the chair's topics."""
        return f"/{self._space}{name}"

    def stick(
        self, name: str, time_s: float, stick: Joystick, buttons: Sequence[bool] = ()
    ) -> None:
        """A joystick as ROS's drivers give one: axes to the left and forward."""
        self._bag.joy(self.topic(name), time_s, (0.0 - stick.x, stick.y), buttons)

    def moved(self, time_s: float, p_WB_m: F64, q_WB: F64, v_B_mps: F64, w_B_radps: F64) -> None:
        """Where the chair is, as odometry and as a transform."""
        frames, pose = (self.frame(_ODOM), self.frame(_BASE)), (p_WB_m, q_WB)
        self._bag.odometry(self.topic("odom"), time_s, frames, pose, v_B_mps, w_B_radps)
        self._bag.transform(time_s, frames, pose)

    def mounted(self, time_s: float, imu: ImuConfig, cameras: Sequence[CameraConfig]) -> None:
        """Where the chair's IMU and cameras are; again whenever an episode moves them."""
        links = self.frame(_BASE), self.frame("imu_link")
        self._bag.transform(time_s, links, (np.array(imu.p_BI_m), _LEVEL), fixed=True)
        for camera in cameras:
            T_CB = camera_matrix(np.eye(3, 4), mount(camera))
            R_BC = T_CB[:, :3].T
            pose = (-R_BC @ T_CB[:, 3], _quaternion_of(R_BC))
            links = self.frame(_BASE), self.frame(optical(camera.name))
            self._bag.transform(time_s, links, pose, fixed=True)

    def saw(self, time_s: float, client: ClientSnapshot, config: RunConfig) -> None:
        """What a world has of a chair after a tick, but for the stick, which is the next one's."""
        plant = client.plant
        self.moved(time_s, plant.p_WB_m, plant.q_WB, plant.v_B_mps, plant.w_B_radps)
        self.sensed(time_s, client, config)

    def sensed(self, time_s: float, client: ClientSnapshot, config: RunConfig) -> None:
        """What the chair's IMU and cameras measure; a picture when it is new."""
        imu = client.sensors.imu
        turn = np.array(quaternion_from_ypr(imu.yaw_rad, imu.pitch_rad, imu.roll_rad))
        values = turn, imu.gyro_radps, imu.accel_mean_mps2
        self._bag.imu(self.topic("imu/data"), time_s, self.frame("imu_link"), *values)
        for frame, camera in zip(client.sensors.cameras, config.cameras, strict=True):
            if frame.taken_tick != client.tick:
                continue
            bag, space = self._bag, self.topic(f"camera/{frame.name}")
            at = time_s, self.frame(optical(frame.name))
            size_px, focal_px = (camera.width_px, camera.height_px), pinhole(camera).focal_px
            bag.camera_info(f"{space}/camera_info", *at, size_px, focal_px)
            depth_m = measured(frame.depth_m, camera.range_m)
            bag.image(f"{space}/depth/image_raw", *at, depth_m, "32FC1")
            bag.image(f"{space}/class/image_raw", *at, frame.class_id, "mono8")
            if frame.rgb is not None:
                bag.image(f"{space}/rgb/image_raw", *at, frame.rgb, "rgb8")


def drive_bag(drive: DriveRecording, out: Path) -> dict[str, int]:
    """Write a drive as MCAP; returns the messages by topic. ConfigError without rosbags."""
    with RosBag(out) as bag:
        chair, tick_s = RosChair(bag, None, 0.0), drive.header.tick_s
        before: DriveTick | None = None
        for tick in drive.ticks:
            chair.stick("joy", tick.time_s - tick_s, tick.stick, (tick.helped, tick.overruled))
            if tick.intent is not None:
                chair.stick("joy_intent", tick.time_s - tick_s, tick.intent)
            buttons = (tick.warning, tick.intervening)
            chair.stick("joy_command", tick.time_s - tick_s, tick.commanded, buttons)
            # How fast the chair turned; 0 in the first tick of an episode.
            turn_radps = 0.0
            if before is not None and before.episode == tick.episode:
                turn_radps = wrap_angle(tick.yaw_rad - before.yaw_rad) / tick_s
            chair.moved(
                tick.time_s,
                tick.p_WB_m,
                np.array(quaternion_from_ypr(tick.yaw_rad, tick.pitch_rad, tick.roll_rad)),
                np.array([tick.speed_mps, 0.0, 0.0]),
                np.array([0.0, 0.0, turn_radps]),
            )
            before = tick
        return bag.counts


def trace_bag(tick_s: float, records: Iterable[WorldState], out: Path) -> dict[str, int]:
    """Write a trace's chairs as MCAP; returns the messages by topic. ConfigError: no rosbags."""
    with RosBag(out) as bag:
        chairs: dict[int, RosChair] = {}
        for record in records:
            seats = record.seats or tuple(range(len(record.plants)))
            start_s = record.time_s - tick_s
            for seat, command, plant in zip(seats, record.commands, record.plants, strict=True):
                if seat not in chairs:
                    chairs[seat] = RosChair(bag, seat if max(seats) > 0 else None, start_s)
                chairs[seat].stick("joy_command", start_s, Joystick(*command.tolist()))
                chairs[seat].moved(record.time_s, *(plant[part] for part in _PLANT))
        return bag.counts


def optical(name: str) -> str:
    """The frame of a camera's pictures: x right, y down, z forward."""
    return f"camera_{name}_optical_frame"


def measured(depth_m: F32, range_m: float) -> F32:
    """Depth (H, W) as in REP 118: +Inf beyond the range, NaN where nothing was measured.

    >>> measured(np.array([[0.0, 3.5, 40.0]], np.float32), 40.0).tolist()
    [[nan, 3.5, inf]]
    """
    depth: F32 = np.where(depth_m > 0.0, depth_m, np.float32(np.nan))
    depth[depth_m >= np.float32(range_m)] = np.inf
    return depth


def _quaternion_of(turn: F64) -> F64:
    """Unit quaternion (4,) x, y, z, w of a rotation matrix (3, 3).

    >>> turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> _quaternion_of(turn).round(4).tolist()
    [0.0, 0.0, 0.7071, 0.7071]
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(turn).as_quat(canonical=True), np.float64)
