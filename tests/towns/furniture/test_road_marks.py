"""What is painted on a hand-written crossroads with two car lanes, a cycle lane and a pavement each way."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.furniture.road_marks import lane_marks
from wcsim.towns.ground.relief import fit_relief, on_land
from wcsim.towns.ground.surfaces import Surfaces, make_surfaces
from wcsim.towns.scenario.town import Town
from wcsim.towns.scene_folders.build import build_scene
from wcsim.towns.sumo.net import Net, read_net
from wcsim.types import F64, GroundPaint, Mark, Relief
from wcsim.types.street import FLAT

ARMS = {"W": (-60, 0), "E": (60, 0), "N": (0, 60), "S": (0, -60)}
FILES = {
    "scene.toml": 'name = "lanes"\nshows = "Lanes."\nseed = 1\nduration_s = 9.0\nlefthand = {lefthand}\n[[seats]]\n'
    'start_m = [-30.0, -10.0]\nheading_deg = 0.0\ngoal_m = [30.0, -10.0]\nprofile = "competent"\n[expect]\n',
    "street.nod.xml": '<nodes><node id="C" x="0" y="0" type="traffic_light"/>'
    + "".join(f'<node id="{name}" x="{x}" y="{y}"/>' for name, (x, y) in ARMS.items())
    + "</nodes>",
    "street.edg.xml": "<edges>"
    + "".join(
        f'<edge id="{start}{end}" from="{start}" to="{end}" type="road"/>'
        for name in ARMS
        for start, end in ((name, "C"), ("C", name))
    )
    + "</edges>",
    "street.con.xml": "<connections>"
    + "".join(f'<crossing node="C" edges="{name}C C{name}" width="4"/>' for name in ARMS)
    + "</connections>",
    "street.typ.xml": '<types><type id="road" numLanes="2" speed="13.9" sidewalkWidth="2.5" bikeLaneWidth="1.6" '
    'width="3.25"/></types>',
    "street.rou.xml": "<routes/>",
}


def town_of(folder: Path, lefthand: str = "false") -> Town:
    source = folder / "source"
    source.mkdir()
    for name, text in FILES.items():
        (source / name).write_text(text.replace("{lefthand}", lefthand))
    return build_scene(source, folder / "town")[0]


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Town:
    return town_of(tmp_path_factory.mktemp("lanes"))


def net_of(town: Town) -> tuple[Net, Surfaces]:
    whole = read_net(town.net, town.file.origin_m)
    net = on_land(whole, fit_relief(whole))
    return net, make_surfaces(net, town.file.chair_ways)


def painted(town: Town, relief: Relief = FLAT) -> GroundPaint:
    net, surfaces = net_of(town)
    return lane_marks(net, surfaces, town.file.chair_ways, relief)


def sizes_m(paint: GroundPaint) -> F64:
    """Length and width (M, 2) of every piece."""
    quads = paint.quads_W_m.astype(np.float64)
    return np.column_stack([np.linalg.norm(quads[:, k] - quads[:, 0], axis=1) for k in (1, 3)])


def areas(paint: GroundPaint) -> list[shapely.Polygon]:
    return [shapely.Polygon(quad[:, :2]) for quad in paint.quads_W_m]


def test_lines_have_the_usual_widths_and_dashes(town: Town) -> None:
    lines = painted(town).part(painted(town).mark == Mark.LINE)
    length_m, width_m = sizes_m(lines).T
    stops = width_m > 1.0
    assert width_m[~stops] == pytest.approx(0.12, abs=1e-4)
    assert stops.sum() == 3 * len(ARMS)  # two car lanes and a cycle lane enter from each arm
    assert sorted({round(w, 2) for w in width_m[stops].tolist()}) == [1.6, 3.25]
    assert length_m[stops] == pytest.approx(0.4, abs=1e-4)
    middle_m = lines.quads_W_m[~stops].mean(axis=1)
    dashes = (np.abs(middle_m[:, 1] - 3.25) < 0.05) & (middle_m[:, 0] > 0.0)  # between the lanes of the eastern arm
    assert length_m[~stops][dashes] == pytest.approx(3.0, abs=1e-4)
    assert np.diff(np.sort(middle_m[dashes, 0])) == pytest.approx(9.0, abs=1e-4)


def test_directions_are_parted_by_a_line_in_the_middle_and_cycle_lanes_are_coloured(town: Town) -> None:
    paint = painted(town)
    middle_m = paint.quads_W_m.mean(axis=1)
    centre = (np.abs(middle_m[:, 1]) < 0.01) & (middle_m[:, 0] > 0.0)
    ends_m = paint.quads_W_m[centre][:, :, 0]
    junction = max(shapely.Polygon(j.outline_m).bounds[2] for j in net_of(town)[0].junctions if j.id == "C")
    assert (ends_m.min(), ends_m.max()) == (pytest.approx(junction, abs=0.5), pytest.approx(60.0, abs=0.5))
    cycle = paint.part(paint.mark == Mark.CYCLE_LANE)
    assert sizes_m(cycle)[:, 1] == pytest.approx(1.6, abs=1e-4)
    assert sum(area.area for area in areas(cycle)) == pytest.approx(8 * 1.6 * (60.0 - junction), rel=0.02)


def test_nothing_is_painted_on_pavements_crossings_or_across_junctions(town: Town) -> None:
    net, surfaces = net_of(town)
    paint = shapely.union_all(areas(painted(town)))
    inner = shapely.union_all([shapely.Polygon(j.outline_m) for j in net.junctions if len(j.outline_m) > 2])
    for taken in (surfaces.pavement, surfaces.crossing, inner):
        assert paint.intersection(taken.buffer(-0.05)).area < 0.01  # it ends at kerbs


def test_every_piece_is_short_looks_up_and_lies_a_little_above_the_land(town: Town) -> None:
    hill = replace(FLAT, z_m=np.array([[0, 0], [0, 1]], np.float32), origin_W_m=(-60.0, -60.0), cell_m=120.0)
    for relief, longest_m in ((FLAT, 6.0), (hill, 1.0)):
        paint = painted(town, relief)
        above_m = paint.quads_W_m[..., 2] - relief.at(paint.quads_W_m.astype(np.float64))
        assert 0.004 < above_m.min() <= above_m.max() < 0.04
        assert sizes_m(paint)[:, 0].max() < longest_m + 0.1
        assert all(area.exterior.is_ccw for area in areas(paint))


def test_where_traffic_keeps_to_the_left_all_is_mirrored(town: Town, tmp_path: Path) -> None:
    right, left = (shapely.union_all(areas(painted(t))) for t in (town, town_of(tmp_path, "true")))
    mirrored = shapely.transform(left, lambda xy: xy * (-1.0, 1.0))
    assert mirrored.symmetric_difference(right).area < 0.01 * right.area


def test_a_street_of_walking_speed_has_no_lines(town: Town) -> None:
    net, surfaces = net_of(town)
    slow = tuple(replace(e, lanes=tuple(replace(lane, speed_mps=5.5) for lane in e.lanes)) for e in net.edges)
    calm = replace(net, edges=slow, connections=())
    crossings = [edge for edge in slow if edge.function != "crossing"]
    paint = lane_marks(replace(calm, edges=tuple(crossings)), surfaces, town.file.chair_ways, FLAT)
    assert set(paint.mark.tolist()) == {int(Mark.CYCLE_LANE)}


def test_a_built_street_keeps_its_paint_in_its_tiles(town: Town) -> None:
    kept, made = unpack_street(build_street(town)).mesh.paint, painted(town)
    rows = [np.unique(np.c_[p.quads_W_m.reshape(-1, 12), p.mark], axis=0) for p in (kept, made)]
    assert np.array_equal(*rows)
