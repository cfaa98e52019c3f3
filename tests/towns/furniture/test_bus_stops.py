from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely import box

from tests.towns.furniture.standing_samples import free_place, item
from wcsim.towns.furniture.everything import _stop_things
from wcsim.towns.furniture.placement import CLEAR_M
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.additional import Item, read_items
from wcsim.towns.sumo.net import read_net
from wcsim.types import ClassId


def stop(*xy: tuple[float, float]) -> Item:
    return item("stop.busStop", *xy)


WESTWARD = stop((60, 6), (50, 6), (40, 6))  # the pavement is on its right


def test_a_stop_gets_a_pole_and_a_shelter_beside_its_lane_off_the_way() -> None:
    pole, shelter = _stop_things([WESTWARD], free_place(), lefthand=False)
    assert 8.0 < pole.footprint.centroid.y < 10.5 and 40.0 < pole.footprint.centroid.x < 45.0
    assert 45.0 < shelter.footprint.centroid.x < 55.0
    for thing in (pole, shelter):
        assert free_place().free(thing.footprint)
        assert thing.footprint.distance(free_place().lines) >= CLEAR_M
    wide = shelter.piece.vertices_W_m
    inner = wide[(wide[:, 2] > 0.4) & (wide[:, 2] < 0.5)]  # the bench inside
    assert inner[:, 1].mean() > shelter.footprint.centroid.y  # it looks at the road
    assert {ClassId.BUILDING, ClassId.STATIC} == {ClassId(int(c)) for c in np.unique(shelter.piece.face_class)}


def test_where_there_is_no_room_there_is_no_shelter() -> None:
    way = shapely.MultiLineString([[(0, 9.9), (100, 9.9)]])
    narrow = replace(free_place(), lines=way, solids=box(0, 10.8, 100, 30))
    (pole,) = _stop_things([WESTWARD], narrow, lefthand=False)
    assert pole.footprint.area < 0.1
    nowhere = replace(free_place(), solids=box(0, 8, 100, 30))
    assert _stop_things([WESTWARD], nowhere, lefthand=False) == []


def test_where_traffic_keeps_left_people_wait_on_the_left() -> None:
    eastward = stop((40, 6), (50, 6), (60, 6))
    things = _stop_things([eastward], free_place(), lefthand=True)
    assert len(things) == 2 and all(thing.footprint.centroid.y > 8.0 for thing in things)
    for thing in _stop_things([eastward], free_place(), lefthand=False):
        assert thing.footprint.centroid.y < 0.0


def test_mapped_stops_are_poles_and_not_doubled() -> None:
    mapped = item("highway.bus_stop", (50, 9))
    (pole,) = _stop_things([mapped], free_place(), lefthand=False)
    assert pole.footprint.distance(shapely.Point(50, 9)) < 1.0
    sheltered = item("highway.bus_stop", (20, 13.5), shelter="yes")
    (shelter,) = _stop_things([sheltered], free_place(), lefthand=False)
    assert shelter.footprint.area == pytest.approx(3.6 * 1.3)
    assert len(_stop_things([WESTWARD, mapped], free_place(), lefthand=False)) == 2


@pytest.mark.parametrize(
    "attributes",
    ['lane="gone_1"', 'lane="EC_1" startPos="x"', 'lane="EC_1" startPos="nan"', "", 'lane="EC_1" endPos="inf"'],
)
def test_broken_stops_are_left_out(corner_town: Town, tmp_path: Path, attributes: str) -> None:
    path = tmp_path / "s.add.xml"
    path.write_text(f'<additional><busStop id="b" {attributes}/></additional>')
    assert read_items((path,), (0, 0), read_net(corner_town.net)) == []
    assert read_items((path,), (0, 0)) == []


@pytest.mark.parametrize(
    "attributes", ['startPos="20" endPos="32"', 'startPos="-33" endPos="-21"', 'startPos="20"', ""]
)
def test_stops_are_read_from_their_lane(corner_town: Town, tmp_path: Path, attributes: str) -> None:
    path = tmp_path / "s.add.xml"
    text = f'<additional><busStop id="b" lane="EC_1" {attributes}/><trainStop id="t" lane="CE_1"/></additional>'
    path.write_text(text)
    net = read_net(corner_town.net)
    bus, tram = read_items((path,), (0, 0), net)
    lane = next(lane for edge in net.edges for lane in edge.lanes if lane.id == "EC_1")
    start = {"": 0.0}.get(attributes, 20.0)
    assert bus.points_W_m.shape == (3, 2) and tram.detail == "trainStop"
    assert np.hypot(*(bus.points_W_m[0] - lane.points_m[0])) == pytest.approx(start, abs=0.2)
    if "endPos" in attributes:
        assert np.hypot(*(bus.points_W_m[2] - bus.points_W_m[0])) == pytest.approx(12.0, abs=0.2)
