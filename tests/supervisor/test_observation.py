"""All forms of the observation: spaces, depth codes, folding, ownership, speed."""

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plants import CALM
from tests.support.yardstick import multiple
from tests.users.kinematics import plant
from wcsim.config import CameraConfig, EnvConfig, RunConfig, resolve
from wcsim.config.env import Form
from wcsim.errors import ConfigError
from wcsim.supervisor.observation import (
    NEAR,
    STATE_SHAPE,
    _imu_vector,
    count_imu_values,
    decode_depth,
    encode_depth,
    make_observation,
    make_observation_space,
    make_state_observation,
    make_state_observation_space,
)
from wcsim.supervisor.palette import COLOURS, make_class_palette
from wcsim.types import CameraFrame, ClassId, ClientSnapshot, ImuFrame, Joystick, Reading, SensorFrame

RANGE_M = 40.0
EACH_PICTURED = pytest.mark.parametrize("form", [form for form in get_args(Form) if form != "state"])


def imu(accel=(0.0, 0.0, 9.81), roll=0.05, pitch=-0.2) -> ImuFrame:
    return ImuFrame(
        accel_mean_mps2=np.array(accel, float),
        accel_peak_mps2=np.zeros(3),
        gyro_radps=np.zeros(3),
        roll_rad=roll,
        pitch_rad=pitch,
        yaw_rad=0.0,
    )


def sensors(width=320, height=240) -> SensorFrame:
    rng = np.random.default_rng(0)
    depth = np.exp(rng.uniform(math.log(0.1), math.log(RANGE_M), (height, width))).astype(np.float32)
    classes = rng.choice(np.array([int(c) for c in ClassId], np.uint8), (height, width))
    rgb = rng.integers(0, 256, (height, width, 3), np.uint8)
    frame = CameraFrame(name="front", taken_tick=3, depth_m=depth, class_id=classes, rgb=rgb)
    return SensorFrame(tick=3, cameras=(frame,), imu=imu())


def seen(form, frame, fold=True, camera="front"):
    env = EnvConfig(observation=form, classes="cityscapes" if fold else "wcsim")
    eye = CameraConfig(name=camera, range_m=RANGE_M, rgb=form == "compact_rgb")
    return make_observation(snapshot(frame), RunConfig(env=env, cameras=(eye,)))


def snapshot(frame):
    still = plant(0.0, 0.0, 0.0)
    return ClientSnapshot(
        seat=0, tick=3, plant=still, sensors=frame, user=Joystick(-0.25, 0.75), contacts=(), events=CALM
    )


@EACH_PICTURED
@pytest.mark.parametrize("fold", [True, False])
def test_observation_is_in_its_space(form, fold):
    got = seen(form, sensors(80, 60), fold)
    space = make_observation_space(form, 80, 60)
    assert space.contains(got)
    assert set(got) == set(space.spaces)
    assert all(array.flags.c_contiguous and array.flags.writeable for array in got.values())
    np.testing.assert_allclose(got["joystick"], [-0.25, 0.75])


def test_what_needs_pictures_refuses_the_form_without():
    with pytest.raises(ConfigError, match=r"policies need them; expected env\.observation=compact"):
        seen("state", sensors(40, 30))
    with pytest.raises(ConfigError, match="networks and policies need them"):
        make_observation_space("state", 80, 60)


def test_the_rows_have_the_stick_of_now_not_that_of_the_simulated_user():
    frame = replace(sensors(40, 30), readings=(Reading(name=NEAR, values=np.ones(math.prod(STATE_SHAPE))),))
    rows = make_state_observation(snapshot(frame))
    assert rows.shape == STATE_SHAPE and make_state_observation_space().contains(rows)
    np.testing.assert_array_equal(rows[0, 1:3], [-0.25, 0.75])


@EACH_PICTURED
def test_arrays_are_the_callers_own(form):
    frame = sensors(40, 30)
    before = {key: array.copy() for key, array in seen(form, frame).items()}
    kept = seen(form, frame)
    frame.cameras[0].depth_m[:] = 1.0
    frame.cameras[0].class_id[:] = ClassId.SKY
    frame.cameras[0].rgb[:] = 7
    for key, array in kept.items():
        np.testing.assert_array_equal(array, before[key])


def test_read_only_views_of_a_buffer_are_accepted():
    frame = sensors(40, 30)
    frame.cameras[0].depth_m.flags.writeable = False
    frame.cameras[0].class_id.flags.writeable = False
    assert seen("compact", frame, fold=False)["seg"].flags.writeable


@given(st.floats(0.1, RANGE_M), st.sampled_from([10.0, 40.0]))
def test_depth_survives_within_its_error(depth, range_m):
    depth = min(depth, range_m)
    code = encode_depth(np.full((1, 1), depth, np.float32), range_m)
    assert abs(float(decode_depth(code, range_m)[0, 0]) / depth - 1.0) <= 0.013


def test_depth_codes_are_monotone_and_every_code_comes_back():
    depth = np.geomspace(0.05, 60.0, 20_000, dtype=np.float32)[None]
    assert (np.diff(encode_depth(depth, RANGE_M).astype(int)) >= 0).all()
    codes = np.arange(256, dtype=np.uint8)[None]
    np.testing.assert_array_equal(encode_depth(decode_depth(codes, RANGE_M), RANGE_M), codes)


