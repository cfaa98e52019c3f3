from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shapely import Polygon, box

from tests.towns.furniture.standing_samples import authored
from wcsim.errors import TownError
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.furniture.buildings import make_buildings
from wcsim.towns.furniture.everything import author_things, place_furniture
from wcsim.towns.furniture.models import LOOKS
from wcsim.towns.furniture.placement import FreeGround, StandingObject
from wcsim.towns.importing.folder_texts import sumocfg_text
from wcsim.towns.scenario.town import Town, open_town
from wcsim.towns.sumo.additional import AUTHOR_KINDS, Item, read_items
from wcsim.towns.sumo.net import Net, read_net
from wcsim.types import ClassId

TOWN = shapely.box(-100, -100, 100, 100)


def things_in(items: list[Item]) -> list[StandingObject]:
    return author_things(items, TOWN)


def write(folder: Path, body: str) -> tuple[Path, ...]:
    path = folder / "my.add.xml"
    path.write_text(f"<additional>{body}</additional>")
    return (path,)


@pytest.fixture(scope="module")
def corner_net(corner_town: Town) -> Net:
    return read_net(corner_town.net)


def with_things(town: Town, folder: Path, body: str) -> Town:
    """The same town with an additional file."""
    write(folder, body)
    for path in (town.net, *town.routes, town.folder / "town.toml"):
        (folder / path.name).write_bytes(path.read_bytes())
    text = sumocfg_text("t", 1, town.routes[0].name, ("my.add.xml",)).replace("t.net.xml.gz", town.net.name)
    (folder / "t.sumocfg").write_text(text)
    return open_town(folder / "t.sumocfg")


@pytest.mark.parametrize("kind", AUTHOR_KINDS)
def test_a_point_stands_exactly_where_it_was_put(kind: str) -> None:
    (thing,) = things_in([authored(kind, (3.25, 4.5))])
    assert thing.footprint.centroid.distance(shapely.Point(3.25, 4.5)) < 1e-9
    length_m, width_m, _ = LOOKS[kind].size_lwh_m
    x0, y0, x1, y1 = thing.footprint.bounds
    assert (x1 - x0, y1 - y0) == pytest.approx((width_m, length_m), abs=0.01)  # angle 0: its long side points north


def test_size_and_angle_are_the_author_s() -> None:
    (thing,) = things_in([authored("block", (0, 0), length="3", width="0.5", height="1.25", angle="90")])
    assert thing.footprint.bounds == pytest.approx((-1.5, -0.25, 1.5, 0.25))
    assert thing.piece.vertices_W_m[:, 2].max() == pytest.approx(1.25)
    (bench,) = things_in([authored("bench", (0, 0), angle="90")])
    back = bench.piece.vertices_W_m[bench.piece.vertices_W_m[:, 2] > 0.8]
    assert back[:, 1].mean() < -0.1  # it looks to the left of its angle: north


def test_outlines_are_solid_as_drawn_and_lines_as_thick_as_said() -> None:
    ring = ((0, 0), (4, 0), (4, 1), (2, 3), (0, 1), (0, 0))
    (planter,) = things_in([authored("planter", *ring, filled=True, height="0.7")])
    assert planter.footprint.symmetric_difference(Polygon(ring)).area < 1e-9
    (wall,) = things_in([authored("wall", (0, 0), (5, 0), (5, 5), width="0.4")])
    assert wall.footprint.area == pytest.approx(0.4 * 10, rel=0.03)
    assert wall.piece.vertices_W_m[:, 2].max() == pytest.approx(LOOKS["wall"].size_lwh_m[2])


def test_roadworks_fence_their_outline_from_inside_and_leave_what_the_author_left() -> None:
    ring = ((0, 0), (6, 0), (6, 1.4), (0, 1.4), (0, 0))
    for filled in (True, False):
        (works,) = things_in([authored("roadworks", *ring, filled=filled)])
        outline = Polygon(ring)
        assert works.footprint.symmetric_difference(outline).area < 1e-9
        xy = works.piece.vertices_W_m[:, :2]
        assert shapely.contains_xy(outline.buffer(0.01), *xy.T).all()
        assert works.piece.vertices_W_m[:, 2].max() == pytest.approx(1.0)
        assert {int(c) for c in np.unique(works.piece.face_class)} == {ClassId.FENCE, ClassId.DYNAMIC}
        low = works.piece.vertices_W_m[np.abs(works.piece.vertices_W_m[:, 2] - 0.1) < 1e-6]
        assert shapely.MultiPoint(low[:, :2]).convex_hull.area == pytest.approx(
            outline.area
        )  # all around, for canes and footplates
    (tiny,) = things_in([authored("roadworks", (0, 0), (0.1, 0), (0.1, 0.1), (0, 0), filled=True)])
    assert len(tiny.piece.faces) > 0


@pytest.mark.parametrize(
    "shape", ["0,0 4,0 0,2 4,2 0,0", "0,0 0,0 0,0 0,0", "0,0 1,0", "0,0 5,0 0,0", "0,0 1e-9,0 1e-9,1e-9 0,0"]
)
@pytest.mark.parametrize("fill", ["0", "1"])
def test_odd_outlines_are_no_error(tmp_path: Path, shape: str, fill: str) -> None:
    files = write(tmp_path, f'<poly id="p" type="wcsim.block" shape="{shape}" fill="{fill}"/>')
    for thing in author_things(read_items(files, (0, 0)), TOWN):
        assert thing.footprint.is_valid and np.isfinite(thing.piece.vertices_W_m).all()


