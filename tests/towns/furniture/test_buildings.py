from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import Polygon, box

from tests.towns.furniture.standing_samples import item
from wcsim.towns.furniture.buildings import PASSAGE_M, Building, make_buildings
from wcsim.towns.osm.clean import _mark_buildings, filter_osm
from wcsim.towns.sumo.additional import Item, read_items
from wcsim.towns.sumo.tools import run_tool
from wcsim.towns.sumo.xml_io import parse_root

HULL = box(-200, -200, 200, 200)
NO_STREET = Polygon()


def block(x0: float, y0: float, x1: float, y1: float, kind: str = "building.yes", **tags: str) -> Item:
    corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0))
    return item(kind, *corners, filled=True, **{key.replace("__", ":"): value for key, value in tags.items()})


def standing(*items: Item, street: Polygon = NO_STREET) -> list[Building]:
    return make_buildings(list(items), street, HULL)[0]


def ground(buildings: list[Building]) -> shapely.Geometry:
    return shapely.union_all([building.outline for building in buildings])


@pytest.mark.parametrize(
    "tags, height_m",
    [
        ({"height": "21.5 m"}, 21.5),
        ({"height": "70 ft"}, 21.336),
        ({"height": "12;15"}, 15.0),
        ({"building__levels": "5"}, 17.0),
        ({"building__levels": "3", "roof__levels": "1"}, 13.8),
        ({"building__levels": "3", "roof__height": "2.4"}, 13.0),
        ({"building__levels": "5;6"}, 20.2),
    ],
)
def test_heights_come_from_tags(tags: dict[str, str], height_m: float) -> None:
    (found,) = standing(block(0, 0, 20, 20, **tags))
    assert found.height_m == pytest.approx(height_m)


@pytest.mark.parametrize("tags", [{}, {"height": "high"}, {"height": "-4"}, {"building__levels": "1e9"}])
def test_without_a_usable_tag_the_height_is_seeded_by_size_and_kind(tags: dict[str, str]) -> None:
    (large,), (small,) = standing(block(0, 0, 20, 20, **tags)), standing(block(0, 0, 4, 4, **tags))
    (garage,) = standing(block(0, 0, 20, 20, "building.garages", **tags))
    assert 9.0 <= large.height_m <= 18.0 and 2.6 <= small.height_m <= 3.4 and 2.6 <= garage.height_m <= 3.4
    assert standing(block(0, 0, 20, 20, **tags)) == [large]


def test_buildings_keep_off_the_street() -> None:
    street = box(-5, -5, 20, 2)
    (found,) = standing(block(0, 0, 10, 10), street=street)
    assert found.outline.distance(street) >= 0.09
    assert standing(block(0, 0, 10, 1.9), street=street) == []


def test_what_is_mapped_twice_stands_once() -> None:
    found = standing(block(0, 0, 10, 10), block(0, 0, 10, 10), block(5, 0, 15, 10), block(1, 1, 4, 4))
    assert sum(b.outline.area for b in found) == pytest.approx(150, rel=0.02)
    assert ground(found).area == pytest.approx(sum(b.outline.area for b in found))


def test_courtyards_stay_open_and_houses_in_them_stand() -> None:
    found = standing(
        block(0, 0, 40, 40), block(10, 10, 30, 30, "building.courtyard", height="12"), block(15, 15, 20, 20)
    )
    assert len(found) == 2
    assert ground(found).area == pytest.approx(1600 - 400 + 25, rel=0.01)
    assert not ground(found).intersects(shapely.Point(27, 27))


def test_parts_take_the_place_of_their_building_without_double_walls() -> None:
    whole = block(0, 0, 40, 20, height="30")
    left, right = block(0, 0, 20, 20, "building.part", height="30"), block(20, 0, 40, 20, "building.part", height="8")
    found = standing(whole, left, right)
    assert sorted(b.height_m for b in found) == [8.0, 30.0]
    assert sum(b.outline.area for b in found) == pytest.approx(800, rel=0.02)
    one = standing(whole, right)
    assert sorted((b.height_m, round(b.outline.area, -1)) for b in one) == [(8.0, 400.0), (30.0, 400.0)]


