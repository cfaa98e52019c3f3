from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import box

from tests.towns.furniture.standing_samples import free_place, item
from tests.towns.ground.rays import normals
from wcsim.towns.furniture.everything import LOOK_OF, _pick_look, _place_mapped
from wcsim.towns.furniture.models import LOOKS
from wcsim.towns.furniture.placement import CLEAR_M, Taken, set_on_ground, standing_object
from wcsim.towns.ground import solid_shapes
from wcsim.towns.ground.plane_geometry import cross_z
from wcsim.towns.ground.solid_shapes import Solid
from wcsim.towns.osm.tags import metres, off_ground
from wcsim.towns.sumo.additional import AUTHOR_KINDS
from wcsim.types import ClassId


def outward(piece: Solid) -> np.ndarray:
    corners = piece.vertices_W_m[piece.faces]
    normal = normals(corners)
    return (normal * (corners.mean(axis=1) - piece.vertices_W_m.mean(axis=0))).sum(axis=1)


@pytest.mark.parametrize(
    "piece",
    [
        solid_shapes.post(np.array([3.0, 4.0]), 0.1, 0.0, 5.0, ClassId.POLE),
        solid_shapes.box(np.array([-3.0, 4.0]), (2.0, 1.0, 0.5), 0.0, 0.7, ClassId.STATIC),
        solid_shapes.spindle(
            np.array([9.0, 9.0]), ((0.0, 2.0), (2.0, 4.0), (1.0, 6.0), (0.0, 7.0)), ClassId.VEGETATION
        ),
        solid_shapes.disc(0.3, 0.34, 0.05, ClassId.BICYCLE),
        solid_shapes.box(np.zeros(2), (1.0, 1.0, 1.0), 1.0, 0.0, ClassId.STATIC, floor=True),
    ],
)
def test_faces_look_outward(piece: Solid) -> None:
    assert (outward(piece) > 0).all()


def test_prism_with_a_courtyard_has_walls_both_ways_and_a_roof_with_a_hole() -> None:
    outline = box(0, 0, 20, 20).difference(box(5, 5, 15, 15))
    piece = solid_shapes.prism(outline, 0.0, 10.0, ClassId.BUILDING)
    corners = piece.vertices_W_m[piece.faces]
    normal = normals(corners)
    roof = normal[:, 2] > 1e-9
    up = corners[roof][:, :, :2]
    assert 0.5 * cross_z(up[:, 1] - up[:, 0], up[:, 2] - up[:, 0]).sum() == pytest.approx(outline.area)
    out = normal[~roof][:, :2] / np.linalg.norm(normal[~roof], axis=1)[:, None]
    inside = corners[~roof].mean(axis=1)[:, :2] - 0.01 * out
    assert shapely.contains_xy(outline, inside).all()


def test_things_are_dropped_from_the_road_and_moved_off_the_way() -> None:
    road, way, free = item("tree", (50, 3)), item("bollard", (50, 11.3)), item("bench", (20, 16))
    assert _place_mapped([road], free_place()) == []
    (moved,) = _place_mapped([way], free_place())
    assert 11.3 < moved.footprint.centroid.y < 13.0
    (bench,) = _place_mapped([free], free_place())
    assert bench.footprint.centroid.distance(shapely.Point(20, 16)) < 1e-9
    for thing in (moved, bench):
        assert thing.footprint.distance(free_place().lines) >= CLEAR_M


def test_fences_open_where_people_walk_and_vehicles_drive() -> None:
    things = _place_mapped([item("fence", (30, -5), (30, 18))], free_place())
    assert len(things) == 3  # before the road, between road and way, behind the way
    for thing in things:
        assert thing.footprint.distance(free_place().lines) >= CLEAR_M
        assert not thing.footprint.intersects(box(0, 0.01, 100, 7.99))


def test_trees_and_lamps_are_cheap_and_leave_headroom() -> None:
    tree, lamp = _place_mapped([item("tree", (20, 16)), item("street_lamp", (60, 16))], free_place())
    assert len(tree.piece.faces) <= 60 and len(lamp.piece.faces) <= 30
    wide = np.linalg.norm(tree.piece.vertices_W_m[:, :2] - (20, 16), axis=1) > 0.2
    assert tree.piece.vertices_W_m[wide, 2].min() > 2.2


@pytest.mark.parametrize(
    "text, value",
    [
        ("12", 12.0),
        ("3,5 m", 3.5),
        ("40 ft", 12.192),
        ("12'6\"", 3.81),
        ("3;4", 4.0),
        ("", None),
        ("nan", None),
        ("1e9", None),
    ],
)
def test_lengths_in_tags(text: str, value: float | None) -> None:
    assert metres(text) == value


