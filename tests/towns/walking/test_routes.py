import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import Polygon, box

from tests.support.samples import strip_walk
from wcsim.core.seeding import make_rng
from wcsim.errors import TownError
from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street
from wcsim.towns.walking.graph import shortest_inside
from wcsim.towns.walking.routes import Router
from wcsim.types import Street, WalkEdge, WalkGraph, WayKind
from wcsim.users.crossing import find_route_crossings


def test_route_crosses_where_the_crossing_is() -> None:
    router = Router(strip_walk())
    route = router.route((10.0, 6.0), (10.0, -6.0))
    kinds = [router.walk.edges[i].kind for i in route.edge_index]
    assert WayKind.CROSSING in kinds
    assert route.points_W_m[0].tolist() == [10.0, 5.5] and route.points_W_m[-1].tolist() == [10.0, -5.5]
    assert route.arc_m[-1] == pytest.approx(30 + 11 + 30)


def test_route_along_one_edge_either_way_and_to_the_same_place() -> None:
    router = Router(strip_walk())
    assert router.route((30.0, 5.5), (10.0, 5.5)).points_W_m[0].tolist() == [30.0, 5.5]
    same = router.route((10.0, 5.5), (10.0, 5.5))
    assert len(same.points_W_m) == 2 and same.arc_m[-1] == 0.0


def test_a_spur_to_a_node_and_back_is_left_out() -> None:
    """Ways through a walking area meet in nodes, and one of them may lie aside."""
    lines = [[(0.0, 0.0), (5.0, 0.0)], [(5.0, 0.0), (5.1, 1.6)], [(5.1, 1.6), (5.3, 0.1), (12.0, 0.0)]]
    ends = np.array([(0.0, 0.0), (5.0, 0.0), (5.1, 1.6), (12.0, 0.0)])
    edges = tuple(
        WalkEdge(sumo_id=str(i), kind=WayKind.SIDEWALK, start=i, end=i + 1, points_W_m=np.array(line), width_m=2.0)
        for i, line in enumerate(lines)
    )
    route = Router(WalkGraph(nodes_W_m=ends, edges=edges)).route((0.2, 0.0), (11.8, 0.0))
    assert route.points_W_m[:, 1].max() < 0.7
    assert route.arc_m[-1] == pytest.approx(11.6, abs=0.3)
    steps = np.linalg.norm(np.diff(route.points_W_m, axis=0), axis=1)
    assert np.allclose(np.diff(route.arc_m), steps) and len(route.edge_index) == len(route.points_W_m)


def test_empty_network_is_refused() -> None:
    with pytest.raises(TownError, match="no connected pavement"):
        Router(WalkGraph(nodes_W_m=np.zeros((0, 2)), edges=()))


def test_drawn_routes_are_fine_and_repeatable(manhattan: Street) -> None:
    router = Router(manhattan.walk)
    drawn = []
    for _ in range(2):
        rng = make_rng(5, "test")
        start, yaw_rad = router.random_start(rng)
        goal = router.random_goal(rng, start, 60.0, 200.0)
        drawn.append((start, yaw_rad, goal))
    assert drawn[0] == drawn[1]
    rng = make_rng(6, "test")
    lengths_m = []
    for _ in range(25):
        start, yaw_rad = router.random_start(rng)
        assert -np.pi <= yaw_rad <= np.pi
        route = router.route(start, router.random_goal(rng, start, 60.0, 200.0))
        steps_m = np.linalg.norm(np.diff(route.points_W_m, axis=0), axis=1)
        assert steps_m.max() <= 1.0 + 1e-6 and steps_m.min() > 0.0
        assert np.allclose(np.diff(route.arc_m), steps_m)
        assert len(route.edge_index) == len(route.points_W_m) == len(route.arc_m)
        lengths_m.append(route.arc_m[-1])
        for point, index in zip(route.points_W_m[:-1], route.edge_index[:-1], strict=True):
            edge = manhattan.walk.edges[index]
            assert shapely.LineString(edge.points_W_m).distance(shapely.Point(point)) < 1e-6
    assert np.mean((np.array(lengths_m) >= 40.0) & (np.array(lengths_m) <= 260.0)) > 0.8


def over_a_crossing(street: Street, share: float) -> int:
    """How many of 40 drawn routes lead over a crossing within the first 80 m."""
    router, rng, found = Router(street.walk), make_rng(3, "share"), 0
    for _ in range(40):
        start, _ = router.random_start(rng)
        items = find_route_crossings(
            router.route(start, router.random_goal(rng, start, 60.0, 400.0, share)), street.walk
        )
        found += bool(items) and items[0].start_m <= 81.0
    return found


@pytest.mark.parametrize("name", [pytest.param("monaco", marks=pytest.mark.proof), "manhattan"])
def test_a_share_of_the_routes_leads_over_a_crossing_nearby(name: str, request: pytest.FixtureRequest) -> None:
    street = request.getfixturevalue(name) if name == "manhattan" else load_street(find_town(name))
    before, after = over_a_crossing(street, 0.0), over_a_crossing(street, 1.0)
    assert after >= before + 4, (before, after)


def test_without_a_crossing_in_reach_any_destination_is_taken() -> None:
    nodes = np.array([[0.0, 0.0], [300.0, 0.0]])
    line = WalkEdge(sumo_id=":w", start=0, end=1, points_W_m=nodes, kind=WayKind.SIDEWALK, width_m=2.0)
    router = Router(WalkGraph(nodes_W_m=nodes, edges=(line,)))
    x, y = router.random_goal(make_rng(1, "goal"), (10.0, 0.0), 60.0, 200.0, 1.0)
    assert 0.0 < x < 300.0 and y == 0.0


def test_no_share_draws_as_if_there_were_none(manhattan: Street) -> None:
    router = Router(manhattan.walk)
    start, _ = router.random_start(make_rng(4, "test"))
    plain, none = make_rng(4, "goal"), make_rng(4, "goal")
    assert router.random_goal(plain, start, 60.0, 400.0) == router.random_goal(none, start, 60.0, 400.0, 0.0)
    assert plain.random() == none.random()


HOLES = st.lists(st.tuples(st.floats(1, 9), st.floats(1, 9), st.floats(0.3, 2)), max_size=4)


@settings(max_examples=40)
@given(HOLES, st.floats(0.1, 9.9), st.floats(0.1, 9.9))
def test_shortest_way_stays_inside_and_is_not_shorter_than_straight(
    holes: list[tuple[float, float, float]], y0: float, y1: float
) -> None:
    blocks = [box(x - r, y - r, x + r, y + r) for x, y, r in holes] or [Polygon()]
    area = box(0, 0, 10, 10).difference(shapely.union_all(blocks))
    start, goal = np.array([0.05, y0]), np.array([9.95, y1])
    if not (area.covers(shapely.Point(start)) and area.covers(shapely.Point(goal))):
        return
    way = shortest_inside(area, start, goal)
    same_part = any(part.covers(shapely.MultiPoint([start, goal])) for part in shapely.get_parts(area))
    assert (way is not None) == same_part
    if way is not None:
        line = shapely.LineString(way)
        assert np.allclose(way[[0, -1]], [start, goal])
        assert line.difference(area.buffer(0.001)).length < 1e-9
        assert line.length >= np.linalg.norm(goal - start) - 1e-9
