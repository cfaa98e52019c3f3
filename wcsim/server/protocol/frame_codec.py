"""The arrays of a frame as they travel, and what no type says of them; all the rest msgspec packs by its types."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from wcsim.errors import ProtocolError
from wcsim.physics.buffers import Images
from wcsim.types import F32, F64, CameraFrame, ClientSnapshot, Truth, Verdict
from wcsim.types import bounds as b

_SIZES = [3, 4, 3, 3, 2, 3, 3, 3]  # of the arrays of a plant and an IMU


class Pictures(Protocol):
    """Where pictures are that did not travel."""

    def pictures(self, slot: int, first: bool) -> Sequence[Images]:
        """Those of a slot, one a camera; with `first` those of an episode's first frame. Raises ProtocolError."""


def packed(value: Any) -> Any:
    """An array as its bytes, behind its shape where it has more than one dimension; a NumPy number as a plain one."""
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.ndim == 1 else (value.shape, value.tobytes())
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(type(value))


def packed_without_pictures(value: Any) -> Any:
    """The same; of pictures, which lie in shared memory, nothing."""
    return ((0, 0), b"") if isinstance(value, np.ndarray) and value.ndim > 1 else packed(value)


def unpacked(kind: Any, told: Any) -> npt.NDArray[Any]:
    """What `packed` made of an array, numbers as a row. Raises TypeError or ValueError for anything else."""
    if kind == F64:
        return np.frombuffer(told, np.float64)
    shape, data = told
    return np.frombuffer(data, np.float32 if kind == F32 else np.uint8).reshape(shape)


def require_whole(client: ClientSnapshot) -> None:
    """Refuse a frame for what no type says: the shapes of its arrays, and numbers inside them. Raises ProtocolError."""
    plant, imu = client.plant, client.sensors.imu
    arrays = [plant.p_WB_m, plant.q_WB, plant.v_B_mps, plant.w_B_radps, plant.wheel_radps]
    arrays += [imu.accel_mean_mps2, imu.accel_peak_mps2, imu.gyro_radps]
    if [array.size for array in arrays] != _SIZES:
        raise ProtocolError("a frame has arrays of other sizes than those of a wheelchair and its IMU")
    readings = [reading.values for reading in client.sensors.readings]
    if any([values.nbytes > b.MOST_READING_BYTES for values in readings]):
        raise ProtocolError(f"a sensor reading has too many numbers; expected {b.MOST_READING_BYTES} bytes at most")
    if not np.isfinite(np.concatenate(arrays + readings)).all():
        raise ProtocolError("a frame or a sensor reading has numbers that are not finite; expected finite ones")
    if client.truth is not None:
        _require_verdict(client.truth)
    for camera in client.sensors.cameras:
        _require_picture(camera)
    if client.first is not None:
        require_whole(client.first)


def _require_verdict(verdict: Verdict) -> None:
    if len(verdict.first_s) > b.MOST_ACTIONS or not (verdict.first_s >= 0.0).all():
        raise ProtocolError("the truth has too many seconds, or negative ones; expected one >= 0 for each action")
    if isinstance(verdict, Truth) and verdict.visible is not None:
        _require_verdict(verdict.visible)


def with_pictures(client: ClientSnapshot, slot: int, shared: Pictures) -> ClientSnapshot:
    """A frame with its pictures out of shared memory. Raises ProtocolError when they are of other cameras."""
    images, cameras = shared.pictures(slot, client.events.step == 0), client.sensors.cameras
    if len(images) != len(cameras):
        raise ProtocolError(f"a frame has {len(cameras)} cameras; the shared memory has {len(images)}")
    seen = tuple(
        [
            replace(camera, depth_m=here.depth_m, class_id=here.class_id, rgb=here.rgb)
            for camera, here in zip(cameras, images, strict=True)
        ]
    )
    first = None if client.first is None else with_pictures(client.first, slot, shared)
    return replace(client, sensors=replace(client.sensors, cameras=seen), first=first)


def _require_picture(camera: CameraFrame) -> None:
    shape, rgb = camera.depth_m.shape, camera.rgb
    sound = len(shape) == 2 and max(shape) <= b.MOST_SIDE_PX and camera.class_id.shape == shape
    empty = camera.depth_m.size == 0  # as of a picture in shared memory, whose colours do not travel either
    if not sound or (rgb is not None and rgb.shape != (*shape, 3) and not (empty and rgb.size == 0)):
        raise ProtocolError(f"the depth of a picture has shape {shape}; expected (H, W), and the same of its classes")
