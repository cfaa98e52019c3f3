"""The street from above, and the numbers of each joystick position, in streets that are made of boxes."""

from __future__ import annotations

import numpy as np
import pytest

from tests.agents.policies.test_baselines import box, looking_at
from wcsim.agents.danger.roll_outs import GAP, MOVER_GAP, SLICES, TOUCH, profile, sweep
from wcsim.agents.danger.sight import VECTOR, Eye
from wcsim.agents.danger.street_map import (
    AGE,
    BEHIND_M,
    CELL_M,
    EDGES,
    GROUND,
    HALF_M,
    HIGHEST,
    KIND,
    PLANES,
    SIDE,
    TRAIL,
)
from wcsim.config import CameraConfig, RunConfig
from wcsim.supervisor.actions import action_set
from wcsim.types import ClassId

CAMERA = CameraConfig(width_px=96, height_px=72)
CONFIG = RunConfig(cameras=(CAMERA,))
POINTS = action_set("square81").points
AHEAD, LEFT = action_set("square81").nearest((0.0, 1.0)), action_set("square81").nearest((-1.0, 0.0))


def observation(surface, speed=0.0, kind=0):
    seen = looking_at(surface, camera=CAMERA)
    imu = np.concatenate([seen["imu"], np.zeros(3, np.float32)])
    seg = np.full_like(seen["seg"], kind)
    return {**seen, "imu": imu, "seg": seg, "odometry": np.array([speed / 4.0, 0.0], np.float32)}


def cell(x_m, y_m):
    return SIDE - 1 - int((x_m + BEHIND_M) / CELL_M), int((HALF_M - y_m) / CELL_M)


def test_a_wall_stands_where_it_is_and_the_ground_before_it_is_known():
    sight = Eye(CONFIG).look(observation(box(2.0, 3.0, -3, 3, 0, 2), kind=ClassId.SIDEWALK))
    wall, floor = cell(2.05, 0.05), cell(1.55, 0.05)
    assert sight.picture.shape == (PLANES, SIDE, SIDE)
    assert sight.picture[(HIGHEST, *wall)] > 200 and sight.picture[(HIGHEST, *floor)] < 100
    assert sight.picture[(EDGES, *wall)] == 255 and sight.picture[(EDGES, *floor)] == 0
    assert sight.picture[(GROUND, *floor)] == 255 and sight.picture[(KIND, *floor)] == 60
    assert not sight.picture[TRAIL].any()


def test_what_was_seen_stays_while_the_chair_moves_and_grows_old():
    eye = Eye(CONFIG)
    eye.look(observation(box(2.0, 3.0, -3, 3, 0, 2)))
    for _ in range(5):
        eye.command(AHEAD)
        moved = eye.look(observation(lambda x, y, z: z <= -99.0, speed=1.0))
    wall = cell(2.05 - eye.around.ego.pose_O[0], 0.05)
    assert moved.picture[(AGE, *wall)] == 255 - 5 * 5
    assert moved.picture[(HIGHEST, *wall)] > 200


def test_people_leave_a_trail():
    sight = Eye(CONFIG).look(observation(box(2.0, 2.3, -0.2, 0.2, 0, 1.7), kind=ClassId.PERSON))
    assert sight.picture[(TRAIL, *cell(2.05, 0.05))] == 255


def test_the_way_into_a_wall_is_close_and_the_way_back_is_not():
    near, far = (Eye(CONFIG).look(observation(box(x, 6.0, -3, 3, 0, 2), speed=1.0)) for x in (1.3, 4.5))
    back = action_set("square81").nearest((0.0, -1.0))
    assert near.actions[AHEAD, GAP] < 80 < far.actions[AHEAD, GAP]
    assert near.actions[AHEAD, TOUCH] < 255 == far.actions[AHEAD, TOUCH]
    assert near.actions[back, GAP] > near.actions[AHEAD, GAP]
    assert near.vector.shape == (VECTOR,) and np.isfinite(near.vector).all()


def test_who_moves_is_told_apart_from_what_stands():
    eye = Eye(CONFIG)
    around, out = eye.around, np.empty((81, 5), np.uint8)
    stands = np.array([[1.5, 0.0, 0.0, 0.0, 0.0]])
    comes = np.array([[3.0, 0.0, -2.0, 0.0, 0.0]])
    start = np.zeros(6)
    for points, which in ((stands, GAP), (comes, MOVER_GAP)):
        profile(start, 0.0, around.commands, around.limits, around.box_B_m, points, out)
        other = MOVER_GAP if which == GAP else GAP
        assert out[AHEAD, which] < 200 and (out[:, other] == 255).all()


def test_what_a_position_sweeps_over_lies_ahead_of_a_chair_that_drives_on():
    eye = Eye(CONFIG)
    around = eye.around
    starts = np.zeros((1, 6))
    starts[0, 3] = 1.0
    out = np.empty((1, 81, SLICES * 4 * len(eye.chair)), np.int32)
    sweep(starts, around.commands, around.limits, eye.chair, out)
    assert out.min() >= 0 and out.max() < 2 * SLICES * SIDE * SIDE
    rows = (out[0] % (SIDE * SIDE)) // SIDE
    assert rows[AHEAD].min() < rows[LEFT].min(), "row 0 is the farthest ahead"
    columns = out[0, AHEAD] % SIDE
    assert abs(columns.mean() - (SIDE - 1) / 2) < 1.0


ON_ONE_SIDE = pytest.mark.parametrize(
    "surface", [box(1.5, 2.0, -1, 0.1, 0, 1), box(1.3, 2.0, 0.2, 1, 0, 1)], ids=["right and middle", "left"]
)


def off_in_a_mirror(look, surface):
    """How far the numbers in a street are off from those in its mirror image, for positions that turn and drive ahead.

    The first is that of mirrored positions, the second that of the same ones.
    """
    actions = action_set("square81")
    here, there = (
        look(street).actions[:, (GAP, TOUCH)].astype(int) for street in (surface, lambda x, y, z: surface(x, -y, z))
    )
    turns = (POINTS[:, 0] != 0.0) & (POINTS[:, 1] > 0.0)
    return [np.abs(numbers - there)[turns].mean(axis=0) for numbers in (here[actions.mirror], here)]


@ON_ONE_SIDE
def test_left_and_right_change_places_as_they_should(surface):
    mirrored, same = off_in_a_mirror(lambda street: Eye(CONFIG).look(observation(street, speed=0.8)), surface)
    assert (mirrored < 1.0).all() and (same > 20.0).all()
