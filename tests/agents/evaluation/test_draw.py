"""Episodes are drawn where a chair can stand, go where they should, and do not meet."""

import math

import pytest

from tests.agents.evaluation.suite.lists import config
from wcsim.agents.evaluation.suite.draw import DrawPlace, WaySpec, _reference_time_s, free_blocks
from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street

FREE = WaySpec(part="free", profiles=("ataxic", "inattentive"))


@pytest.fixture(scope="module")
def place():
    return DrawPlace("manhattan", load_street(find_town("manhattan")), config())


@pytest.fixture(scope="module")
def blocks(place):
    return free_blocks(place, FREE, 3, 5)


def test_ways_keep_apart_and_are_the_same_for_the_same_seed(place, blocks):
    assert blocks[:1] == free_blocks(place, FREE, 1, 5) != free_blocks(place, FREE, 1, 6)
    assert [block.episodes[0].profile for block in blocks] == ["ataxic", "inattentive", "ataxic"]
    for block in blocks:
        ways = [place.router.route(episode.start_m, episode.goal_m) for episode in block.episodes]
        for number, way in enumerate(ways):
            assert abs(way.arc_m[-1] - block.episodes[number].route_m) < 1e-3
            for other in ways[:number]:
                assert min(math.dist(a, b) for a in way.points_W_m[::5] for b in other.points_W_m[::5]) > 50.0


def test_the_reference_grows_with_the_way_and_with_a_slower_user(place, blocks):
    episode = blocks[0].episodes[0]
    way = place.router.route(episode.start_m, episode.goal_m)
    quick_s, slow_s = (_reference_time_s(way, who, place.config) for who in ("competent", "ataxic"))
    assert way.arc_m[-1] / place.config.chair.v_max_mps < quick_s <= slow_s
