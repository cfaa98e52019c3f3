"""What netgenerate draws, how it is shaped, and which street is what."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import networkx
import numpy as np
import pytest

from wcsim.core.seeding import make_rng
from wcsim.towns.making.asked_town import KINDS
from wcsim.towns.making.maker import COLLECTOR, MAIN, RESIDENTIAL, WALK, _make_streets
from wcsim.towns.making.plan import StreetPlan, _connected, _least_angle_rad, _merged, draw_plan, shape_plan

DRAWS = [(kind, seed) for kind in KINDS for seed in range(4)]


@cache  # nobody changes one
def shaped_plan(kind: str, seed: int) -> StreetPlan:
    rng = make_rng(seed, "test")
    with TemporaryDirectory() as folder:
        plan = draw_plan(kind, 700.0, seed, rng, Path(folder))
        assert not list(Path(folder).iterdir())
    return shape_plan(plan, rng)


@pytest.mark.parametrize("kind, seed", DRAWS)
def test_plans_are_as_large_as_ordered_and_have_room_at_junctions(kind: str, seed: int) -> None:
    shaped = shaped_plan(kind, seed)
    graph = shaped.graph()
    assert networkx.is_connected(graph)
    assert 0.7 * 700.0 < np.ptp(shaped.nodes_m, axis=0).max() < 1.5 * 700.0
    assert _least_angle_rad(shaped, shaped.lines_m) > np.radians(40.0)
    assert max(degree for _, degree in graph.degree()) <= 9
    for (a, b), line in zip(shaped.links, shaped.lines_m, strict=True):
        assert np.allclose(line[[0, -1]], shaped.nodes_m[[a, b]])
        assert np.hypot(*(line[-1] - line[0])) > 20.0


@pytest.mark.parametrize("kind, seed", DRAWS)
def test_every_link_is_of_one_street_and_everybody_gets_everywhere(kind: str, seed: int) -> None:
    shaped = shaped_plan(kind, seed)
    streets = _make_streets(shaped, make_rng(seed, "streets"))
    assert sorted(link for street in streets for link in street.links) == list(range(len(shaped.links)))
    driven = networkx.DiGraph()
    for street in streets:
        ends = [shaped.links[link] for link in street.links]
        if street.kind is not WALK:
            driven.add_edges_from([*ends, *(() if street.oneway else ((b, a) for a, b in ends))])
    assert networkx.is_strongly_connected(driven)
    assert len(driven) == len(shaped.nodes_m)
    assert streets[0].kind is MAIN
    assert {MAIN, COLLECTOR, RESIDENTIAL} <= {street.kind for street in streets}


def test_one_way_streets_and_streets_for_walkers_exist() -> None:
    streets = [
        street for seed in range(6) for street in _make_streets(shaped_plan("grid", seed), make_rng(seed, "streets"))
    ]
    assert any(street.oneway and street.kind is RESIDENTIAL for street in streets)
    assert any(street.kind is WALK for street in streets)
    assert any(street.tram for street in streets)
    assert all("tram" in street.closed.split() for street in streets if not street.tram and street.kind is not WALK)


def test_the_largest_part_is_kept() -> None:
    nodes_m = np.array([[0.0, 0.0], [1.0, 0.0], [9.0, 9.0], [2.0, 0.0], [9.0, 8.0]])
    plan = _connected(StreetPlan(nodes_m=nodes_m, links=((0, 1), (1, 3), (2, 4))))
    assert plan.links == ((0, 1), (1, 2))
    assert plan.nodes_m.tolist() == [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]


def test_junctions_that_are_too_close_are_made_one() -> None:
    nodes_m = np.array([[0.0, 0.0], [100.0, 0.0], [120.0, 0.0], [220.0, 0.0], [120.0, 90.0]])
    plan = _merged(StreetPlan(nodes_m=nodes_m, links=((0, 1), (1, 2), (2, 3), (2, 4), (1, 4))))
    assert plan.links == ((0, 1), (1, 2), (1, 3))
    assert plan.nodes_m.tolist() == [[0.0, 0.0], [110.0, 0.0], [220.0, 0.0], [120.0, 90.0]]
