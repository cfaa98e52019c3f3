import itertools
from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.support.yardstick import multiple
from tests.towns.ground.rays import mesh_faults
from wcsim.towns import build_street, street
from wcsim.towns.checks.check import _demand_classes
from wcsim.towns.ground.tiles import RASTER_M, TILE_M
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.street import load_street
from wcsim.towns.sumo.net import read_net
from wcsim.towns.walking.islands import largest_share, walkable_parts
from wcsim.types import ClassId, Street, WayKind
from wcsim.types.street import AT_EDGE

WALKABLE = (ClassId.SIDEWALK, ClassId.CROSSWALK)


def _walked(world: Street) -> np.ndarray:
    """Points every 0.2 m along all ways."""
    lines = shapely.linestrings
    parts = [shapely.segmentize(lines(edge.points_W_m), 0.2) for edge in world.walk.edges]
    return np.concatenate([shapely.get_coordinates(part) for part in parts])


def test_chunks_own_their_vertices(manhattan: Street) -> None:
    mesh = manhattan.mesh
    assert mesh.chunk_faces[-1] == len(mesh.faces) and mesh.chunk_vertices[-1] == len(mesh.vertices_W_m)
    for c in range(len(mesh.chunk_faces) - 1):
        faces = mesh.faces[mesh.chunk_faces[c] : mesh.chunk_faces[c + 1]]
        assert faces.min() >= mesh.chunk_vertices[c] and faces.max() < mesh.chunk_vertices[c + 1]
    assert mesh.vertices_W_m.dtype == np.float32 and mesh.faces.dtype == np.int32 and mesh.face_class.dtype == np.uint8
    assert np.isfinite(mesh.vertices_W_m).all()
    assert len(mesh.faces) < 60_000


@pytest.mark.parametrize("name", ["corner", "manhattan"])
def test_grid_agrees_with_mesh(name: str, request: pytest.FixtureRequest) -> None:
    assert mesh_faults(request.getfixturevalue(name)) <= 1  # a ray may run along an edge