def test_depth_beyond_its_ends():
    odd = np.array([[0.0, -1.0, 0.05, 0.1, RANGE_M, 99.0, np.inf, np.nan, -np.inf]], np.float32)
    np.testing.assert_array_equal(encode_depth(odd, RANGE_M), [[0, 0, 1, 1, 255, 255, 255, 0, 0]])


@EACH_PICTURED
def test_what_was_not_measured_is_told_from_what_is_near(form):
    frame = sensors(40, 30)
    frame.cameras[0].depth_m[:] = 0.1
    frame.cameras[0].depth_m[3, 5] = 0.0
    depth = seen(form, frame)["depth"][0]
    assert depth[3, 5] == 0 and (np.delete(depth.ravel(), 3 * 40 + 5) > 0).all()
    assert decode_depth(np.zeros((1, 1), np.uint8), RANGE_M)[0, 0] == 0.0


def test_both_forms_show_the_same_picture():
    frame = sensors(80, 60)
    compact, table3 = seen("compact", frame), seen("table3", frame)
    colours = make_class_palette()[compact["seg"][0]]
    np.testing.assert_allclose(table3["segmentation"], np.moveaxis(colours, -1, 0) / 255.0, atol=1e-6)
    metres = decode_depth(compact["depth"], RANGE_M)
    np.testing.assert_allclose(metres, table3["depth"] * RANGE_M, rtol=0.013)


def test_folding_leaves_only_classes_of_cityscapes():
    frame = sensors(80, 60)
    assert {34, 35, 36} <= set(np.unique(seen("compact", frame, fold=False)["seg"]).tolist())
    folded = seen("compact", frame)["seg"][0]
    assert not {34, 35, 36} & set(np.unique(folded).tolist())
    assert (folded[frame.cameras[0].class_id == ClassId.CROSSWALK] == ClassId.ROAD).all()
    assert (folded[frame.cameras[0].class_id == ClassId.KERB] == ClassId.SIDEWALK).all()


def test_imu_is_scaled_and_held():
    np.testing.assert_allclose(
        _imu_vector(imu((4.0, -400.0, 9.81), math.pi / 2, -math.pi / 4)), [0.1, -1.0, 0.24525, 0.5, -0.5], atol=1e-6
    )


@pytest.mark.parametrize("gyro, yaw, size", [(False, False, 5), (True, False, 8), (False, True, 7), (True, True, 10)])
def test_turn_rates_and_heading_can_be_seen_too(gyro, yaw, size):
    felt = replace(imu(), gyro_radps=np.array([0.4, -0.8, 99.0]), yaw_rad=math.pi / 6)
    got = _imu_vector(felt, gyro, yaw)
    assert got.shape == (size,) == (count_imu_values(gyro, yaw),)
    expected = [0.1, -0.2, 1.0] * gyro + [0.5, math.sqrt(0.75)] * yaw
    np.testing.assert_allclose(got[5:], expected, atol=1e-6)
    np.testing.assert_array_equal(got[:5], _imu_vector(imu()))


def test_unknown_camera_and_form_are_named():
    with pytest.raises(ConfigError, match=r"rear.*front"):
        seen("compact", sensors(8, 8), camera="rear")
    with pytest.raises(ConfigError, match="table3"):
        make_observation_space("table4", 8, 8)


def test_colours_stand_beside_the_classes_plane_by_plane():
    frame = sensors(40, 30)
    got = seen("compact_rgb", frame)
    np.testing.assert_array_equal(np.moveaxis(got["rgb"], 0, -1), frame.cameras[0].rgb)
    np.testing.assert_array_equal(got["seg"], seen("compact", frame)["seg"])
    with pytest.raises(ConfigError, match="draws no colours; expected its setting rgb=true"):
        seen("compact_rgb", replace(frame, cameras=(replace(frame.cameras[0], rgb=None),)))


def test_every_class_has_a_colour():
    assert set(COLOURS) == set(ClassId)


@pytest.mark.parametrize("form, most", [("compact", 2), ("table3", 4)])
def test_observation_is_quick(form, most):
    frame = sensors()
    assert multiple(lambda: seen(form, frame)) < most  # about a seventh of that


def test_a_further_sensor_is_seen_over_its_full_scale_under_its_name():
    config = resolve("quick", "sensors.odometry=typical")
    said = config.sensors.measures()
    scale = said["odometry"].full_scale
    frame = replace(sensors(), readings=(Reading(name="odometry", values=np.array(scale) * (0.25, -9.0)),))
    got = make_observation(snapshot(frame), config)
    assert got["odometry"].tolist() == [0.25, -1.0] and got["odometry"].dtype == np.float32
    assert make_observation_space(config.env.observation, 320, 240, measures=said).contains(got)
    assert "odometry" not in make_observation(snapshot(frame), RunConfig())
    for strange in ((), (Reading(name="odometry", values=np.zeros(3)),)):
        with pytest.raises(ConfigError, match="no sensor 'odometry' with 2 numbers"):
            make_observation(snapshot(replace(frame, readings=strange)), config)
