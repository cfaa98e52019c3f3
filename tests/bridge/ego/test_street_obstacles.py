from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.support.samples import cell_middles, straight_route, strip_street
from wcsim.bridge.ego.street_obstacles import ObstacleWatch, _label_pieces
from wcsim.types import F64, StreetGrid
from wcsim.users.profiles import find_builtin_profile, list_profile_names

ROUTE = straight_route(5.5)


def with_boxes(*boxes: tuple[float, float, float, float]) -> StreetGrid:
    """The sample street with solid boxes (x0, y0, x1, y1) on it."""
    grid = strip_street().grid
    x, y = cell_middles(grid)
    gap = np.full(x.shape, 25.5)
    for x0, y0, x1, y1 in boxes:
        aside, ahead = np.maximum(x0 - x, x - x1), np.maximum(y0 - y, y - y1)
        gap = np.minimum(gap, np.hypot(np.maximum(aside, 0), np.maximum(ahead, 0)))
    return replace(grid, clearance_dm=np.floor(gap * 10).astype(np.uint8))


def seen_on_the_way(grid: StreetGrid) -> list[F64]:
    watch = ObstacleWatch(grid)
    return [watch.on_way(ROUTE, progress) for progress in np.arange(0.0, 40.0, 0.13)]


@pytest.mark.parametrize("box", [(20.0, 5.4, 20.1, 5.6), (20.0, 5.2, 21.6, 6.0), (18.0, 5.8, 23.0, 7.0)])
def test_a_thing_keeps_one_number_from_first_to_last(box):
    frames = [frame for frame in seen_on_the_way(with_boxes(box)) if len(frame)]
    assert len(frames) > 30
    assert {number for frame in frames for number in frame[:, 3]} == {0.0}
    for x, y, radius, _ in np.concatenate(frames):
        assert box[0] - 0.1 <= x <= box[2] + 0.1 and box[1] - 0.1 <= y <= box[3] + 0.1
        assert radius == pytest.approx(0.1)


def test_a_thing_is_offered_from_as_far_as_the_sharpest_user_notices_one():
    sharpest_m = max(
        find_builtin_profile(name).see_m * (1.0 + find_builtin_profile(name).spread) for name in list_profile_names()
    )
    watch = ObstacleWatch(with_boxes((20.0, 5.4, 20.2, 5.6)))
    met_m = next(m for m in np.arange(0.0, 20.0, 0.05) if len(watch.on_way(ROUTE, m)))
    assert 20.0 - met_m >= sharpest_m


def test_two_things_have_two_numbers():
    frames = seen_on_the_way(with_boxes((20.0, 5.4, 20.2, 5.6), (22.0, 5.4, 22.2, 5.6)))
    together = [frame for frame in frames if len({*frame[:, 3]}) == 2]
    assert len(together) > 10
    for frame in together:
        assert len({(x > 21.0, number) for x, _, _, number in frame}) == 2


def test_what_stands_beside_the_way_is_left_out():
    assert all(not len(frame) for frame in seen_on_the_way(with_boxes((20.0, 6.3, 25.0, 6.8))))
    assert all(not len(frame) for frame in seen_on_the_way(with_boxes()))


@pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.95])
def test_pieces_are_those_of_opencv_in_its_order(share):
    rng = np.random.default_rng(1)
    for _ in range(20):
        solid = rng.random(tuple(rng.integers(1, 60, 2))) < share
        labels = np.zeros(solid.shape, np.int32)
        count, expected = cv2.connectedComponents(solid.astype(np.uint8))
        assert _label_pieces(solid, labels) == count and (labels == expected).all()
