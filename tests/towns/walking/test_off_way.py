"""Starts where a chair does not belong, on a street whose kerbs lie at |y| = 4."""

import math

import numpy as np

from tests.support.samples import strip_street
from wcsim.towns.walking.off_way import ASIDE_DEG, FAR_M, off_way_start
from wcsim.types import ClassId

GRID = strip_street().grid
HERE = np.array([15.0, 5.5])


def test_they_lie_off_the_ways_or_face_a_step_within_reach():
    rng = np.random.default_rng(1)
    starts = [off_way_start(GRID, HERE, rng) for _ in range(300)]
    off, faces = [], []
    for start in starts:
        assert start is not None and start.goal_W_m == tuple(HERE)
        place = np.array(start.p_W_m)
        off.append(GRID.class_at(place) not in (ClassId.SIDEWALK, ClassId.KERB))
        assert GRID.clearance_at(place) >= 0.9
        turns = start.yaw_rad + np.linspace(-1.0, 1.0, 121) * math.radians(ASIDE_DEG)
        ahead = place + FAR_M[1] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
        faces.append((np.abs(GRID.raised_at(ahead) - GRID.raised_at(place)) > 0.05).any())
    facing = sum(faces)
    assert all(one or other for one, other in zip(off, faces, strict=True)) and 0 < sum(off) < len(off)
    assert facing > 0.75 * len(starts)
    assert len({start.p_W_m for start in starts}) == len(starts)


def test_where_all_ground_is_a_way_there_is_none():
    narrow = GRID.__class__(
        origin_W_m=(-70.0, -70.0), cell_m=1.0, height_cm=np.zeros((150, 150), np.uint8),
        ground_class=np.full((150, 150), ClassId.SIDEWALK, np.uint8),
        clearance_dm=np.full((150, 150), 255, np.uint8),
    )  # fmt: skip
    assert off_way_start(narrow, np.zeros(2), np.random.default_rng(0)) is None
