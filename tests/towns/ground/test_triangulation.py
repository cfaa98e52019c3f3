from collections import Counter

import numpy as np
import pytest
import shapely

from tests.towns.ground.rays import normals, steepest
from wcsim.towns.ground.kerb_heights import STEEPEST, make_kerbing
from wcsim.towns.ground.mesh import _GroundMesh, build_ground, kerb_walls
from wcsim.towns.ground.plane_geometry import cross_z
from wcsim.towns.ground.surfaces import Surfaces, make_surfaces
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.net import read_net
from wcsim.types import ClassId

WAYS = ("sidewalk", "crossing", "shared")


@pytest.fixture(scope="module")
def surfaces(manhattan_town: Town) -> Surfaces:
    return make_surfaces(read_net(manhattan_town.net, manhattan_town.file.origin_m), WAYS)


@pytest.fixture(scope="module", params=[0.0, 0.03])
def ground(request: pytest.FixtureRequest, surfaces: Surfaces) -> _GroundMesh:
    return build_ground(surfaces, make_kerbing(surfaces, 0.12, request.param))


def test_surfaces_are_disjoint_and_crossings_touch_pavement(surfaces: Surfaces) -> None:
    assert surfaces.low.intersection(surfaces.pavement).area < 0.5  # both lie on a 1 cm grid
    assert surfaces.crossing.difference(surfaces.low).area < 0.5
    touching = [shapely.dwithin(part, surfaces.pavement, 0.02) for part in shapely.get_parts(surfaces.crossing)]
    assert np.mean(touching) > 0.95


def test_ground_has_no_holes_overlaps_or_t_junctions(ground: _GroundMesh, surfaces: Surfaces) -> None:
    """Every edge belongs to two faces, or to a face and a kerb, or to the rim of the town."""
    walls, _, _ = kerb_walls(ground)
    triangles = np.concatenate([ground.vertices_W_m[ground.faces], walls])
    keys = [tuple(corner) for corner in np.rint(triangles.reshape(-1, 3) * 1e5).astype(int).tolist()]
    edges: Counter[tuple[object, object]] = Counter()
    for i in range(0, len(keys), 3):
        a, b, c = keys[i : i + 3]
        edges.update([(a, b), (b, c), (c, a)])
    assert max(edges.values()) == 1  # counter-clockwise everywhere, nothing twice
    open_edges = [edge for edge in edges if (edge[1], edge[0]) not in edges]
    ends = np.array([end[:2] for edge in open_edges for end in edge], dtype=float) / 1e5
    assert shapely.distance(surfaces.hull.boundary, shapely.points(ends)).max() < 0.5
    corners = ground.vertices_W_m[ground.faces][:, :, :2]
    area_m2 = 0.5 * cross_z(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert area_m2.min() > 0.0
    assert area_m2.sum() == pytest.approx(surfaces.hull.area, rel=1e-5)


def test_heights_and_ramps(ground: _GroundMesh) -> None:
    low = ground.vertices_W_m[ground.faces[ground.low]]
    high = ground.vertices_W_m[ground.faces[~ground.low]]
    assert (low[:, :, 2] == 0.0).all()
    assert high[:, :, 2].min() >= 0.0 and high[:, :, 2].max() == pytest.approx(0.12)
    assert (high[:, :, 2] > 0.1199).mean() > 0.7  # most of the pavement is not a ramp
    assert steepest(high) <= 1.05 * STEEPEST


def test_kerbs_face_the_road_and_are_lowered_at_crossings(ground: _GroundMesh, surfaces: Surfaces) -> None:
    walls, kinds, _ = kerb_walls(ground)
    assert set(np.unique(kinds)) == {ClassId.KERB, ClassId.LOWERED_KERB}
    rise_m = walls[:, :, 2].max(axis=1)
    assert (rise_m[kinds == ClassId.LOWERED_KERB] < 0.09).all()
    normal = normals(walls)
    assert np.allclose(normal[:, 2], 0.0)
    flat = normal[:, :2] / np.linalg.norm(normal[:, :2], axis=1, keepdims=True)
    ahead = walls[:, :2, :2].mean(axis=1) + 0.03 * flat
    assert shapely.contains_xy(surfaces.low.buffer(0.01), ahead).mean() > 0.98
    edge = surfaces.crossing.boundary.intersection(surfaces.pavement.buffer(0.02))
    mouths = [part for part in shapely.get_parts(edge) if part.length > 1.0]
    middles = shapely.line_interpolate_point(mouths, 0.5, normalized=True)
    full = shapely.union_all(shapely.linestrings(walls[kinds == ClassId.KERB][:, :2, :2]))
    assert shapely.distance(full, middles).min() > 0.3


def test_a_town_without_kerbs_is_flat(surfaces: Surfaces) -> None:
    flat = build_ground(surfaces, make_kerbing(surfaces, 0.0, 0.0))
    assert (flat.vertices_W_m[:, 2] == 0.0).all()
    assert len(kerb_walls(flat)[0]) == 0
