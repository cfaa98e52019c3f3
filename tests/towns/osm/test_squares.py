"""Squares of a map are ground for people and chairs, with ways between their entries."""

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely import LineString, Point, Polygon

from tests.support.worlds import open_world, push
from tests.towns.conftest import run_in_sumo
from tests.towns.furniture.standing_samples import item
from tests.towns.made.imported import imported
from tests.towns.made.nets import WAYS, edge, lane, street, write_net
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.ground.surfaces import covered, make_surfaces
from wcsim.towns.importing.importer import _Imported
from wcsim.towns.osm.squares import cross_squares
from wcsim.towns.sumo.additional import read_items
from wcsim.towns.sumo.net import read_net
from wcsim.towns.sumo.xml_io import parse_root, read_root
from wcsim.towns.walking.routes import Router
from wcsim.types import ClassId, Joystick, SeatSpec, StartSpec

MAP = Path(__file__).with_name("squares.osm").read_text(encoding="utf-8")
PLAZA = '<tag k="highway" v="pedestrian"/><tag k="area" v="yes"/><tag k="name" v="Plaza"/>'
M_PER_DEG = 111_320.0


def cross(text: str) -> tuple[set[str], list[LineString], list[Polygon]]:
    """The squares that new ways lead over, these ways, in metres, and the outlines of all squares."""
    root = parse_root(text.encode(), "a map")
    before = {way.get("id") for way in root.iter("way")}
    names = cross_squares(root, keep_service=False)
    places = {
        node.get("id"): ((float(node.attrib["lon"]) - 25) * M_PER_DEG / 2, (float(node.attrib["lat"]) - 60) * M_PER_DEG)
        for node in root.iter("node")
    }
    lines: dict[str, list[LineString]] = {"footway": [], "square": []}
    for way in root.iter("way"):
        if way.get("id") not in before:
            lines[way[-1].attrib["v"]].append(LineString([places[nd.get("ref")] for nd in way.iter("nd")]))
    return names, lines["footway"], [Polygon(line) for line in lines["square"]]


def test_ways_join_the_entries_of_a_square_and_keep_off_holes_and_houses() -> None:
    names, lines, outlines = cross(MAP)
    assert names == {"200", "relation 7", "203"}, "no way touches 201"
    assert sorted(round(area.area) for area in outlines) == [900, 1600, 3200, 3600], "a slit leads to the hole"
    ways = shapely.union_all(lines)
    house, hole = shapely.box(58, 24, 66, 32), shapely.box(40, 140, 60, 160)
    assert shapely.union_all(outlines).buffer(0.6).covers(ways) and ways.distance(house.union(hole)) > 0.6
    parts = shapely.get_parts(ways.buffer(0.1))
    for entries in ((20, 20), (80, 80)), ((20, 120), (80, 180)), ((130, 130), (150, 150)):  # and the yard's middle
        assert any(part.dwithin(shapely.points(entries), 2.0).all() for part in parts), entries


@pytest.mark.parametrize(
    ("tags", "known"),
    [
        ("highway=footway area=yes", True),
        ("area:highway=pedestrian", True),
        ("place=square", True),
        ("highway=pedestrian", False),  # a way around
        ("highway=pedestrian area=yes foot=no", False),
        ("highway=pedestrian area=yes access=private", False),
        ("highway=pedestrian area=yes layer=1", False),
        ("highway=service area=yes", False),
    ],
)
def test_what_a_square_is(tags: str, known: bool) -> None:
    text = "".join('<tag k="{}" v="{}"/>'.format(*tag.split("=")) for tag in tags.split())
    assert ("200" in cross(MAP.replace(PLAZA, text))[0]) is known


@pytest.mark.parametrize("tag", ['k="highway" v="tertiary"', 'k="railway" v="tram"'])
def test_no_way_crosses_a_street_between_its_junctions(tag: str) -> None:
    road = f'<way id="400"><nd ref="10"/><nd ref="12"/><tag {tag}/></way><relation'
    _, lines, _ = cross(MAP.replace("<relation", road))
    assert not shapely.crosses(LineString([(79, 21), (21, 79)]), lines).any()