def test_what_lies_outside_the_town_is_said_and_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert things_in([authored("bin", (5000, 0))]) == []
    assert "'mine' (wcsim.bin) lies outside" in caplog.text
    with pytest.raises(TownError, match="1e\\+09 m away"):
        read_items(write(tmp_path, '<poi id="p" type="wcsim.bin" x="1e9" y="0"/>'), (0, 0))


VALUES = st.sampled_from(
    ["", "0", "-1", "1e308", "nan", "x", "1", "7.5", "WC_0", "0,0 1,0 1,1", "0,0", ",", "true", "1e-300"]
)
KEYS = (
    "x",
    "y",
    "shape",
    "fill",
    "lane",
    "pos",
    "posLat",
    "angle",
    "width",
    "height",
    "startPos",
    "endPos",
    "geo",
    "lon",
)
USUAL = {"x": "7.5", "y": "1", "shape": "0,0 1,0 1,1", "startPos": "1"}
TAGS = st.sampled_from(["poi", "poly", "busStop", "trainStop"])
TYPES = st.sampled_from(
    ["wcsim.bench", "wcsim.roadworks", "natural.tree_row", "barrier.fence", "building.yes", "", "."]
)


@given(TAGS, TYPES, st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=9))
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_odd_attributes_are_said_or_harmless(
    corner_net: Net, tmp_path: Path, tag: str, kind: str, attributes: dict[str, str]
) -> None:
    text = " ".join(f'{key}="{value}"' for key, value in (USUAL | attributes).items())
    files = write(tmp_path, f'<{tag} id="p" type="{kind}" {text}/>')
    try:
        items = read_items(files, (0, 0), corner_net)
        placed = author_things(items, TOWN)
    except TownError as error:
        assert "my.add.xml" in str(error)
        return
    assert all(np.isfinite(thing.piece.vertices_W_m).all() for thing in placed)
    place = FreeGround(low=box(-3, -3, 3, 3), solids=Polygon(), lines=shapely.MultiLineString(), hull=TOWN)
    place_furniture(items, corner_net, (), place, placed)
    make_buildings(items, place.low, TOWN)


def test_an_unknown_kind_names_the_file_and_what_is_known(tmp_path: Path) -> None:
    files = write(tmp_path, '<poi id="p" type="wcsim.dragon" x="0" y="0"/>')
    with pytest.raises(TownError, match=r"my\.add\.xml.*wcsim\.dragon.*wcsim\.roadworks"):
        read_items(files, (0, 0))


@pytest.mark.parametrize("key, value", [("height", "tall"), ("length", "0"), ("width", "1e9"), ("angle", "nan")])
def test_a_size_that_is_none_names_the_thing(key: str, value: str) -> None:
    with pytest.raises(TownError, match=rf"my\.add\.xml: {key} of 'mine' \(wcsim\.bench\)"):
        things_in([authored("bench", (0, 0), **{key: value})])


def test_a_point_on_a_lane_stands_beside_its_middle(corner_town: Town, tmp_path: Path) -> None:
    net = read_net(corner_town.net)
    lane = next(lane for edge in net.edges for lane in edge.lanes if lane.id == "WC_0")  # eastward
    body = (
        '<poi id="a" type="wcsim.bin" lane="WC_0" pos="10" posLat="0.5"/>'
        '<poi id="b" type="wcsim.bin" lane="WC_0" pos="-5"/>'
    )
    first, second = read_items(write(tmp_path, body), (0, 0), net)
    assert first.points_W_m[0] == pytest.approx(lane.points_m[0] + (10.0, 0.5), abs=0.05)
    assert second.points_W_m[0] == pytest.approx(lane.points_m[-1] - (5.0, 0.0), abs=0.05)


def test_what_cannot_be_placed_is_an_error_for_the_author_s_and_left_out_else(tmp_path: Path, caplog) -> None:
    for place in ('lane="no_0" pos="1"', 'lon="24.9" lat="60.1"', 'lane="no_0" pos="x"'):
        with pytest.raises(TownError, match=r"my\.add\.xml: <poi> 'p'"):
            read_items(write(tmp_path, f'<poi id="p" type="wcsim.bin" {place}/>'), (0, 0))
        assert read_items(write(tmp_path, f'<poi id="p" type="amenity.bench" {place}/>'), (0, 0)) == []
    assert "left out" in caplog.text
    with pytest.raises(TownError, match="'p' is broken"):
        read_items(write(tmp_path, '<poi id="p" type="amenity.bench" x="a" y="1"/>'), (0, 0))


def test_obstacles_stay_on_the_way_and_the_way_leads_around_them(corner_town: Town, tmp_path: Path) -> None:
    works = '<poly id="w" type="wcsim.roadworks" fill="1" shape="-20,-3.3 -14,-3.3 -14,-4.65 -20,-4.65 -20,-3.3"/>'
    cone = '<poi id="c" type="wcsim.cone" x="-30" y="-1.6"/><poi id="b" type="wcsim.bollard" x="-30" y="-4.5"/>'
    street = unpack_street(build_street(with_things(corner_town, tmp_path, works + cone)))
    assert street.grid.clearance_at(np.array([[-17.0, -4.0], [-30.0, -1.6], [-30.0, -4.5]])).max() < 0.15
    ways = shapely.MultiLineString([edge.points_W_m for edge in street.walk.edges])
    assert ways.distance(shapely.box(-20, -4.65, -14, -3.3)) >= 0.4
    assert ways.distance(shapely.Point(-30, -4.5)) >= 0.4
    beside = ways.intersection(shapely.box(-19, -7, -15, -3))
    assert beside.length > 3.9  # a wheelchair still gets by, on the 1.1 m that are left
    assert beside.bounds[1] > -5.75
