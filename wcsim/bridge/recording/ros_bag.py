"""MCAP files with messages of ROS 2, the one place that needs rosbags, which is an extra.

Frames are those of REP 103 and REP 105: metres, seconds, radians; x forward, y left, z up; `map`,
`odom`, `base_link`.
"""

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.core.closing import ClosingContextBase
from wcsim.errors import JournalError, check_installed
from wcsim.types import F32, F64, U8

_VERSION: Final = 8  # of the format that ROS 2 Humble and later read
_STATIC: Final = "/tf_static"


class RosBag(ClosingContextBase):
    """A new MCAP file; it appears when it is closed."""

    def __init__(self, path: Path) -> None:
        """Start a file. Raises ConfigError when the extra is not installed."""
        check_installed("--mcap needs rosbags", "bag", "rosbags")
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self._path = path
        self._store: Any = get_typestore(Stores.ROS2_HUMBLE)
        self._work = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}."))  # noqa: TID251 - beside it
        self._bag = self._work / path.stem  # its metadata calls the file as it will be called
        self._writer: Any = Writer(self._bag, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._topics: dict[str, Any] = {}
        self._fixed: dict[str, Any] = {}  # transforms of /tf_static, by child
        self._closed = False
        self.counts: dict[str, int] = {}  # of messages, by topic

    def close(self) -> None:
        """End the file and put it in its place; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        try:
            self._writer.close()
            (self._bag / f"{self._bag.name}.mcap").replace(self._path)
        finally:
            shutil.rmtree(self._work, ignore_errors=True)

    def joy(
        self, topic: str, time_s: float, axes: Sequence[float], buttons: Sequence[bool] = ()
    ) -> None:
        """sensor_msgs/Joy."""
        self._write(
            topic,
            "sensor_msgs/msg/Joy",
            time_s,
            header=self._header(time_s, ""),
            axes=np.array(axes, np.float32),
            buttons=np.array(buttons, np.int32),
        )

    def odometry(
        self,
        topic: str,
        time_s: float,
        frames: tuple[str, str],
        pose: tuple[F64, F64],
        v: F64,
        w: F64,
    ) -> None:
        """nav_msgs/Odometry: a frame in its parent, and how it moves, seen from itself.

        Args:
            topic: Where.
            time_s: When.
            frames: Parent and child.
            pose: Place (3,) and quaternion (4,) x, y, z, w of the child in the parent.
            v: (3,) its velocity.
            w: (3,) its angular velocity.
        """
        exact = np.zeros(36)
        at = self._made(
            "geometry_msgs/msg/Pose",
            position=self._numbers("Point", pose[0]),
            orientation=self._numbers("Quaternion", pose[1]),
        )
        twist = self._made(
            "geometry_msgs/msg/Twist",
            linear=self._numbers("Vector3", v),
            angular=self._numbers("Vector3", w),
        )
        self._write(
            topic,
            "nav_msgs/msg/Odometry",
            time_s,
            header=self._header(time_s, frames[0]),
            child_frame_id=frames[1],
            pose=self._made("geometry_msgs/msg/PoseWithCovariance", pose=at, covariance=exact),
            twist=self._made(
                "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=exact
            ),
        )

    def transform(
        self, time_s: float, frames: tuple[str, str], pose: tuple[F64, F64], fixed: bool = False
    ) -> None:
        """tf2_msgs/TFMessage: place and quaternion of a frame in its parent.

        It is on /tf_static where it is `fixed`. A message of /tf_static repeats those before it: a
        late subscriber of a played bag gets the last one alone.
        """
        moved = self._made(
            "geometry_msgs/msg/Transform",
            translation=self._numbers("Vector3", pose[0]),
            rotation=self._numbers("Quaternion", pose[1]),
        )
        stamped = self._made(
            "geometry_msgs/msg/TransformStamped",
            header=self._header(time_s, frames[0]),
            child_frame_id=frames[1],
            transform=moved,
        )
        if fixed:
            self._fixed[frames[1]] = stamped
        sent = list(self._fixed.values()) if fixed else [stamped]
        self._write(_STATIC if fixed else "/tf", "tf2_msgs/msg/TFMessage", time_s, transforms=sent)

    def imu(self, topic: str, time_s: float, frame: str, q: F64, w: F64, a: F64) -> None:
        """sensor_msgs/Imu: orientation (4,), angular velocity (3,), specific force (3,).

        The specific force has gravity in it.
        """
        unknown = np.zeros(9)
        self._write(
            topic,
            "sensor_msgs/msg/Imu",
            time_s,
            header=self._header(time_s, frame),
            orientation=self._numbers("Quaternion", q),
            orientation_covariance=unknown,
            angular_velocity=self._numbers("Vector3", w),
            angular_velocity_covariance=unknown,
            linear_acceleration=self._numbers("Vector3", a),
            linear_acceleration_covariance=unknown,
        )

    def image(
        self, topic: str, time_s: float, frame: str, picture: U8 | F32, encoding: str
    ) -> None:
        """sensor_msgs/Image (H, W) or (H, W, 3), as rgb8, mono8 or 32FC1."""
        rows = np.ascontiguousarray(picture)
        self._write(
            topic,
            "sensor_msgs/msg/Image",
            time_s,
            header=self._header(time_s, frame),
            height=rows.shape[0],
            width=rows.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.strides[0],
            data=rows.view(np.uint8).reshape(-1),
        )

    def camera_info(
        self, topic: str, time_s: float, frame: str, size_px: tuple[int, int], focal_px: float
    ) -> None:
        """sensor_msgs/CameraInfo of an ideal camera of that width and height."""
        width, height = size_px
        cx, cy = 0.5 * width - 0.5, 0.5 * height - 0.5
        whole = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        roi = self._made("sensor_msgs/msg/RegionOfInterest", **whole)
        self._write(
            topic,
            "sensor_msgs/msg/CameraInfo",
            time_s,
            header=self._header(time_s, frame),
            height=height,
            width=width,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=np.array([focal_px, 0.0, cx, 0.0, focal_px, cy, 0.0, 0.0, 1.0]),
            r=np.eye(3).ravel(),
            p=np.array([focal_px, 0.0, cx, 0.0, 0.0, focal_px, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
            binning_x=0,
            binning_y=0,
            roi=roi,
        )

    def _write(self, topic: str, kind: str, stamp_s: float, **content: Any) -> None:
        if topic not in self._topics:
            offered = [_latched_qos()] if topic == _STATIC else []
            self._topics[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store, offered_qos_profiles=offered
            )
        data = self._store.serialize_cdr(self._made(kind, **content), kind)
        self._writer.write(self._topics[topic], _stamp_ns(stamp_s), data)
        self.counts[topic] = self.counts.get(topic, 0) + 1

    def _made(self, kind: str, **content: Any) -> Any:
        return self._store.types[kind](**content)

    def _header(self, time_s: float, frame: str) -> Any:
        seconds, nanoseconds = divmod(_stamp_ns(time_s), 1_000_000_000)
        stamp = self._made("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        return self._made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _numbers(self, kind: str, values: F64) -> Any:
        """A message of geometry_msgs that has x, y, z, and for a quaternion w."""
        content = dict(zip("xyzw", values.tolist(), strict=False))
        return self._made(f"geometry_msgs/msg/{kind}", **content)


def _stamp_ns(time_s: float) -> int:
    """Nanoseconds. Raises JournalError for a time before 0, which no MCAP file can hold."""
    stamp_ns = round(time_s * 1e9)
    if stamp_ns < 0:
        raise JournalError(
            f"a recording begins at {time_s:.9g} s; expected 0 or later: record it again"
        )
    return stamp_ns


def _latched_qos() -> Any:
    """The quality of service of /tf_static: with another one its subscribers get nothing."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    for_ever = QosTime(sec=9223372036, nsec=854775807)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=for_ever,
        lifespan=for_ever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=for_ever,
        avoid_ros_namespace_conventions=False,
    )
