"""Crossings that no program of their light ever frees: they are known, and ways lead round them."""

import gzip
from dataclasses import replace

import numpy as np
import pytest

from tests.support.lit_road import lit_road
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.walking.routes import Router
from wcsim.types import WalkEdge, WalkGraph, WayKind

SECOND_PROGRAM = (
    '<additional><tlLogic id="C" type="static" programID="other" offset="0">'
    '<phase duration="9" state="rrG"/></tlLogic></additional>'
)


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    return lit_road(tmp_path_factory.mktemp("road"))


def never_green(town) -> list[bool]:
    return [edge.never_green for edge in unpack_street(build_street(town)).walk.edges if edge.kind is WayKind.CROSSING]


def test_a_crossing_is_never_green_when_no_phase_of_any_program_frees_it(road, tmp_path):
    assert never_green(road) == [False]
    text = gzip.decompress(road.net.read_bytes()).decode()
    assert text.count('state="rrG"') == 1
    net, more = tmp_path / "dead.net.xml.gz", tmp_path / "more.add.xml"
    net.write_bytes(gzip.compress(text.replace('state="rrG"', 'state="rrr"').encode()))
    more.write_text(SECOND_PROGRAM)
    assert never_green(replace(road, net=net)) == [True]
    assert never_green(replace(road, net=net, additional=(more,))) == [False]


def test_a_way_leads_round_a_crossing_that_is_never_green_and_over_it_where_there_is_no_other():
    """Two pavements 8 m apart, with crossings at x = 10 and x = 90."""
    nodes = np.array([(0, 0), (10, 0), (90, 0), (100, 0), (0, 8), (10, 8), (90, 8), (100, 8)], float)
    pavements, roads = [(0, 1), (1, 2), (2, 3), (4, 5), (5, 6), (6, 7)], [(1, 5), (2, 6)]

    def over_the_near_one(*, dead, far_too):
        edges = [
            WalkEdge(
                sumo_id=f"{a}-{b}", kind=WayKind.CROSSING if (a, b) in roads else WayKind.SIDEWALK, start=a, end=b,
                points_W_m=nodes[[a, b]], width_m=2.0, never_green=dead and (a, b) == (1, 5),
            )
            for a, b in (*pavements, *(roads if far_too else roads[:1]))
        ]  # fmt: skip
        route = Router(WalkGraph(nodes_W_m=nodes, edges=tuple(edges))).route((5.0, 0.0), (5.0, 8.0))
        x, y = route.points_W_m[:, 0], route.points_W_m[:, 1]
        return bool((np.isclose(x, 10.0) & (y > 1.0) & (y < 7.0)).any())

    assert over_the_near_one(dead=False, far_too=True)
    assert not over_the_near_one(dead=True, far_too=True)
    assert over_the_near_one(dead=True, far_too=False)
