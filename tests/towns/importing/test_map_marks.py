import re
from pathlib import Path

import pytest
import shapely

from tests.cli.towns import tiny_osm
from tests.towns.conftest import run_in_sumo
from tests.towns.furniture.standing_samples import item
from tests.towns.made.imported import imported
from tests.towns.made.nets import street, write_net
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.furniture.road_marks import unmarked_crossings
from wcsim.towns.ground.surfaces import covered, lane_area, make_surfaces
from wcsim.towns.importing.importer import _Imported
from wcsim.towns.importing.map_marks import _unpainted
from wcsim.towns.sumo.additional import read_items
from wcsim.towns.sumo.net import LaneKind, read_net
from wcsim.towns.sumo.xml_io import parse_root
from wcsim.types import ClassId, Street

_NODE = '<node id="{}" lat="{}" lon="{}" version="1">{}</node>'
_TAG = '<tag k="{}" v="{}"/>'
_CROSSINGS = (  # on the first street, at its crossroads
    (701, 25.0017, {"highway": "crossing", "crossing": "zebra"}),
    (702, 25.0034, {"highway": "crossing", "crossing": "unmarked"}),
)
_SQUARE = ((711, 60.0011, 25.0003), (712, 60.0011, 25.0006), (713, 60.0014, 25.0006), (714, 60.0014, 25.0003))
_PARKING = ((721, 60.0011, 25.0022), (722, 60.0011, 25.0028), (723, 60.0014, 25.0028), (724, 60.0014, 25.0022))


def tagged(tags: dict[str, str]) -> str:
    return "".join(_TAG.format(*tag) for tag in tags.items())


def marked_osm() -> str:
    """The tiny map with two crossings, a bus stop, a square and a car park."""
    text = tiny_osm()
    for number, lon, tags in _CROSSINGS:
        text = text.replace("</osm>", _NODE.format(number, "60.000000", lon, tagged(tags)) + "</osm>")
    text = text.replace(
        '<nd ref="1"/><nd ref="2"/><nd ref="3"/>',
        '<nd ref="1"/><nd ref="701"/><nd ref="2"/><nd ref="702"/><nd ref="3"/>',
    )
    stop = _NODE.format(731, "60.00086", "25.0009", tagged({"highway": "bus_stop", "name": "A &amp; B"}))
    stop += _NODE.format(732, "60.00086", "25.0027", tagged({"highway": "bus_stop"}))
    square = {"place": "square", "landuse": "retail"}
    for number, (outline, tags) in enumerate(((_SQUARE, square), (_PARKING, {"amenity": "parking"}))):
        stop += "".join(_NODE.format(*corner, "") for corner in outline)
        refs = "".join(f'<nd ref="{corner[0]}"/>' for corner in (*outline, outline[0]))
        stop += f'<way id="{800 + number}" version="1">{refs}{tagged(tags)}</way>'
    return text.replace("</osm>", stop + "</osm>")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> _Imported:
    return imported(marked_osm(), tmp_path_factory.mktemp("marked"))


@pytest.fixture(scope="module")
def built(made: _Imported) -> Street:
    return unpack_street(build_street(made.town))


def test_crossings_that_are_guessed_or_unmarked_have_no_paint(made: _Imported, built: Street) -> None:
    town = made.town
    net = read_net(town.net, town.file.origin_m)
    lanes = net.lanes(LaneKind.CROSSING)
    plain = unmarked_crossings(read_items(town.additional, town.file.origin_m, net), net)
    assert made.counts["crossings_mapped"] == 2 and len(plain) == made.counts["crossings_unpainted"] == len(lanes) - 1
    for lane in lanes:
        middle = lane_area(lane).centroid
        found = ClassId(built.grid.class_here(middle.x, middle.y))
        assert found is (ClassId.ROAD if lane.edge_id in plain else ClassId.CROSSWALK), lane.edge_id
    ends = [lane.points_m[end] for lane in lanes if lane.edge_id in plain for end in (0, -1)]
    assert all(built.grid.raised_at(end) < 0.05 for end in ends)  # their kerbs are lowered all the same


def test_bus_stops_of_the_map_are_sumos(made: _Imported, tmp_path: Path) -> None:
    text = made.town.additional[0].read_text()
    (lane,) = re.findall(r'<busStop id="stop.731" name="A &amp; B" lane="([^"]+)"', text)
    assert made.counts["stops"] == made.counts["stops_mapped"] == 2
    net = read_net(made.town.net)
    assert next(each for edge in net.edges for each in edge.lanes if each.id == lane).permits("bus")
    run_in_sumo(made.town.sumocfg, 5, tmp_path)


def test_squares_are_pavement_and_car_parks_and_the_ground_of_houses_paved(made: _Imported, built: Street) -> None:
    town = made.town
    net = read_net(town.net, town.file.origin_m)
    items = read_items(town.additional, town.file.origin_m, net)
    surfaces = covered(make_surfaces(net, town.file.chair_ways), items, net)
    house = next(item for item in items if item.group == "building")
    square = next(item for item in items if item.kind == "square")
    places = {ClassId.SIDEWALK: [square.points_W_m.mean(axis=0)], ClassId.GROUND: [house.points_W_m[0] + 2.0]}
    places[ClassId.PARKING] = [next(item for item in items if item.kind == "parking").points_W_m.mean(axis=0)]
    for class_id, points_m in places.items():
        assert all(built.grid.class_here(*at_m) == class_id for at_m in points_m), class_id
    assert surfaces.paved.intersection(surfaces.low).area < 0.5 and surfaces.parking.area > 400.0
    known = shapely.union_all([surfaces.low, surfaces.pavement, surfaces.paved, surfaces.parking])
    meadow = surfaces.hull.difference(known)
    at = shapely.point_on_surface(max(shapely.get_parts(meadow), key=shapely.area))
    assert built.grid.class_here(at.x, at.y) == ClassId.TERRAIN


def test_a_net_without_crossings_takes_marks_too(tmp_path: Path) -> None:
    bare = write_net(tmp_path, street())
    mark = parse_root(b'<poi x="0" y="0"><param key="crossing" value="zebra"/></poi>', "a mark")
    point = item("crossing.unmarked", (0.0, 0.0))
    assert _unpainted(bare, [mark]) == [] and unmarked_crossings([point], bare) == frozenset()
