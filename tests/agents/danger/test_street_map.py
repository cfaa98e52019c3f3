"""The street from above, and what each joystick position sweeps over, in streets that are made of boxes."""

import numpy as np
import pytest

from tests.agents.policies.test_baselines import box, looking_at
from tests.support.samples import ACTIONS
from wcsim.agents.danger.street_map import (
    AGE,
    BEHIND_M,
    CELL_M,
    EACH_SLICE,
    HALF_M,
    HIGHEST,
    KIND,
    PLANES,
    SIDE,
    SLICES,
    TRAIL,
    VECTOR,
    FeatureExtractor,
    sweep,
)
from wcsim.config import CameraConfig, RunConfig, resolve
from wcsim.errors import PolicyError
from wcsim.types import ClassId

CAMERA = CameraConfig(width_px=96, height_px=72)
CONFIG = RunConfig(cameras=(CAMERA,))
AHEAD, LEFT = ACTIONS.nearest((0.0, 1.0)), ACTIONS.nearest((-1.0, 0.0))


def observation(surface, speed=0.0, kind=0):
    seen = looking_at(surface, camera=CAMERA)
    imu = np.concatenate([seen["imu"], np.zeros(3, np.float32)])
    seg = np.full_like(seen["seg"], kind)
    return {**seen, "imu": imu, "seg": seg, "odometry": np.array([speed / 4.0, 0.0], np.float32)}


def cell(x_m, y_m):
    return SIDE - 1 - int((x_m + BEHIND_M) / CELL_M), int((HALF_M - y_m) / CELL_M)


def test_a_wall_stands_where_it_is_and_the_ground_before_it_is_known():
    sight = FeatureExtractor(CONFIG).extract(observation(box(2.0, 3.0, -3, 3, 0, 2), kind=ClassId.SIDEWALK))
    wall, floor = cell(2.05, 0.05), cell(1.55, 0.05)
    assert sight.picture.shape == (PLANES, SIDE, SIDE)
    assert sight.picture[(HIGHEST, *wall)] > 200 and sight.picture[(HIGHEST, *floor)] < 100
    assert sight.picture[(KIND, *floor)] == 60
    assert sight.vector.shape == (VECTOR,) and np.isfinite(sight.vector).all()
    assert not sight.picture[TRAIL].any()


def test_what_was_seen_stays_while_the_chair_moves_and_grows_old():
    eye = FeatureExtractor(CONFIG)
    eye.extract(observation(box(2.0, 3.0, -3, 3, 0, 2)))
    for _ in range(5):
        eye.command(AHEAD)
        moved = eye.extract(observation(lambda x, y, z: z <= -99.0, speed=1.0))
    wall = cell(2.05 - eye.around.ego.pose_O[0], 0.05)
    assert moved.picture[(AGE, *wall)] == 255 - 5 * 5
    assert moved.picture[(HIGHEST, *wall)] > 200


def test_one_map_is_written_from_all_cameras():
    config = resolve(CONFIG, 'env.camera=["front","rear"]')
    ahead, behind = box(2.0, 3.0, -3, 3, 0, 2), box(-1.4, -1.2, -3, 3, 0, 2)
    seen = observation(ahead, kind=ClassId.SIDEWALK)
    rear = looking_at(behind, camera=config.eyes["rear_"])
    seen |= {"rear_depth": rear["depth"], "rear_seg": np.full_like(rear["seg"], ClassId.SIDEWALK)}
    picture = FeatureExtractor(config).extract(seen).picture
    for place in (cell(2.05, 0.05), cell(-1.25, 0.05)):
        assert picture[(HIGHEST, *place)] > 200 and picture[(AGE, *place)] == 255
    assert picture[(HIGHEST, *cell(-0.95, 0.05))] < 100 and picture[(KIND, *cell(-0.95, 0.05))] == 60
    with pytest.raises(PolicyError, match="no rear_depth, rear_seg"):
        FeatureExtractor(config).extract(observation(ahead))


def test_people_leave_a_trail():
    sight = FeatureExtractor(CONFIG).extract(observation(box(2.0, 2.3, -0.2, 0.2, 0, 1.7), kind=ClassId.PERSON))
    assert sight.picture[(TRAIL, *cell(2.05, 0.05))] == 255


def test_what_a_position_sweeps_over_lies_ahead_of_a_chair_that_drives_on():
    eye = FeatureExtractor(CONFIG)
    around = eye.around
    starts = np.zeros((1, 6))
    starts[0, 3] = 1.0
    out = np.empty((1, 81, SLICES * EACH_SLICE * len(eye.chair)), np.int32)
    sweep(starts, around.commands, around.limits, eye.chair, out)
    assert out.min() >= 0 and out.max() < 2 * SLICES * SIDE * SIDE
    rows = (out[0] % (SIDE * SIDE)) // SIDE
    assert rows[AHEAD].min() < rows[LEFT].min(), "row 0 is the farthest ahead"
    columns = out[0, AHEAD] % SIDE
    assert abs(columns.mean() - (SIDE - 1) / 2) < 1.0


def test_every_place_of_the_hulls_edge_has_a_point_near_it():
    hull = FeatureExtractor(CONFIG).chair
    edge = hull[hull[:, 2] == 0.0, :2]
    rear, front, half = FeatureExtractor(CONFIG).around.box_B_m
    for place in [(x, y) for x in np.linspace(rear, front, 40) for y in (-half, half)]:
        assert np.linalg.norm(edge - place, axis=1).min() <= 0.1 + 1e-9


def test_to_back_where_no_camera_looked_is_blind():
    rear = resolve(CONFIG, 'env.camera=["front","rear"]')
    level = observation(lambda x, y, z: z <= 0.0)
    behind = looking_at(lambda x, y, z: z <= 0.0, camera=rear.eyes["rear_"])
    both = level | {"rear_depth": behind["depth"], "rear_seg": behind["seg"]}
    eye, all_round = FeatureExtractor(CONFIG), FeatureExtractor(rear)
    blind = eye.backs_blindly(eye.extract(level))
    back = (ACTIONS.points[:, 1] <= -0.75) & (np.abs(ACTIONS.points[:, 0]) <= 0.25)
    assert blind[back].all() and not blind[ACTIONS.points[:, 1] >= 0.0].any()
    assert not all_round.backs_blindly(all_round.extract(both)).any()
