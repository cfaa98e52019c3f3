from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.cli.towns import tiny_osm
from wcsim.towns.ground.surfaces import lane_area
from wcsim.towns.importing.importer import ImportOrder, import_town
from wcsim.towns.importing.map_marks import INSIDE_M, find_parking
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.net import read_net
from wcsim.towns.sumo.tools import run_tool
from wcsim.towns.sumo.xml_io import read_root


def with_car_parks() -> str:
    """The tiny extract with a car park in a yard, one that lies across a street, and one under ground."""
    corners = {
        "yard": (60.0003, 25.0004, 60.0006, 25.0012),
        "street": (59.9998, 25.0022, 60.0001, 25.0030),
        "cellar": (60.0012, 25.0004, 60.0015, 25.0012),
    }
    lines = []
    for number, (name, (south, west, north, east)) in enumerate(corners.items()):
        places = [(south, west), (south, east), (north, east), (north, west)]
        first = 1000 + 10 * number
        lines += [f'<node id="{first + k}" lat="{lat}" lon="{lon}"/>' for k, (lat, lon) in enumerate(places)]
        refs = "".join(f'<nd ref="{first + k}"/>' for k in (0, 1, 2, 3, 0))
        kind = '<tag k="parking" v="underground"/>' if name == "cellar" else ""
        lines.append(f'<way id="{first}">{refs}<tag k="amenity" v="parking"/>{kind}</way>')
    return tiny_osm().replace("</osm>", "".join(lines) + "</osm>")


@pytest.fixture(scope="module")
def order(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ImportOrder]:
    folder = tmp_path_factory.mktemp("parking")
    (folder / "tiny.osm").write_text(with_car_parks())
    yield ImportOrder(
        map_file=folder / "tiny.osm", name="lots", split="test", out=folder / "lots", traffic=0.0, parked=0.5
    )


@pytest.fixture(scope="module")
def town(order: ImportOrder) -> Town:
    return import_town(order).town


def test_car_parks_become_parking_areas_that_nobody_drives_or_walks_through(town: Town) -> None:
    areas = {area.attrib["id"]: area for area in read_root(town.additional[0]).iter("parkingArea")}
    assert "lot.1000" in areas and "lot.1020" not in areas
    spaces = [space for area in areas.values() for space in area.iterfind("space")]
    assert len(areas["lot.1000"].findall("space")) >= 20
    net = read_net(town.net)
    used = shapely.union_all([lane_area(lane) for edge in net.edges for lane in edge.lanes])
    middles = [(float(space.attrib["x"]), float(space.attrib["y"])) for space in spaces]
    assert not shapely.intersects(used, shapely.points(middles)).any()
    assert shapely.dwithin(used.convex_hull, shapely.points(middles), INSIDE_M).all()  # where there is ground


def test_parked_cars_stand_in_their_spaces_for_good(town: Town, tmp_path: Path) -> None:
    cars = [item for item in read_root(town.routes[0]) if item.tag == "vehicle"]
    spaces = list(read_root(town.additional[0]).iter("space"))
    assert len(cars) == pytest.approx(0.5 * len(spaces), abs=2)
    out = tmp_path / "fcd.xml"
    run = run_tool("sumo", ["-c", str(town.sumocfg), "--end", "60", "--fcd-output", str(out)], tmp_path)
    assert run.returncode == 0
    last = list(read_root(out))[-1]
    seen = [vehicle.attrib for vehicle in last.iterfind("vehicle")]
    assert len(seen) == len(cars), "all of them are there, and nobody has left"
    assert all(float(vehicle["speed"]) == 0.0 for vehicle in seen)
    noses = np.array([[float(vehicle["x"]), float(vehicle["y"])] for vehicle in seen])
    places = np.array([[float(space.attrib["x"]), float(space.attrib["y"])] for space in spaces])
    away_m = np.hypot(*(noses[:, None] - places[None]).transpose(2, 0, 1))
    assert away_m.min(axis=1).max() < 0.05
    assert len({int(k) for k in away_m.argmin(axis=1)}) == len(cars), "one car in a space"
    net = read_net(town.net)
    used = shapely.union_all([lane_area(lane) for edge in net.edges for lane in edge.lanes])
    for vehicle, nose in zip(seen, noses, strict=True):
        heading = np.deg2rad(float(vehicle["angle"]))
        tail = nose - 4.5 * np.array([np.sin(heading), np.cos(heading)])
        assert not used.intersects(shapely.LineString([nose, tail]).buffer(0.9, cap_style="flat"))


def test_no_parked_cars_when_none_are_wanted(town: Town) -> None:
    assert town.poly is not None and find_parking(read_net(town.net), town.poly, 0.0, 1) == ([], [])