def test_a_tower_on_its_base_hangs_over_what_is_below() -> None:
    base = block(0, 0, 40, 40, "building.part", building__levels="3")
    tower = block(10, 10, 20, 20, "building.part", building__levels="20", building__min_level="3")
    low, high = make_buildings([block(0, 0, 40, 40), base, tower], NO_STREET, HULL)
    assert ground(low).area == pytest.approx(1600, rel=0.01) and low[0].height_m == pytest.approx(10.6)
    (above,) = high
    assert (above.low_m, above.height_m) == (pytest.approx(9.6), pytest.approx(65.0))


def test_below_a_raised_part_people_pass() -> None:
    grounded = block(0, 0, 40, 30, "building.part", height="20")
    arcade = block(0, 30, 40, 36, "building.part", height="20", min_height="4")
    low, high = make_buildings([block(0, 0, 40, 36), grounded, arcade], NO_STREET, HULL)
    assert ground(low).distance(shapely.Point(20, 33)) > 2.5
    assert [b.low_m for b in high] == [4.0]


def test_no_floor_hangs_in_the_air_where_a_map_leaves_out_those_below() -> None:
    top = block(1, 1, 39, 39, "building.part", building__levels="9", building__min_level="6")
    low, high = make_buildings([block(0, 0, 40, 40, height="30"), top], NO_STREET, HULL)
    assert ground(low).area == pytest.approx(1600, rel=0.01) and low[0].height_m == pytest.approx(19.2)
    assert [b.low_m for b in high] == [pytest.approx(19.2)]
    foot = block(0, 0, 40, 40, "building.part", building__levels="2")
    low, high = make_buildings([block(0, 0, 40, 40), foot, top], NO_STREET, HULL)
    assert [b.low_m for b in high] == [low[0].height_m]


@pytest.mark.parametrize(
    "tags", [{"layer": "-1"}, {"location": "underground"}, {"building__levels": "-2"}], ids=lambda tags: str(tags)
)
def test_what_lies_under_ground_is_not_there(tags: dict[str, str]) -> None:
    assert make_buildings([block(0, 0, 20, 20, **tags)], NO_STREET, HULL) == ([], [])


@pytest.mark.parametrize("kind", ["building.roof", "building.carport", "building.entrance", "building.no"])
def test_roofs_on_posts_have_no_walls(kind: str) -> None:
    assert make_buildings([block(0, 0, 20, 20, kind)], NO_STREET, HULL) == ([], [])


def test_a_skywalk_hangs_over_the_street_and_stands_on_nothing() -> None:
    street = box(-100, 5, 100, 15)
    for walk in (block(0, 0, 4, 20, "building.bridge"), block(0, 0, 4, 20, min_height="5", height="9")):
        low, high = make_buildings([walk], street, HULL)
        assert low == []
        assert min(b.low_m for b in high) >= PASSAGE_M
        assert ground(high).intersects(shapely.Point(2, 10))


def test_a_house_spans_the_passage_through_it_but_not_the_pavement_in_front() -> None:
    house = block(0, 0, 30, 12, height="15")
    passage = box(12, -20, 17, 40)
    low, high = make_buildings([house], passage, HULL)
    assert len(low) == 2 and len(high) == 1
    assert (high[0].low_m, high[0].height_m) == (PASSAGE_M, 15.0)
    assert high[0].outline.buffer(0.02).covers(box(12, 0, 17, 12))
    in_front = box(-50, -5, 50, 2.5)
    low, high = make_buildings([house], in_front, HULL)
    assert len(low) == 1 and high == []
    assert make_buildings([block(0, 0, 30, 12, height="4")], passage, HULL)[1] == []


POINT = st.tuples(st.integers(-20, 20), st.integers(-20, 20))
KINDS = st.sampled_from(["building.yes", "building.part", "building.courtyard", "building.bridge"])


@given(
    st.lists(
        st.tuples(KINDS, st.lists(POINT, min_size=4, max_size=7), st.sampled_from(["", "3", "-1", "x"])), max_size=5
    )
)
@settings(max_examples=60)
def test_odd_outlines_never_crash_and_never_overlap(drawn: list[tuple[str, list[tuple[int, int]], str]]) -> None:
    items = [item(kind, *points, filled=True, min_height=text) for kind, points, text in drawn]
    street = box(-30, -2, 30, 2)
    low, high = make_buildings(items, street, HULL)
    total = sum(b.outline.area for b in low)
    # Outlines are thinned by up to 0.1 m after they were parted.
    assert ground(low).area == pytest.approx(total, abs=0.5)
    for b in (*low, *high):
        assert b.outline.is_valid and b.outline.area > 0 and b.height_m > b.low_m and np.isfinite(b.height_m)
    assert not any(b.outline.intersects(street) for b in low)