def test_squares_side_by_side_are_one() -> None:
    beside = '<nd ref="22"/><nd ref="23"/><nd ref="15"/><nd ref="22"/><tag k="place" v="square"/>'
    assert "401" in cross(MAP.replace("<relation", f'<way id="401">{beside}</way><relation'))[0], "no way touches it"


def test_a_square_covers_a_cycle_path_but_no_street_nor_a_lawn_and_lies_in_a_park(tmp_path: Path) -> None:
    net = write_net(tmp_path, street(), edge("path", lane("0,-9 60,-9", 'allow="bicycle"', "2.0")))
    square, lawn, park = shapely.box([10, 12, 5], [-14, -13, -20], [20, 16, 21], [1, -11, 1])
    kinds = {"place.square": square, "landuse.grass": lawn, "leisure.park": park}
    bare = make_surfaces(net, WAYS)
    full = covered(bare, [item(kind, *area.exterior.coords) for kind, area in kinds.items()], net)
    flat = shapely.box(10, -14, 20, -1.6).difference(lawn)
    assert full.pavement.symmetric_difference(bare.pavement.union(flat)).area < 0.5
    assert full.low.area == pytest.approx(bare.low.area - 20.0, abs=0.5)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> _Imported:
    return imported(MAP, tmp_path_factory.mktemp("squares"))


@pytest.fixture(scope="module")
def areas(made: _Imported) -> list[Polygon]:
    """The house, and the squares from small to large, in W."""
    town = made.town
    items = read_items(town.additional, town.file.origin_m, read_net(town.net, town.file.origin_m))
    found = [Polygon(each.points_W_m) for each in items if each.kind in ("square", "building")]
    return sorted(found, key=shapely.area)


def test_squares_are_flat_pavement_and_routes_lead_over_them(made: _Imported, areas: list[Polygon]) -> None:
    assert [each.id for each in made.left_out.footways] == ["201"], "no way leads there"
    built = unpack_street(build_street(made.town))
    house, lone, yard, ring, plaza = areas
    assert (built.grid.clearance_at(np.array(house.centroid.coords)) == 0.0).all()
    for area in (lone, yard, ring, plaza):
        x, y = np.meshgrid(*(np.arange(low, low + 65.0, 0.5) for low in area.bounds[:2]))
        inside = np.stack([x, y], axis=-1)[shapely.contains_xy(area.buffer(-0.3), x, y)]
        assert set(built.grid.class_at(inside)) == {ClassId.SIDEWALK} and np.ptp(built.grid.raised_at(inside)) == 0.0
    router = Router(built.walk)
    for area in (ring, plaza):
        west, south, east, north = area.bounds
        route = LineString(router.route((west - 15.0, south - 15.0), (east + 15.0, north + 15.0)).points_W_m)
        assert route.intersection(area).length > 60.0 and route.length < 160.0
    assert router.away_m(yard.centroid.coords[0]) < 2.0 < 10.0 < router.away_m(lone.centroid.coords[0])


def test_a_chair_drives_over_the_middle_of_a_square(made: _Imported, areas: list[Polygon]) -> None:
    west, south, _, _ = areas[-1].bounds
    start = StartSpec(p_W_m=(west + 8.0, south + 8.0), yaw_rad=math.pi / 4, goal_W_m=areas[-1].centroid.coords[0])
    with open_world(made.town.folder, spec=SeatSpec(start=start)) as world:
        for _ in range(200):
            client = push(world, Joystick(0.0, 1.0))
            assert client.first is None, client.events
    place = client.plant.p_WB_m[:2]
    assert areas[-1].contains(Point(place)) and math.dist(place, start.p_W_m) > 25.0


def test_people_walk_over_a_square(made: _Imported, areas: list[Polygon], tmp_path: Path) -> None:
    steps = tmp_path / "steps.xml"
    run_in_sumo(made.town.sumocfg, 1800, tmp_path, "--fcd-output", str(steps), "--device.fcd.period", "10")
    people = np.array([(each.get("x"), each.get("y")) for each in read_root(steps).iter("person")], dtype=float)
    assert shapely.contains_xy(areas[-1].buffer(-10.0), people - made.town.file.origin_m).any()
