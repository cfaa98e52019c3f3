from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.towns.ground.rays import steepest
from tests.towns.made.nets import DRIVE, WALK, WAYS, assert_sound, edge, lane, write_net
from wcsim.towns.ground.kerb_heights import STEEPEST, Kerbing, make_kerbing
from wcsim.towns.ground.mesh import build_ground, kerb_walls
from wcsim.towns.ground.surfaces import make_surfaces
from wcsim.towns.osm.tags import kerb_marks
from wcsim.towns.sumo.additional import Item
from wcsim.towns.sumo.net import Net
from wcsim.towns.walking.graph import build_walk_graph, free_space
from wcsim.types import WayKind

TOP_M = 0.12


def mark(kerb: str, *places: tuple[float, float], group: str = "kerb", **more: str) -> Item:
    """A kerb as polyconvert writes it from OpenStreetMap."""
    tags = {"kerb": kerb, "barrier": "kerb"} | {key.replace("_", ":"): text for key, text in more.items()}
    detail = "kerb" if group == "barrier" else kerb
    return Item(id="k", kind="k", detail=detail, points_W_m=np.array(places), filled=False, tags=tags, group=group)


@pytest.fixture
def street(tmp_path: Path) -> Net:
    """A carriageway from y = -3.2 to 3.2 m with pavements on both sides and one crossing at x = 30 m."""
    return write_net(
        tmp_path,
        edge("s", lane("0,-4.7 60,-4.7", WALK, "3.0"), lane("0,-1.6 60,-1.6"), lane("0,1.6 60,1.6")),
        edge("t", lane("60,4.7 0,4.7", WALK, "3.0")),
        edge(":c", lane("30,-3.2 30,3.2", WALK, "4.0"), function="crossing"),
    )


def kerbs_at(net: Net, *items: Item, drop_m: float = 0.0) -> Kerbing:
    return make_kerbing(make_surfaces(net, WAYS), TOP_M, drop_m, kerb_marks(items))


def height_m(kerbing: Kerbing, *places: tuple[float, float]) -> list[float]:
    return [round(float(h), 3) for h in kerbing.height_m(np.array(places))]


SOUTH, NORTH, AWAY = (30.0, -3.2), (30.0, 3.2), (10.0, 3.2)


def test_kerbs_are_lowered_at_crossings_as_the_town_says(street: Net) -> None:
    assert height_m(kerbs_at(street), SOUTH, NORTH, AWAY) == [0.0, 0.0, TOP_M]
    assert height_m(kerbs_at(street, drop_m=0.03), SOUTH, NORTH, AWAY) == [0.03, 0.03, TOP_M]


@pytest.mark.parametrize("kerb, lip_m", [("flush", 0.0), ("lowered", 0.02), ("sloped", 0.03), ("raised", TOP_M)])
def test_a_mapped_kerb_at_a_crossing_counts_more(street: Net, kerb: str, lip_m: float) -> None:
    marked = kerbs_at(street, mark(kerb, (30.5, -2.4)), drop_m=0.01)
    assert height_m(marked, SOUTH, NORTH) == [lip_m, 0.01]


def test_the_nearest_mark_counts_and_a_raised_one_only_when_it_is_near_or_ahead(street: Net) -> None:
    both = (mark("raised", (30.0, -2.2)), mark("flush", (30.0, -2.9)))
    assert height_m(kerbs_at(street, *both, drop_m=0.01), SOUTH) == [0.0]
    assert height_m(kerbs_at(street, mark("raised", (30.0, -0.9))), SOUTH) == [TOP_M]
    assert height_m(kerbs_at(street, mark("raised", (34.0, -4.0))), SOUTH) == [0.0]
    assert height_m(kerbs_at(street, mark("lowered", (30.0, -0.9))), SOUTH) == [0.02]


def test_kerbs_of_a_crossing_are_at_both_its_ends_and_a_kerb_beside_it_counts_more(street: Net) -> None:
    raised = mark("raised", (30.0, 0.3), highway="crossing")
    assert height_m(kerbs_at(street, raised), SOUTH, NORTH) == [TOP_M, TOP_M]
    assert height_m(kerbs_at(street, raised, mark("flush", (30.0, 3.4))), SOUTH, NORTH) == [TOP_M, 0.0]


@pytest.mark.parametrize("told, lip_m", [("4 cm", 0.04), ("0.12", TOP_M), ("0.4 m", TOP_M), ("low", 0.02)])
def test_heights_of_kerbs_count_more_than_words(street: Net, told: str, lip_m: float) -> None:
    there = (30.0, -3.0)
    assert height_m(kerbs_at(street, mark("lowered", there, kerb_height=told)), SOUTH) == [lip_m]
    assert height_m(kerbs_at(street, mark("lowered", there, group="barrier", height=told)), SOUTH) == [lip_m]