@pytest.mark.parametrize("kind", sorted(LOOKS))
def test_every_look_is_closed_below_stays_in_its_footprint_and_has_its_height(kind: str) -> None:
    thing = standing_object(kind, np.array([7.0, -3.0]), 0.4)
    low = thing.piece.vertices_W_m[thing.piece.vertices_W_m[:, 2] < 2.0]
    grown = thing.footprint.buffer(0.1)
    assert shapely.contains_xy(grown, low[:, 0], low[:, 1]).all()
    if LOOKS[kind].make is None:
        assert thing.piece.vertices_W_m[:, 2].max() == pytest.approx(LOOKS[kind].size_lwh_m[2], abs=0.1)
    normal = normals(thing.piece.vertices_W_m[thing.piece.faces])
    assert (np.linalg.norm(normal, axis=1) > 0).all()
    assert len(thing.piece.faces) <= (140 if kind != "rack" else 450)


def test_looks_named_elsewhere_exist() -> None:
    assert set(AUTHOR_KINDS) <= set(LOOKS)
    assert {look for look in LOOK_OF.values() if look} <= set(LOOKS)


def test_two_things_do_not_share_their_ground() -> None:
    things = _place_mapped([item("amenity.bench", (20, 16)), item("amenity.bench", (20.3, 16.1))], free_place())
    assert len(things) == 2
    assert not things[0].footprint.intersects(things[1].footprint)
    taken = Taken()
    for thing in things:
        taken.add(thing.footprint)
    assert not taken.free(things[0].footprint.buffer(0.1)) and taken.free(box(50, 14, 51, 15))


def test_a_bench_looks_at_those_who_walk_by_or_where_the_map_says() -> None:
    (shy,) = _place_mapped([item("amenity.bench", (20, 16))], free_place())
    (told,) = _place_mapped([item("amenity.bench", (20, 16), direction="E")], free_place())
    for thing, front in ((shy, (0.0, -1.0)), (told, (1.0, 0.0))):
        back = thing.piece.vertices_W_m[thing.piece.vertices_W_m[:, 2] > 0.8][:, :2].mean(axis=0)
        assert np.dot(back - (20.0, 16.0), front) == pytest.approx(-0.22, abs=0.02)


def test_a_row_of_trees_is_many_trees_and_what_nobody_knows_is_a_post() -> None:
    row = _place_mapped([item("natural.tree_row", (10, 16), (58, 16))], free_place())
    assert len(row) == 7
    assert _pick_look(item("barrier.pachyderm", (1, 1))) == "bollard"
    for nothing in ("barrier.kerb", "barrier.entrance", "shop.bakery", "landuse.grass"):
        assert _pick_look(item(nothing, (1, 1))) == ""
    assert _place_mapped([item("landuse.block", (50, 15))], free_place()) == []


def test_memorials_in_the_ground_and_pictures_on_walls_do_not_stand() -> None:
    assert _pick_look(item("historic.memorial", (1, 1), memorial="stolperstein")) == ""
    assert _pick_look(item("historic.memorial", (1, 1), memorial="statue")) == "statue"
    assert _pick_look(item("tourism.artwork", (1, 1), artwork_type="mural")) == ""
    assert _pick_look(item("amenity.vending_machine", (1, 1), vending="parking_tickets")) == "meter"


@pytest.mark.parametrize(
    "tags",
    [
        {"level": "1"},
        {"layer": "-1"},
        {"layer": "1"},
        {"indoor": "yes"},
        {"location": "underground"},
        {"bridge": "yes"},
    ],
)
def test_things_off_the_ground_do_not_stand_on_it(tags: dict[str, str]) -> None:
    assert off_ground(tags)
    assert _place_mapped([item("amenity.bench", (20, 16), **tags)], free_place()) == []
    assert len(_place_mapped([item("amenity.bench", (20, 16), level="0;1")], free_place())) == 1


def test_odd_outlines_of_mapped_things_do_no_harm() -> None:
    shapes_m = [[(20, 15)] * 4, [(20, 15), (22, 15)], [(20, 15), (24, 15), (20, 17), (24, 17), (20, 15)]]
    for kind in ("barrier.hedge", "barrier.fence", "amenity.fountain", "natural.tree_row", "barrier.wall"):
        for points in shapes_m:
            for filled in (False, True):
                for thing in _place_mapped([item(kind, *points, filled=filled, area="yes", height="-3")], free_place()):
                    assert np.isfinite(thing.piece.vertices_W_m).all() and thing.footprint.is_valid


def test_things_stand_at_the_height_of_their_ground_and_fences_follow_it() -> None:
    def hill(xy: np.ndarray) -> np.ndarray:
        return 0.1 * xy[:, 0]

    bench, fence = item("amenity.bench", (20, 16)), item("barrier.fence", (40, 16), (80, 16))
    things = _place_mapped([bench, fence], free_place())
    pieces, heads = set_on_ground(things, hill)
    assert heads == ()
    assert pieces[0].vertices_W_m[:, 2].max() == pytest.approx(2.0 + 0.85, abs=0.02)
    top = pieces[1].vertices_W_m[pieces[1].vertices_W_m[:, 2] > 0.1 * pieces[1].vertices_W_m[:, 0]]
    assert np.allclose(top[:, 2], 0.1 * top[:, 0] + 1.2)
    assert np.abs(np.diff(np.unique(top[:, 0]))).max() < 13.0
    hanging = replace(things[0], footprint=shapely.Polygon())
    Taken().add(hanging.footprint)
