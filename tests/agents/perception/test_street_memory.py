"""What is remembered of the street, for how long, and what is known of the ground."""

import math

import numpy as np
import pytest

from wcsim.agents.perception.street_memory import (
    AXLE_ROW,
    CELL_M,
    COLUMNS,
    FORGET_M,
    KEEP_BRIEFLY_S,
    KEEP_WAY_M,
    REACH_M,
    ROWS,
    StreetMemoryGrid,
    is_free_ground,
    is_known_place,
)
from wcsim.agents.perception.surroundings import _extend_edges
from wcsim.agents.policies.dwa import _backs_blindly
from wcsim.config import ChairConfig
from wcsim.core.joystick import drive_limits_from_chair

BOX = np.array([-0.34, 0.80, 0.31])
LIMITS = drive_limits_from_chair(ChairConfig())
HERE = np.zeros(3)
NOTHING, UNSEEN = np.zeros((0, 2)), np.full((ROWS, COLUMNS), np.inf, np.float32)
POST = np.array([[2.05, 0.45]])
BEFORE = (1.75, 0.35)


def measured(*places):
    """A raster in which there is level ground at some places."""
    low_m = UNSEEN.copy()
    for x, y in places:
        low_m[AXLE_ROW + math.floor(x / CELL_M), math.floor((y + REACH_M) / CELL_M)] = 0.0
    return low_m


def look(memory, points=NOTHING, low_m=UNSEEN, pose=HERE, way_m=0.0, brief=False, times=1, ahead=True):
    for _ in range(times):
        memory.update(points, np.full(len(points), brief), low_m, pose, way_m, ahead=ahead)


@pytest.fixture
def memory():
    return StreetMemoryGrid(0.1, BOX)


def kept(memory, pose=HERE, way_m=0.0):
    """How many points are remembered."""
    return len(memory.points_B_m(pose, way_m))


def test_what_was_seen_for_a_while_stays_until_the_chair_has_left_it(memory):
    look(memory, POST, times=3)
    look(memory, times=600)
    assert memory.points_B_m(HERE, 0.0) == pytest.approx(POST)
    left = np.array([0.0, -1.5, math.pi / 2])
    (seen,) = memory.points_B_m(left, 4.0)
    assert seen == pytest.approx([1.95, -2.05])
    assert kept(memory, np.array([-FORGET_M, 0.0, 0.0]), 4.0) == 0
    assert kept(memory, way_m=8.0) == 0  # it is gone for good


def test_after_a_long_way_its_place_is_no_longer_sure(memory):
    look(memory, POST, times=3)
    assert kept(memory, way_m=KEEP_WAY_M - 0.1) == 1
    assert kept(memory, way_m=KEEP_WAY_M + 0.1) == 0


@pytest.mark.parametrize("times, brief", [(1, False), (5, True)])
def test_what_was_seen_once_and_who_can_walk_off_is_kept_for_seconds(memory, times, brief):
    look(memory, POST, times=times, brief=brief)
    look(memory, times=round(KEEP_BRIEFLY_S / 0.1))
    assert kept(memory) == 1
    look(memory)
    assert kept(memory) == 0


def test_ground_where_something_was_takes_it_away_the_later_the_surer_it_was(memory):
    ground = measured(POST[0], BEFORE)
    for times, contradictions in ((1, 1), (2, 2), (9, 3)):
        memory.forget()
        look(memory, POST, times=times)
        look(memory, low_m=ground, times=contradictions - 1)
        assert kept(memory) == 1
        look(memory, low_m=ground)
        assert kept(memory) == 0
    look(memory, POST, times=3)
    for elsewhere in (measured((2.05, 1.45), BEFORE), measured(POST[0])):
        look(memory, low_m=elsewhere, times=9)
        # Other ground says nothing of it, nor does its own where that before it is out of the picture: no step shows.
        assert kept(memory) == 1