@pytest.mark.parametrize("side, ways_m", [("kerb_left", (0.0, 60.0)), ("kerb_right", (60.0, 0.0))])
def test_the_side_of_a_street_has_its_kerb_and_crossings_their_own(
    street: Net, side: str, ways_m: tuple[float, float]
) -> None:
    line = [(x_m, 0.4) for x_m in ways_m]
    low = kerbs_at(street, mark("flush", *line, group=side), drop_m=0.03)
    assert height_m(low, NORTH, AWAY, SOUTH, (10.0, -3.2)) == [0.0, 0.0, 0.03, TOP_M]
    high = kerbs_at(street, mark("raised", *line, group=side))
    assert height_m(high, NORTH, SOUTH) == [TOP_M, 0.0]
    own = kerbs_at(street, mark("raised", *line, group=side), mark("lowered", (30.0, 0.3), highway="crossing"))
    assert height_m(own, NORTH, SOUTH) == [0.02, 0.02]


def test_kerbs_are_lowered_where_they_are_mapped_so_away_from_crossings(street: Net) -> None:
    point = kerbs_at(street, mark("lowered", (10.0, 2.4)))
    assert height_m(point, AWAY, (11.6, 3.2), (13.5, 3.2)) == [0.02, pytest.approx(0.09, abs=0.01), TOP_M]
    line = kerbs_at(street, mark("flush", (8.0, 4.0), (14.0, 4.0), group="barrier"))
    assert height_m(line, (8.0, 3.2), AWAY, (14.0, 3.2), (50.0, 3.2)) == [0.0, 0.0, 0.0, TOP_M]
    far = kerbs_at(street, mark("lowered", (10.0, 0.0)), mark("yes", (10.0, 3.2)))
    assert height_m(far, AWAY) == [TOP_M]


def test_what_is_mapped_twice_is_one_kerb(street: Net) -> None:
    once = kerbs_at(street, mark("lowered", (10.0, 2.4)))
    twice = kerbs_at(street, mark("lowered", (10.0, 2.4)), mark("lowered", (10.0, 2.4), group="barrier"))
    assert [len(low.tree) for low in once.lowered] == [len(low.tree) for low in twice.lowered] == [2, 1]


def test_ramps_are_never_steeper_than_one_in_twelve_where_they_meet(street: Net) -> None:
    marks = [mark("flush", (x, 3.2)) for x in (26.0, 34.5, 36.4)] + [mark("lowered", (27.3, 3.3), (24.0, 3.3))]
    surfaces = make_surfaces(street, WAYS)
    ground = build_ground(surfaces, make_kerbing(surfaces, TOP_M, 0.0, kerb_marks(marks)))
    high = ground.vertices_W_m[ground.faces[~ground.low]]
    assert steepest(high) <= 1.02 * STEEPEST


@pytest.mark.parametrize("width", [1.6, 4.0])
def test_a_wheelchair_passes_a_traffic_island(width: float, tmp_path: Path) -> None:
    top = 3.2 + width
    links = "".join(
        f'<connection from="{a}" to="{b}" fromLane="0" toLane="0"/>'
        for a, b in (("s", ":w0"), (":w0", ":c0"), (":c0", ":w1"), (":w1", ":c1"), (":c1", ":w2"), (":w2", "t"))
    )

    def area(name: str, low: float, high: float) -> str:
        return edge(name, lane(f"27,{low} 33,{low} 33,{high} 27,{high}", WALK, "4.0"), function="walkingarea")

    net = write_net(
        tmp_path,
        edge("s", lane("0,-4.7 27,-4.7", WALK, "3.0"), lane("0,0 60,0", DRIVE, "6.4")),
        edge(
            "t",
            lane(f"33,{top + 7.9} 60,{top + 7.9}", WALK, "3.0"),
            lane(f"60,{top + 3.2} 0,{top + 3.2}", DRIVE, "6.4"),
        ),
        edge(":c0", lane("30,-3.2 30,3.2", WALK, "4.0"), function="crossing"),
        edge(":c1", lane(f"30,{top} 30,{top + 6.4}", WALK, "4.0"), function="crossing"),
        area(":w0", -6.2, -3.2),
        area(":w1", 3.2, top),
        area(":w2", top + 6.4, top + 9.4),
        links,
    )
    assert_sound(net)
    surfaces = make_surfaces(net, WAYS)
    walls = kerb_walls(build_ground(surfaces, make_kerbing(surfaces, TOP_M, 0.0)))[0]
    kerbs = shapely.union_all(shapely.linestrings(walls[walls[:, :, 2].max(axis=1) > 0.031][:, :2, :2]))
    space = free_space(shapely.union_all([surfaces.pavement, surfaces.crossing]), kerbs, shapely.Polygon())
    walk = build_walk_graph(net, space, WAYS)
    assert {way.sumo_id for way in walk.edges if way.kind is not WayKind.WALKINGAREA} == {
        "s_0",
        ":c0_0",
        ":c1_0",
        "t_0",
    }