@pytest.mark.parametrize("name", ["corner", "manhattan"])
def test_the_distance_to_kerbs_is_that_of_the_mesh(name: str, request: pytest.FixtureRequest) -> None:
    """Held against shapely, and the side against the class below the middle of a cell."""
    world = request.getfixturevalue(name)
    mesh, rng = world.mesh, np.random.default_rng(5)
    corners = mesh.vertices_W_m[mesh.faces[np.isin(mesh.face_class, (ClassId.KERB, ClassId.LOWERED_KERB))]][..., :2]
    kerbs = shapely.union_all(shapely.linestrings(np.concatenate([corners, corners[:, :1]], axis=1).astype(float)))
    middle = shapely.get_coordinates(kerbs)[len(shapely.get_coordinates(kerbs)) // 2]
    grid = world.grid.around(middle)
    rows, cols = (rng.integers(0, size, 4000) for size in grid.edge_cm.shape)
    xy_m = np.array(grid.origin_W_m) + (np.column_stack([cols, rows]) + 0.5) * grid.cell_m
    far_cm, low = 100.0 * shapely.distance(kerbs, shapely.points(xy_m)), grid.edge_cm[rows, cols] < AT_EDGE
    told_cm = np.abs(grid.edge_cm[rows, cols] + 0.5 - AT_EDGE)
    assert np.abs(np.minimum(far_cm, 80.5) - told_cm)[far_cm < 120.0].max() <= 1.0 and (far_cm < 70.0).sum() > 100
    known = grid.ground_class[rows, cols] != ClassId.VOID
    on_road = np.isin(grid.ground_class[rows, cols], (ClassId.ROAD, ClassId.CROSSWALK, ClassId.RAIL_TRACK))
    assert (low == on_road)[known].all()


def test_nothing_solid_stands_on_road_or_crossing(manhattan: Street) -> None:
    solid = []
    rasters_a_side = round(TILE_M / RASTER_M)
    middles_m = (np.indices((rasters_a_side, rasters_a_side)).reshape(2, -1).T + 0.5) * RASTER_M
    for key, middle_m in itertools.product(manhattan.tiles.keys, middles_m):
        grid = manhattan.grid.around(np.array(key) * TILE_M + middle_m)
        solid.append(grid.clearance_dm[np.isin(grid.ground_class, (ClassId.ROAD, ClassId.CROSSWALK))] == 0)
    assert np.concatenate(solid).mean() < 1e-4  # a footprint that ends at the edge covers part of a cell


@pytest.mark.parametrize("name", ["corner", "manhattan"])
def test_ways_stay_on_walkable_ground_clear_of_walls_and_kerbs(name: str, request: pytest.FixtureRequest) -> None:
    """A crossing without paint looks like the road, up to where it meets the pavement."""
    world = request.getfixturevalue(name)
    xy_m = _walked(world)
    crossings = [shapely.linestrings(edge.points_W_m) for edge in world.walk.edges if edge.kind is WayKind.CROSSING]
    off_m = shapely.distance(shapely.union_all(crossings), shapely.points(xy_m))
    classes = world.grid.class_at(xy_m)
    assert (np.isin(classes, WALKABLE) | ((classes == ClassId.ROAD) & (off_m < 2.5))).all()
    assert world.grid.clearance_at(xy_m).min() >= 0.3  # 0.45 m, less what whole cells and decimetres take off
    mesh = world.mesh
    kerbs = mesh.vertices_W_m[mesh.faces[mesh.face_class == ClassId.KERB]].astype(float)
    full = kerbs[kerbs[:, :, 2].max(axis=1) > 0.11]
    lines = shapely.union_all(shapely.linestrings(full[:, :2, :2]))
    assert shapely.distance(lines, shapely.points(xy_m)).min() > 0.30


def test_ways_are_one_network_with_crossings_and_signals(manhattan: Street) -> None:
    kinds = {edge.kind for edge in manhattan.walk.edges}
    assert kinds == {WayKind.SIDEWALK, WayKind.WALKINGAREA, WayKind.CROSSING}
    lit = [edge for edge in manhattan.walk.edges if edge.tls_id]
    assert lit and all(edge.kind is WayKind.CROSSING and edge.tls_links for edge in lit)
    for edge in manhattan.walk.edges:
        assert np.allclose(edge.points_W_m[0], manhattan.walk.nodes_W_m[edge.start])
        assert np.allclose(edge.points_W_m[-1], manhattan.walk.nodes_W_m[edge.end])


@pytest.mark.usefixtures("manhattan")
def test_cached_street_is_the_same_and_fast(
    corner_town: Town, corner: Street, manhattan_town: Town, kept_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load_street(corner_town)
    monkeypatch.setattr(build_street, "build_street", lambda town, at: pytest.fail("built although it is in the cache"))
    found = load_street(corner_town)
    assert found.tiles.keys == corner.tiles.keys
    for tile in found.tiles.keys:
        assert found.tiles.mesh(tile) == corner.tiles.mesh(tile)
    middle = corner.walk.nodes_W_m.mean(axis=0)
    assert found.grid.around(middle) == corner.grid.around(middle)
    assert np.array_equal(found.walk.nodes_W_m, corner.walk.nodes_W_m)
    for ours, theirs in zip(corner.walk.edges, found.walk.edges, strict=True):
        assert np.array_equal(ours.points_W_m, theirs.points_W_m)
        assert (ours.sumo_id, ours.kind, ours.start, ours.end, ours.width_m, ours.tls_id, ours.tls_links) == (
            theirs.sumo_id, theirs.kind, theirs.start, theirs.end, theirs.width_m, theirs.tls_id, theirs.tls_links
        )  # fmt: skip
    assert street._street_key(corner_town) != street._street_key(manhattan_town)
    monkeypatch.setenv("XDG_CACHE_HOME", str(kept_cache))
    assert multiple(lambda: load_street(manhattan_town), turns=5) < 150  # about 25


def test_broken_or_forbidden_cache_is_no_error(corner_town: Town, own_cache: Path) -> None:
    load_street(corner_town)
    (kept,) = own_cache.rglob("street-*.npz")
    kept.write_bytes(b"PK\x03\x04 rubbish")
    assert len(load_street(corner_town).mesh.faces) > 0
    kept.unlink()
    own_cache.joinpath("wcsim").rmdir()
    own_cache.joinpath("wcsim").write_text("not a folder")
    assert len(load_street(corner_town).mesh.faces) > 0


@pytest.mark.proof
def test_helsinki_hangs_together() -> None:
    town = find_town("helsinki")
    assert largest_share(walkable_parts(read_net(town.net, town.file.origin_m), town.file.chair_ways)) >= 0.95
    wanted = {"passenger", "truck", "bus", "motorcycle", "bicycle", "pedestrian", "tram"}
    assert set(_demand_classes(town)) >= wanted
