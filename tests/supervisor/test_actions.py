import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.errors import ConfigError
from wcsim.supervisor.actions import NAMES, action_set

FOLLOW = 0.1768
angle = st.floats(-math.pi, math.pi)
unit = st.floats(-1.0, 1.0)


@pytest.mark.parametrize("name, count", [("square81", 81), ("disc69", 69)])
def test_sizes_and_lattice(name, count):
    actions = action_set(name)
    assert len(actions) == count == len({tuple(p) for p in actions.points})
    assert np.all(actions.points * 4 == np.rint(actions.points * 4))


@pytest.mark.parametrize("name", NAMES)
@given(angle, st.floats(0.0, 1.0))
def test_every_position_of_a_round_gate_can_be_followed(name, way, radius):
    actions = action_set(name)
    stick = (radius * math.cos(way), radius * math.sin(way))
    assert actions.distance(actions.nearest(stick), stick) <= FOLLOW + 1e-6


def test_the_lattice_points_inside_the_disc_would_not_do():
    points = action_set("square81").points
    inside = points[(points**2).sum(axis=1) <= 1 + 1e-9]
    ways = np.linspace(-np.pi, np.pi, 3600)
    rim = np.stack([np.cos(ways), np.sin(ways)], axis=1)
    gaps = np.sqrt(((rim[:, None] - inside) ** 2).sum(axis=-1).min(axis=1))
    assert len(inside) == 49
    assert 0.3 < np.mean(gaps > FOLLOW) < 0.45


@pytest.mark.parametrize("name", NAMES)
def test_mirror_is_its_own_inverse(name):
    actions = action_set(name)
    assert np.array_equal(actions.mirror[actions.mirror], np.arange(len(actions)))
    assert np.array_equal(actions.points[actions.mirror], actions.points * [-1.0, 1.0])


@pytest.mark.parametrize("name", NAMES)
@given(unit, unit)
def test_nearest_agrees_with_all_distances(name, x, y):
    actions = action_set(name)
    gaps = np.hypot(actions.points[:, 0] - x, actions.points[:, 1] - y)
    assert gaps[actions.nearest((x, y))] == pytest.approx(gaps.min(), abs=1e-12)
    assert np.allclose(actions.distances(np.array([[x, y]]))[0], np.minimum(gaps, 2.0))


def test_ties_go_to_the_lower_index_and_distances_end_at_two():
    actions = action_set("square81")
    assert actions.nearest((0.125, 0.125)) == actions.nearest((0.12, 0.12))
    assert actions.distance(0, (1.0, 1.0)) == 2.0


def test_an_unknown_set_is_refused():
    with pytest.raises(ConfigError, match="disc49"):
        action_set("disc49")