def test_the_raster_goes_round_without_mixing_up_places(memory):
    rng = np.random.default_rng(3)
    pose, way_m, there = np.zeros(3), 0.0, {}
    for step in range(200):
        points = rng.uniform(-3.0, 3.0, (5, 2))
        look(memory, points, pose=pose, way_m=way_m, times=2)
        for x, y in points + pose[:2]:
            there[math.floor(x / CELL_M), math.floor(y / CELL_M)] = (x, y, step)
        pose, way_m = pose + np.array([0.4, -0.3, 0.0]), way_m + 0.5
        there = {
            key: (x, y, at)
            for key, (x, y, at) in there.items()
            if math.hypot(x - pose[0], y - pose[1]) <= FORGET_M and way_m - 0.5 * at <= KEEP_WAY_M
        }
        found = memory.points_B_m(pose, way_m) + pose[:2]
        assert sorted(map(tuple, found.round(9))) == sorted((round(x, 9), round(y, 9)) for x, y, _ in there.values())


def test_ground_is_what_was_seen_or_stood_on(memory):
    look(memory, POST, measured((3.05, -1.05), POST[0]))
    cells = memory.cells
    assert is_free_ground(cells, 3.05, -1.05) and is_free_ground(cells, 0.5, 0.2)
    assert not is_free_ground(cells, *POST[0]) and is_known_place(cells, *POST[0])
    assert not is_free_ground(cells, 0.0, 0.45) and is_known_place(cells, 0.0, 0.45)  # right beside the chair
    assert not is_known_place(cells, -0.9, 0.0) and not is_known_place(cells, 0.0, 0.9)
    assert not is_known_place(cells, 3.05 + 96 * CELL_M, -1.05)  # the same cell, another place


def blind(memory, *sticks, pose=HERE, speed_mps=0.0):
    found = np.empty(len(sticks), bool)
    start = np.array([0.0, 0.0, 0.0, speed_mps, 0.0, 0.0])
    _backs_blindly(start, 0.5, np.array(sticks), LIMITS, BOX, memory.cells, pose, found)
    return found.tolist()


def test_backwards_it_may_go_where_it_has_been(memory):
    look(memory)
    sticks = ((0.0, -1.0), (0.0, 0.0), (0.5, 0.0), (0.0, 0.5))
    assert blind(memory, *sticks, speed_mps=-0.5) == [True, False, False, False]
    for x in np.arange(0.0, 2.0, 0.1):
        look(memory, pose=np.array([x, 0.0, 0.0]))
    came = np.array([1.9, 0.0, 0.0])
    assert blind(memory, *sticks, pose=came, speed_mps=-0.5) == [False] * 4
    assert blind(memory, (1.0, -1.0), pose=came + np.array([0.0, 0.0, math.pi / 2]), speed_mps=-0.5) == [True]


def test_backing_up_does_not_make_known_what_is_behind(memory):
    x = 0.0
    look(memory)
    while not blind(memory, (0.0, -0.2), pose=np.array([x, 0.0, 0.0]))[0]:
        look(memory, pose=np.array([x, 0.0, 0.0]), ahead=False)
        x -= 0.05
        assert x > -1.0
    assert x < -0.1


def carried(memory, points):
    added = np.empty((96, 2))
    return added[: _extend_edges(points, memory.cells, HERE, added)].copy()


def line(begin, end, count=30):
    return np.linspace(begin, end, count)


def test_a_straight_edge_ahead_is_carried_on_beside_the_chair(memory):
    look(memory)
    added = carried(memory, line((1.2, -0.6), (3.0, -0.78)))
    assert added[:, 0].max() == pytest.approx(1.1) and added[:, 0].min() < -1.0
    assert np.allclose(added[:, 1], -0.6 - 0.1 * (added[:, 0] - 1.2), atol=0.09)
    known = measured(*((x, -0.55) for x in np.arange(0.05, 1.2, 0.1)), *((x, -0.45) for x in np.arange(0.05, 1.2, 0.1)))
    look(memory, low_m=known)
    assert carried(memory, line((1.2, -0.55), (3.0, -0.55)))[:, 0].max() < 0.0, "there is ground, it was seen"


@pytest.mark.parametrize(
    "points",
    [
        line((1.2, -0.6), (1.8, -0.6)),  # short
        line((1.2, -0.6), (3.0, -0.6), 5),  # few
        line((1.2, -0.6), (2.0, -1.3)),  # steep
        line((1.2, -1.9), (3.0, -1.9)),  # far
        np.random.default_rng(0).uniform((0.6, -1.3), (3.1, -0.3), (12, 2)),  # no line
    ],
)
def test_what_is_no_edge_is_not_carried_on(memory, points):
    look(memory)
    assert len(carried(memory, points)) == 0
