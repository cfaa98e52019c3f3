from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely import Polygon, box

from wcsim.towns import shapes
from wcsim.towns.buildings import buildings_of
from wcsim.towns.furniture import CLEAR_M, Place, things_of
from wcsim.towns.items import Item, metres
from wcsim.towns.plane import cross_z
from wcsim.towns.shapes import Piece
from wcsim.types import ClassId


def item(kind: str, *xy: tuple[float, float], filled: bool = False, **tags: str) -> Item:
    return Item(id="x", kind=kind, detail="", points_W_m=np.array(xy, float), filled=filled, tags=tags)


PLACE = Place(
    low=box(0, 0, 100, 8),
    solids=box(0, 20, 100, 30),
    lines=shapely.MultiLineString([[(0, 11), (100, 11)]]),
    hull=box(-10, -10, 110, 40),
)


def outward(piece: Piece) -> np.ndarray:
    corners = piece.vertices_W_m[piece.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return (normal * (corners.mean(axis=1) - piece.vertices_W_m.mean(axis=0))).sum(axis=1)


@pytest.mark.parametrize(
    "piece",
    [
        shapes.post(np.array([3.0, 4.0]), 0.1, 0.0, 5.0, ClassId.POLE),
        shapes.box(np.array([-3.0, 4.0]), (2.0, 1.0, 0.5), 0.0, 0.7, ClassId.STATIC),
        shapes.spindle(np.array([9.0, 9.0]), ((0.0, 2.0), (2.0, 4.0), (1.0, 6.0), (0.0, 7.0)), ClassId.VEGETATION),
    ],
)
def test_faces_look_outward(piece: Piece) -> None:
    assert (outward(piece) > 0).all()


def test_prism_with_a_courtyard_has_walls_both_ways_and_a_roof_with_a_hole() -> None:
    outline = box(0, 0, 20, 20).difference(box(5, 5, 15, 15))
    piece = shapes.prism(outline, 0.0, 10.0, ClassId.BUILDING)
    corners = piece.vertices_W_m[piece.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    roof = normal[:, 2] > 1e-9
    up = corners[roof][:, :, :2]
    assert 0.5 * cross_z(up[:, 1] - up[:, 0], up[:, 2] - up[:, 0]).sum() == pytest.approx(outline.area)
    out = normal[~roof][:, :2] / np.linalg.norm(normal[~roof], axis=1)[:, None]
    inside = corners[~roof].mean(axis=1)[:, :2] - 0.01 * out
    assert shapely.contains_xy(outline, inside).all()


def test_things_are_dropped_from_the_road_and_moved_off_the_way() -> None:
    road, way, free = item("tree", (50, 3)), item("bollard", (50, 11.3)), item("bench", (20, 16))
    assert things_of([road], PLACE) == []
    (moved,) = things_of([way], PLACE)
    assert 11.3 < moved.footprint.centroid.y < 13.0
    (bench,) = things_of([free], PLACE)
    assert bench.footprint.centroid.distance(shapely.Point(20, 16)) < 1e-9
    for thing in (moved, bench):
        assert thing.footprint.distance(PLACE.lines) >= CLEAR_M


def test_fences_open_where_people_walk_and_vehicles_drive() -> None:
    things = things_of([item("fence", (30, -5), (30, 18))], PLACE)
    assert len(things) == 3  # before the road, between road and way, behind the way
    for thing in things:
        assert thing.footprint.distance(PLACE.lines) >= CLEAR_M
        assert not thing.footprint.intersects(box(0, 0.01, 100, 7.99))


def test_trees_and_lamps_are_cheap_and_leave_headroom() -> None:
    tree, lamp = things_of([item("tree", (20, 16)), item("street_lamp", (60, 16))], PLACE)
    assert len(tree.piece.faces) <= 60 and len(lamp.piece.faces) <= 30
    wide = np.linalg.norm(tree.piece.vertices_W_m[:, :2] - (20, 16), axis=1) > 0.2
    assert tree.piece.vertices_W_m[wide, 2].min() > 2.2


def test_buildings_keep_off_the_street_and_take_their_height_from_tags() -> None:
    corners = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
    street = Polygon([(-5, -5), (20, -5), (20, 2), (-5, 2)])
    tall, storeys, unknown = (
        buildings_of([item("building", *corners, filled=True, **tags)], street, box(-50, -50, 50, 50))[0]
        for tags in ({"height": "21.5 m"}, {"building:levels": "5"}, {"height": "high"})
    )
    assert (tall.height_m, storeys.height_m) == (21.5, 17.0)
    assert 9.0 <= unknown.height_m <= 18.0
    assert tall.outline.distance(street) >= 0.09
    twice = buildings_of([item("building", *corners, filled=True)] * 2, Polygon(), box(-50, -50, 50, 50))
    assert len(twice) == 1


@pytest.mark.parametrize(("text", "value"), [("12", 12.0), ("3,5 m", 3.5), ("", None), ("nan", None), ("12'6\"", None)])
def test_lengths_in_tags(text: str, value: float | None) -> None:
    assert metres(text) == value
