"""A request for green: which phase comes next, and what a traffic light of SUMO makes of it, step by step."""

import gzip
from itertools import groupby
from shutil import copytree

import numpy as np
import pytest

from tests.bridge.sumo.test_session import options
from tests.support.lit_road import CROSSING_LINKS, lit_road
from wcsim.bridge.reaction.commands import GreenRequest
from wcsim.bridge.sumo.session import SumoSession
from wcsim.bridge.sumo.signal_control import _Phase, _towards_green
from wcsim.towns.scenario.town import find_town
from wcsim.types import SignalState

NEAR = np.zeros((1, 2))
ASKED = [GreenRequest(tls_id="C", links=CROSSING_LINKS)]
CARS_GREEN, YELLOW, FREE, ALL_RED = "GGr", "yyr", "rrG", "rrr"


def program(*phases):
    """Phases by colours and what may follow them."""
    return tuple(
        _Phase(shows=SignalState(tls_id="t", colours=colours), least_s=5.0, following=following)
        for colours, following in phases
    )


OPTIONAL = program((CARS_GREEN, (0, 1)), (YELLOW, (2,)), (FREE, (3,)), (ALL_RED, (0,)))


@pytest.mark.parametrize("now, following", [(0, 1), (1, 2), (2, None), (3, 0)])
def test_the_next_phase_is_one_that_the_program_allows(now, following):
    assert _towards_green(OPTIONAL, now, CROSSING_LINKS) == following


def test_the_shortest_of_several_ways_is_taken_and_no_way_is_none():
    forked = program(("Grr", (1, 2)), ("yrr", (3,)), ("yyr", (4,)), ("rGr", (0,)), ("rrG", (0,)))
    assert _towards_green(forked, 0, (2,)) == 2 and _towards_green(forked, 0, (1,)) == 1
    assert _towards_green(forked, 0, (1, 2)) is None
    assert _towards_green(program(("Gr", (0,)), ("rG", (0,))), 0, (1,)) is None


@pytest.fixture(scope="module")
def roads(tmp_path_factory):
    kinds = ("actuated", "static", "delay_based")
    return {kind: lit_road(tmp_path_factory.mktemp(kind), kind).folder for kind in kinds}


def colours(road, seconds, asks=lambda time_s: False):
    """Colours and how many steps they lasted, in order."""
    with SumoSession(options(road)) as sumo:
        seen = []
        for step in range(round(seconds / 0.1)):
            if asks(0.1 * step):
                sumo.buttons.request(ASKED)
            sumo.step()
            seen.append(sumo.signals(NEAR, 500.0)[0].colours)
    return [(shown, len(list(steps))) for shown, steps in groupby(seen)]


def test_without_a_request_an_optional_green_never_comes(roads):
    assert colours(roads["actuated"], 200.0) == [(CARS_GREEN, 2000)]


@pytest.mark.parametrize(
    "kind, from_s",
    [*(("actuated", from_s) for from_s in (0.0, 4.9, 5.0, 30.0, 153.2)), ("delay_based", 4.9), ("delay_based", 30.0)],
)
def test_a_request_is_heard_after_the_least_green_and_over_the_whole_yellow(roads, kind, from_s):
    """Cars have their least green of 5 s, then 3 s of yellow; people have 5 s, and the program goes on as ever."""
    found = colours(roads[kind], from_s + 40.0, lambda time_s: from_s - 0.05 <= time_s <= from_s + 8.0)
    assert [shown for shown, _ in found[:5]] == [CARS_GREEN, YELLOW, FREE, ALL_RED, CARS_GREEN]
    assert [steps for _, steps in found[1:4]] == [30, 50, 50]
    assert abs(found[0][1] - round(10.0 * max(from_s, 5.0))) <= 1
    assert found[5:] == []  # nobody asks any more


def test_who_asks_on_gets_the_next_green_after_another_least_one(roads):
    found = colours(roads["actuated"], 60.0, lambda time_s: True)
    assert {steps for shown, steps in found[:-1] if shown == CARS_GREEN} <= {50, 51}
    assert sum(shown == FREE for shown, _ in found) == 3


def test_a_program_of_fixed_times_hears_no_request(roads):
    plain = colours(roads["static"], 200.0)
    assert any(shown == FREE for shown, _ in plain)
    assert colours(roads["static"], 200.0, lambda time_s: True) == plain


def test_a_program_that_is_coordinated_with_others_hears_no_request(roads, tmp_path):
    town = find_town(str(roads["actuated"]))
    text = gzip.decompress(town.net.read_bytes()).decode()
    assert "</tlLogic>" in text
    copytree(town.folder, tmp_path / "town")
    marked = text.replace("</tlLogic>", '<param key="coordinated" value="true"/></tlLogic>')
    (tmp_path / "town" / town.net.name).write_bytes(gzip.compress(marked.encode()))
    plain = colours(tmp_path / "town", 100.0)
    assert colours(tmp_path / "town", 100.0, lambda time_s: True) == plain


def test_of_two_requests_to_one_light_the_first_is_heard_and_an_unknown_light_none(roads):
    with SumoSession(options(roads["actuated"])) as sumo:
        for _ in range(70):
            unknown, second = GreenRequest(tls_id="none", links=(0,)), GreenRequest(tls_id="C", links=(0,))
            sumo.buttons.request([unknown, *ASKED, second])
            sumo.step()
        assert sumo.signals(NEAR, 500.0)[0].colours == YELLOW
