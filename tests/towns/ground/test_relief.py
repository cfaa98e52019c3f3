import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.towns.ground.rays import mesh_faults
from tests.towns.made.nets import PAVED, WAYS, assert_sound, edge, generated, hilly, lane, street, write_net
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.ground.relief import fit_relief, on_land
from wcsim.towns.ground.surfaces import make_surfaces
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.net import Net, read_net
from wcsim.types import ClassId
from wcsim.types.street import FLAT, Relief, Street


def hill_m(x: float, y: float) -> float:
    """A land that rises and falls with up to 8 %."""
    return 60.0 + 5.0 * math.sin(x / 90.0) + 4.0 * math.cos(y / 80.0) + 0.01 * x


@pytest.fixture(scope="module")
def hill_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hill")
    generated(folder, "--grid", "--grid.number", "4", "--grid.length", "70", *PAVED)
    return hilly(folder / "made.net.xml", folder / "hill.net.xml", hill_m)


@pytest.fixture(scope="module")
def hill(hill_file: Path) -> Net:
    return read_net(hill_file)


@pytest.fixture(scope="module")
def hill_street(hill_file: Path, corner_town: Town) -> Street:
    return unpack_street(build_street(replace(corner_town, net=hill_file, additional=())))


def test_a_net_without_heights_is_level(tmp_path: Path) -> None:
    assert fit_relief(write_net(tmp_path, street())) is FLAT
    high = write_net(tmp_path, edge("s", lane("0,0,37.4 60,0,37.4")))
    assert fit_relief(high) is FLAT and high.z_origin_m == 37.4


def test_the_land_follows_the_lanes_and_goes_on_smoothly_between_them(hill: Net) -> None:
    relief = fit_relief(hill)
    ways = [way for way in hill.lanes(*(lane.kind for edge in hill.edges for lane in edge.lanes)) if len(way.z_m)]
    points_m, z_m = (np.concatenate([getattr(way, name) for way in ways]) for name in ("points_m", "z_m"))
    assert np.abs(relief.at(points_m) - z_m).max() < 0.15
    between_m = np.array([[35.0, 35.0], [105.0, 35.0], [105.0, 105.0]])  # middles of blocks
    true_m = np.array([hill_m(x, y) for x, y in between_m]) - hill.z_origin_m
    assert np.abs(relief.at(between_m) - true_m).max() < 0.6
    steps = np.hypot(*np.gradient(relief.z_m.astype(float), relief.cell_m))
    assert steps.max() < 0.12


def test_the_relief_is_cut_as_it_says() -> None:
    relief = Relief(origin_W_m=(8.0, -8.0), cell_m=8.0, z_m=np.array([[0, 1, 0], [2, 3, 5]], np.float32))
    corners = np.array([[8.0, -8.0], [16.0, -8.0], [8.0, 0.0], [16.0, 0.0], [24.0, 0.0]])
    assert np.allclose(relief.at(corners), [0, 1, 2, 3, 5])
    assert relief.at(np.array([12.0, -4.0])) == pytest.approx(1.5)  # on the diagonal
    assert relief.at(np.array([[-50.0, -50.0], [99.0, 99.0]])).tolist() == [0.0, 5.0]


def test_hilly_ground_is_sound_and_the_grid_agrees_with_the_mesh(hill: Net, hill_street: Street) -> None:
    assert_sound(hill, fit_relief(hill))
    assert mesh_faults(hill_street) <= 1
    z_m = hill_street.mesh.vertices_W_m[:, 2]
    assert hill_street.net_origin_m[2] == hill.z_origin_m and abs(hill.z_origin_m - 62.0) < 6.0
    assert z_m.min() > -12.0 and np.ptp(z_m) > 8.0


def test_no_face_crosses_a_fold_of_the_land(hill: Net, hill_street: Street) -> None:
    mesh, relief = hill_street.mesh, fit_relief(hill)
    ground = np.isin(mesh.face_class, (ClassId.ROAD, ClassId.TERRAIN))
    corners = mesh.vertices_W_m[mesh.faces[ground]].astype(float)
    lifted_m = corners[:, :, 2] - relief.at(corners)
    level = np.ptp(lifted_m, axis=1) < 1e-4
    middle = corners.mean(axis=1)
    assert np.abs(middle[:, 2] - relief.at(middle) - lifted_m.mean(axis=1))[level].max() < 0.004


def test_what_passes_over_a_street_is_no_ground(tmp_path: Path) -> None:
    bridge = edge("b", lane("30,-200,-1 30,-100,0 30,-20,6 30,20,6 30,100,0 30,200,-1"))
    net = write_net(tmp_path, *(edge(f"s{y}", lane(f"-100,{y},0 160,{y},0")) for y in (-60, 0, 60)), bridge)
    relief = fit_relief(net)
    assert np.abs(relief.at(np.array([[30.0, 0.0], [0.0, 0.0], [60.0, 0.0]]))).max() < 0.4
    kept = on_land(net, relief)
    (below,) = (edge for edge in kept.edges if edge.id == "s0")
    assert np.array_equal(below.lanes[0].points_m, net.edges[1].lanes[0].points_m)
    deck = shapely.LineString([(30.0, -16.0), (30.0, -5.0)])
    assert make_surfaces(net, WAYS).low.intersection(deck).length > 10.0
    assert make_surfaces(kept, WAYS).low.intersection(deck).length < 0.1
    assert_sound(kept, relief)


def test_absurd_grades_of_short_edges_do_not_bend_the_land(tmp_path: Path) -> None:
    spike = edge("x", lane("30,0,0 31,0,4 32,0,0"))
    relief = fit_relief(
        write_net(tmp_path, edge("s", lane("-60,0,0 30,0,0")), spike, edge("t", lane("32,0,0 90,0,0.5")))
    )
    assert abs(relief.at(np.array([31.0, 0.0]))) < 0.1
