import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.support.samples import strip_street
from wcsim.bridge.reaction.pedestrians import SHOULDER, SOLID_GAP_M, _can_stand, _way_is_open
from wcsim.types import ClassId

GRID = strip_street().grid
WALKABLE = (ClassId.SIDEWALK, ClassId.CROSSWALK, ClassId.TERRAIN)


@given(st.floats(-10.0, 90.0), st.floats(-12.0, 12.0), st.floats(-math.pi, math.pi), st.floats(0.15, 0.3))
def test_one_stands_where_the_raster_says_that_both_shoulders_do(x, y, yaw, radius):
    side = SHOULDER * radius * np.array([-math.sin(yaw), math.cos(yaw)])
    middle = np.array([x, y])
    walkable = [int(GRID.class_at(p)) in WALKABLE for p in (middle, middle + side, middle - side)]
    clear = float(GRID.clearance_at(middle)) >= SOLID_GAP_M
    assert _can_stand(GRID, x, y, math.cos(yaw), math.sin(yaw), radius) == (clear and all(walkable))


def test_a_way_is_open_along_the_pavement_and_not_over_its_edge():
    east = (1.0, 0.0)
    assert _way_is_open(GRID, (5.0, 5.5), (5.0, 5.9), east, 4.0, 0.25)
    assert not _way_is_open(GRID, (5.0, 5.5), (5.0, 3.9), east, 0.0, 0.25)  # onto the carriageway
    assert not _way_is_open(GRID, (5.0, 5.5), (5.0, 5.5), (0.0, -1.0), 4.0, 0.25)  # leads onto it
