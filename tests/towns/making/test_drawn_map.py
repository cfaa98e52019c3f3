"""What stands between and along the streets: no house on a street, nothing on a crossing, room to pass."""

from pathlib import Path

import numpy as np
import pytest
import shapely

from wcsim.core.seeding import make_rng
from wcsim.towns.ground.surfaces import lane_area
from wcsim.towns.making.drawn_map import _OPEN, _Blocks, _build_blocks, _dress, _leave_open, draw_map
from wcsim.towns.making.maker import _make_streets, _Signals, _write_net
from wcsim.towns.making.plan import draw_plan, shape_plan
from wcsim.towns.sumo.net import LaneKind, Net, read_net
from wcsim.towns.sumo.xml_io import read_root


@pytest.fixture(scope="module", params=[False, True], ids=["righthand", "lefthand"])
def net(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Net:
    folder, rng = tmp_path_factory.mktemp("net"), make_rng(2, "test")
    shaped = shape_plan(draw_plan("random", 500.0, 2, rng, folder), rng)
    signals = _Signals(share=0.5, crossing_m=4.0, corner_m=4.0, lefthand=request.param)
    net = read_net(_write_net("n", shaped, _make_streets(shaped, rng), signals, folder, rng))
    assert net.lefthand == request.param
    return net


def test_houses_stand_beside_the_streets_and_beside_each_other(net: Net) -> None:
    blocks = _build_blocks(net, make_rng(2, "blocks"))
    outlines = [outline for outline, _ in blocks.houses]
    assert len(outlines) > 40
    streets = shapely.union_all([lane_area(lane) for edge in net.edges for lane in edge.lanes])
    assert shapely.distance(streets, outlines).min() > 0.05
    assert np.mean(shapely.distance(streets, outlines) < 12.0) > 0.95
    first, second = shapely.STRtree(outlines).query(outlines, predicate="intersects")
    shared_m2 = [outlines[i].intersection(outlines[j]).area for i, j in zip(first, second, strict=True) if i < j]
    assert max(shared_m2, default=0.0) < 0.6 * 30.0 * 0.03
    for area in (*blocks.car_parks, *blocks.squares):
        assert area.intersection(streets).area < 0.1


@pytest.mark.parametrize("use", sorted(set(_OPEN)))
def test_a_narrow_block_has_no_empty_outline(use: str) -> None:
    found = _Blocks()
    _leave_open(shapely.box(0.0, 0.0, 60.0, 1.8), use, found)
    outlines = [*(outline for _, outline in found.greens), *found.squares, *found.car_parks]
    assert not any(outline.is_empty for outline in outlines)


def test_posts_stand_at_the_kerb_and_nothing_on_road_or_crossing(net: Net) -> None:
    mapped, placed = _dress(net, make_rng(2, "dress"))
    road = shapely.union_all([lane_area(lane) for lane in net.lanes(LaneKind.MOTOR, LaneKind.CROSSING)])
    places = [xy_m for _, xy_m in mapped] + [xy_m for _, xy_m, _ in placed]
    assert len(places) > 200
    assert not shapely.intersects_xy(road, np.array(places)).any()
    driven = shapely.union_all([lane_area(lane) for lane in net.lanes(LaneKind.MOTOR, LaneKind.BIKE, LaneKind.SHARED)])
    lamps = np.array([xy_m for kind, xy_m in mapped if kind == "highway.street_lamp"])
    assert np.mean(shapely.distance(driven, shapely.points(lamps)) < 0.5) > 0.95


def test_what_is_left_in_the_way_lies_on_pavements_that_are_wide_enough(net: Net) -> None:
    placed = [thing for seed in range(8) for thing in _dress(net, make_rng(seed, "left"))[1]]
    assert placed
    wide = [lane for lane in net.lanes(LaneKind.SIDEWALK, LaneKind.SHARED) if lane.width_m >= 2.4]
    ground = shapely.union_all([lane_area(lane) for lane in wide]).buffer(0.1)
    assert all(ground.contains(shapely.Point(xy_m)) for _, xy_m, _ in placed)


def test_each_crossing_has_a_kerb_at_both_ends_and_those_at_signals_are_low(net: Net, tmp_path: Path) -> None:
    poly, ground, _ = draw_map(net, "made", tmp_path, make_rng(2, "map"))
    crossings = net.lanes(LaneKind.CROSSING)
    kerbs = [item for item in read_root(poly) if item.get("type", "").startswith("kerb.")]
    assert len(kerbs) == 2 * len(crossings)
    lit = {name for link in net.connections if link.tls_id for name in (link.start, link.end)}
    ends = [(lane.edge_id in lit, lane.points_m[end]) for lane in crossings for end in (0, -1)]
    for kerb, (signalled, xy_m) in zip(kerbs, ends, strict=True):
        assert np.allclose([float(kerb.attrib["x"]), float(kerb.attrib["y"])], xy_m, atol=0.02)
        assert not (signalled and kerb.get("type") == "kerb.raised")
    marks = [item for item in read_root(ground) if item.get("type") == "highway.crossing"]
    assert len(marks) == len(crossings)
