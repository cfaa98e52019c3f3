"""What the agent sees (Table 3 of the paper), in three forms with pictures, and in one without.

`compact` has images as uint8 (class ids, and depth on a logarithmic scale) for the replay store,
and networks expand them; `compact_rgb` has the camera's colours, too; `table3` has the paper's
floats. All show the same picture, in fresh arrays that a replay buffer may hold. A depth of 0 means
that nothing was measured there; whatever was measured is above 0.

`state` is for experiments: rows of numbers about what is near, from the world's truth. No real
chair has them.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final, get_args

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from wcsim.config import CameraConfig, RunConfig
from wcsim.config.env import EnvConfig, Form
from wcsim.core.jit import compile_exact_kernel
from wcsim.errors import ConfigError
from wcsim.supervisor.palette import make_cityscapes_class_table, make_class_palette
from wcsim.types import F32, F64, U8, CameraFrame, ClientSnapshot, ImuFrame, Measure, SensorFrame

Observation = dict[str, npt.NDArray[Any]]
Measures = Mapping[str, Measure]
_NO_MEASURES: Final[Measures] = MappingProxyType({})
_NO_OTHERS: Final[Mapping[str, CameraConfig]] = MappingProxyType({})
_WITHOUT_PICTURES: Final = (
    "env.observation=state has no pictures, and wcsim's networks and policies need them; expected "
    "env.observation=compact"
)

_FOLDED: Final = make_cityscapes_class_table().tobytes()  # by class id
_ACCEL_FULL_SCALE_MPS2: Final = 40.0  # maximum of Table 1
_GYRO_FULL_SCALE_RADPS: Final = 4.0  # more than a chair turns before it falls
_IMU_SIZE: Final = 5  # numbers of the IMU in the paper's observation

_DEPTH_NEAR_M: Final = 0.1  # the camera's near plane; anything closer reads as this
_DEPTH_STEPS: Final = 254  # of the codes 1 to 255; 0 is for what was not measured
# Of 23: leaves a relative step of 2^-10, a twentieth of one depth code.
_MANTISSA_BITS_DROPPED: Final = 13
_TABLE_SIZE: Final = 1 << (32 - _MANTISSA_BITS_DROPPED)
_INFINITE: Final = 0x7F800000 >> _MANTISSA_BITS_DROPPED  # infinity and NaN begin here

NEAR: Final = "around"  # the reading with the rows of `state`
WAY_AHEAD_M: Final = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)  # along the route
SECTORS: Final = 16  # around the chair: the nearest solid thing and the nearest edge in each
SOLID_REACH_M: Final = 6.0  # of both
MOST_OTHERS: Final = 16
OTHERS_REACH_M: Final = 25.0
WAY_ROW: Final = 1  # the first row of each block; row 0 is of the chair itself
SOLID_ROW: Final = WAY_ROW + len(WAY_AHEAD_M)
EDGE_ROW: Final = SOLID_ROW + SECTORS
OTHERS_ROW: Final = EDGE_ROW + SECTORS
STATE_SHAPE: Final = (OTHERS_ROW + MOST_OTHERS, 9)
MOST_KINDS: Final = 16  # numbers of kinds in the first column, 0 where a row is empty


def make_observation_space(
    form: Form,
    width: int,
    height: int,
    imu: int = _IMU_SIZE,
    measures: Measures = _NO_MEASURES,
    others: Mapping[str, CameraConfig] = _NO_OTHERS,
) -> spaces.Dict:
    """The Gymnasium space of `make_observation`.

    Images are (C, height, width), `imu` numbers are those of the IMU. The sensors of `measures`
    have entries of their own, by name, and so have the cameras of `others`, by what stands before
    the keys of their images. Raises ConfigError for an unknown form.
    """
    if form not in get_args(Form):
        raise ConfigError(
            f"unknown observation form {form!r}; expected one of {', '.join(get_args(Form))}"
        )
    if form == "state":
        raise ConfigError(_WITHOUT_PICTURES)
    vectors: dict[str, spaces.Space[Any]] = {
        "imu": spaces.Box(-1.0, 1.0, (imu,), np.float32),
        "joystick": spaces.Box(-1.0, 1.0, (2,), np.float32),
        **{
            name: spaces.Box(-1.0, 1.0, (len(m.parts),), np.float32) for name, m in measures.items()
        },
    }
    floats = form == "table3"
    planes = {"segmentation" if floats else "seg": 3 if floats else 1, "depth": 1}
    planes |= {"rgb": 3} if form == "compact_rgb" else {}
    sizes = {"": (height, width)}
    sizes |= {name: (camera.height_px, camera.width_px) for name, camera in others.items()}
    images = {
        name + key: spaces.Box(0.0, 1.0, (count, *size), np.float32)
        if floats
        else spaces.Box(0, 255, (count, *size), np.uint8)
        for name, size in sizes.items()
        for key, count in planes.items()
    }
    return spaces.Dict({**images, **vectors})


def make_observation(snapshot: ClientSnapshot, config: RunConfig) -> Observation:
    """The observation of a snapshot in the configured form; also for the first frame of an episode.

    Returns:
        Arrays as in `make_observation_space`, contiguous and owned by the caller.

    Raises:
        ConfigError: There is no such camera or sensor, or no colours where they are asked for.
    """
    sensors, env = snapshot.sensors, config.env
    if env.observation == "state":
        raise ConfigError(_WITHOUT_PICTURES)
    images = {
        name + key: image
        for name, camera in config.eyes.items()
        for key, image in _images(_frame(sensors, camera.name), env, camera.range_m).items()
    }
    return {
        **images,
        "imu": _imu_vector(sensors.imu, env.observe_gyro, env.observe_yaw),
        "joystick": np.array([snapshot.user.x, snapshot.user.y], np.float32),
        **{
            name: _measured(sensors, name, measure)
            for name, measure in config.sensors.measures().items()
        },
    }


def _images(frame: CameraFrame, env: EnvConfig, range_m: float) -> Observation:
    """The images of one camera in the configured form."""
    fold = env.classes == "cityscapes"  # kerbs to sidewalk, crosswalk to road
    if env.observation != "table3":
        seg = frame.class_id.copy()
        if fold:
            # Twice as fast as indexing with uint8.
            folded = bytearray(seg.tobytes()).translate(_FOLDED)
            seg = np.frombuffer(folded, np.uint8).reshape(seg.shape)
        images = {"seg": seg[None], "depth": encode_depth(frame.depth_m, range_m)[None]}
        if env.observation == "compact_rgb":
            if frame.rgb is None:
                raise ConfigError(
                    f"camera {frame.name!r} draws no colours; expected its setting rgb=true"
                )
            images["rgb"] = np.moveaxis(frame.rgb, 2, 0).copy()
        return images
    colours = _planes(fold)
    index = frame.class_id.astype(np.intp)
    image = np.empty((3, *index.shape), np.float32)
    for plane, colour in zip(image, colours, strict=True):
        # NumPy buffers `out` with the mode `raise`, and class ids are never out of bounds.
        np.take(colour, index, out=plane, mode="clip")
    depth = np.multiply(frame.depth_m, np.float32(1.0 / range_m), dtype=np.float32)
    return {"segmentation": image, "depth": np.clip(depth, 0.0, 1.0, out=depth)[None]}


def make_state_observation_space() -> spaces.Box:
    """The Gymnasium space of `make_state_observation`."""
    return spaces.Box(-1.0, 1.0, STATE_SHAPE, np.float32)


def make_state_observation(snapshot: ClientSnapshot) -> F32:
    """The rows of `state` (STATE_SHAPE) float32, each column over its full scale, within [-1, 1].

    Raises ConfigError for the frame of a seat that did not ask for them.
    """
    readings = {reading.name: reading.values for reading in reversed(snapshot.sensors.readings)}
    rows = readings.get(NEAR)
    if rows is None or rows.size != math.prod(STATE_SHAPE):
        raise ConfigError(f"the seat has no numbers for env.observation=state. {_WITHOUT_PICTURES}")
    scaled = (rows.reshape(STATE_SHAPE) / _state_scale()).astype(np.float32)
    # Those of a person, where one holds the stick in the user's place.
    scaled[0, 1:3] = snapshot.user.x, snapshot.user.y
    return np.clip(scaled, -1.0, 1.0)


@lru_cache(maxsize=1)
def _state_scale() -> F64:
    """Full scale of each number: metres by the reach of a block, 15 m/s, vehicles of 15 by 5 m."""
    scale = np.tile(
        np.array([MOST_KINDS, 1.0, 1.0, 15.0, 15.0, 1.0, 1.0, 15.0, 5.0]), (STATE_SHAPE[0], 1)
    )
    reach_m = ((WAY_ROW, WAY_AHEAD_M[-1]), (SOLID_ROW, SOLID_REACH_M), (OTHERS_ROW, OTHERS_REACH_M))
    # Each block up to the end; the next one overwrites its own.
    for row, metres in reach_m:
        scale[row:, 1:3] = metres
    # kind, stick x and y, speeds ahead and left, turn rate, roll, pitch, metres to the destination
    scale[0] = [MOST_KINDS, 1.0, 1.0, 4.0, 4.0, 4.0, math.pi, 0.5 * math.pi, 400.0]
    return scale


def count_imu_values(gyro: bool, yaw: bool) -> int:
    """How many numbers `_imu_vector` has; no two choices give the same."""
    return _IMU_SIZE + 3 * gyro + 2 * yaw


def _imu_vector(imu: ImuFrame, gyro: bool = False, yaw: bool = False) -> F32:
    """What is seen of the IMU, float32 in [-1, 1]; (5,), and more when asked for.

    Tick-mean ax, ay, az over 40 m/s^2 (gravity included), roll over pi, pitch over pi/2; with
    `gyro` the turn rates over 4 rad/s; with `yaw` the sine and cosine of the heading.
    """
    accel = imu.accel_mean_mps2 / _ACCEL_FULL_SCALE_MPS2
    scaled = [*accel, imu.roll_rad / math.pi, imu.pitch_rad / (0.5 * math.pi)]
    if gyro:
        scaled += list(imu.gyro_radps / _GYRO_FULL_SCALE_RADPS)
    if yaw:
        scaled += [math.sin(imu.yaw_rad), math.cos(imu.yaw_rad)]
    # A blow goes beyond the full scale; the space promises -1 to 1.
    return np.clip(np.array(scaled, np.float32), -1.0, 1.0)


def _measured(sensors: SensorFrame, name: str, measure: Measure) -> F32:
    """What is seen of a further sensor, float32 in [-1, 1]: each number over its full scale.

    Raises ConfigError when the chair has no such sensor, or one with other parts.
    """
    readings = {reading.name: reading.values for reading in sensors.readings}
    if name not in readings or readings[name].shape != (len(measure.parts),):
        known = {other: values.shape for other, values in readings.items()}
        raise ConfigError(
            f"no sensor {name!r} with {len(measure.parts)} numbers on this chair; it has {known}"
        )
    return np.clip((readings[name] / measure.full_scale).astype(np.float32), -1.0, 1.0)


def encode_depth(depth_m: F32, range_m: float) -> U8:
    """Depth (H, W) as uint8 on a logarithmic scale.

    1 at 0.1 m and below, 255 at `range_m` and above, 0 for none. None is what is not above 0: a
    pixel that a noisy camera did not measure, and no distance at all.
    """
    # The leading bits of a float32 are a logarithm already: a table over them is many times faster
    # than np.log.
    bits = np.ascontiguousarray(depth_m, np.float32).view(np.uint32)
    code = np.empty(bits.shape, np.uint8)
    _look_up(bits.reshape(-1), _depth_codes(float(range_m)), code.reshape(-1))
    return code


@compile_exact_kernel
def _look_up(bits: npt.NDArray[np.uint32], codes: U8, out: U8) -> None:
    for i in range(len(bits)):
        out[i] = codes[bits[i] >> _MANTISSA_BITS_DROPPED]


def decode_depth(code: U8, range_m: float) -> F32:
    """The depth in metres that a code of `encode_depth` stands for, 0 for none.

    The relative error is at most 1.3 % up to 40 m. A search for obstacles must leave zeros out:
    they are not near.
    """
    steps = np.arange(-1, _DEPTH_STEPS + 1) / _DEPTH_STEPS
    metres = (_DEPTH_NEAR_M * (range_m / _DEPTH_NEAR_M) ** steps).astype(np.float32)
    metres[0] = 0.0
    return metres[code]


@lru_cache(maxsize=8)
def _depth_codes(range_m: float) -> U8:
    """Table from the leading bits of a float32 to its code.

    What is not above 0 and NaN give 0, infinity gives 255.
    """
    # The sign bit is the first: the other half is negative.
    leading = np.arange(_TABLE_SIZE // 2, dtype=np.uint32)
    # The middle of the numbers that share these bits, which halves the error.
    middle = (leading << _MANTISSA_BITS_DROPPED) + (1 << (_MANTISSA_BITS_DROPPED - 1))
    middle[leading >= _INFINITE] = np.float32(range_m).view(np.uint32)
    near_to_far = (
        np.clip(middle.view(np.float32).astype(np.float64), _DEPTH_NEAR_M, range_m) / _DEPTH_NEAR_M
    )
    codes = np.zeros(_TABLE_SIZE, np.uint8)
    codes[: len(leading)] = 1 + np.rint(
        _DEPTH_STEPS * np.log(near_to_far) / math.log(range_m / _DEPTH_NEAR_M)
    )
    codes[0] = 0  # what is smaller than any distance
    codes[_INFINITE + 1 : len(leading)] = 0  # NaN
    return codes


@lru_cache(maxsize=2)
def _planes(fold: bool) -> F32:
    """Colour planes (3, 256) float32 in 0..1, by class id."""
    table = make_class_palette()
    if fold:
        table = table[make_cityscapes_class_table()]
    return np.ascontiguousarray(table.T, np.float32) / np.float32(255.0)


def _frame(sensors: SensorFrame, name: str) -> CameraFrame:
    for frame in sensors.cameras:
        if frame.name == name:
            return frame
    known = ", ".join(frame.name for frame in sensors.cameras) or "none"
    raise ConfigError(f"no camera {name!r} on this chair; it has: {known}")