OSM = """<osm>
  <way id="1"><tag k="building" v="yes"/></way>
  <way id="2"/>
  <way id="3"><tag k="building" v="garage"/></way>
  <way id="4"><tag k="building:part" v="yes"/></way>
  <way id="5"><tag k="leisure" v="garden"/></way>
  <relation id="6"><member type="way" ref="1" role="outer"/><member type="way" ref="2" role="inner"/>
    <member type="way" ref="3" role="inner"/><member type="way" ref="99" role="inner"/>
    <tag k="type" v="multipolygon"/><tag k="building" v="yes"/></relation>
  <relation id="7"><member type="way" ref="1" role="outer"/><member type="way" ref="5" role="inner"/>
    <tag k="type" v="multipolygon"/></relation>
  <relation id="8"><member type="way" ref="1" role="outline"/><member type="way" ref="4" role="part"/>
    <tag k="type" v="building"/><tag k="building" v="yes"/></relation>
</osm>"""


def test_courtyards_and_parts_are_said_in_tags_that_polyconvert_keeps() -> None:
    root = parse_root(OSM.encode(), "test")
    _mark_buildings(root)

    def building(element_id: str) -> str | None:
        found = next(element for element in root if element.get("id") == element_id)
        return next((tag.get("v") for tag in found.iterfind("tag") if tag.get("k") == "building"), None)

    assert [building(key) for key in "12345"] == ["yes", "courtyard", "garage", "part", "courtyard"]
    assert (building("6"), building("8")) == ("yes", None)


def nodes_of(*corners: tuple[int, float, float]) -> str:
    return "".join(f'<node id="{n}" lat="{60 + y / 1e4}" lon="{24 + x / 1e4}"/>' for n, x, y in corners)


def predict_path(number: int, *refs: int, **tags: str) -> str:
    inner = "".join(f'<nd ref="{ref}"/>' for ref in refs) + "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
    return f'<way id="{number}">{inner}</way>'


def test_a_courtyard_and_a_part_come_through_polyconvert(tmp_path: Path) -> None:
    ring, yard = ((11, 5, 3), (12, 15, 3), (13, 15, 9), (14, 5, 9)), ((21, 8, 5), (22, 12, 5), (23, 12, 7), (24, 8, 7))
    ways = (
        predict_path(100, 1, 2, highway="residential")
        + predict_path(101, 11, 12, 13, 14, 11)
        + predict_path(102, 21, 22, 23, 24, 21)
    )
    part = predict_path(103, 11, 12, 22, 21, 11, **{"building:part": "yes", "height": "5"})
    members = '<member type="way" ref="101" role="outer"/><member type="way" ref="102" role="inner"/>'
    tags = '<tag k="type" v="multipolygon"/><tag k="building" v="yes"/><tag k="height" v="12"/>'
    nodes = nodes_of((1, 0, 0), (2, 40, 0), *ring, *yard)
    text = f'<osm version="0.6">{nodes}{ways}{part}<relation id="7">{members}{tags}</relation></osm>'
    root = parse_root(text.encode(), "test")
    filter_osm(root)
    (tmp_path / "a.osm.xml").write_bytes(ElementTree.tostring(root))
    types = Path(__file__).parents[3] / "wcsim" / "towns" / "importing" / "polytypes.xml"
    assert (
        run_tool("netconvert", ["--osm-files", "a.osm.xml", "-o", "a.net.xml", "--proj.utm"], tmp_path).returncode == 0
    )
    poly = ["--osm-files", "a.osm.xml", "--net-file", "a.net.xml", "--type-file", str(types), "-o", "a.poly.xml"]
    keep = ["--osm.keep-full-type", "--osm.merge-relations", "1", "--all-attributes", "--discard"]
    assert run_tool("polyconvert", [*poly, *keep], tmp_path).returncode == 0
    low, high = make_buildings(read_items((tmp_path / "a.poly.xml",), (0, 0)), NO_STREET, box(-1e3, -1e3, 1e3, 1e3))
    (whole,) = (b for b in low if b.height_m == 12.0)
    (front,) = (b for b in low if b.height_m == 5.0)
    hole = whole.outline.union(front.outline.buffer(0.05)).convex_hull.area - ground(low).area
    assert high == [] and hole == pytest.approx(22.3 * 22.3, rel=0.05)
