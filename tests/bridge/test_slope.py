"""Actors and wheelchairs on land that is not level."""

import gzip
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.support.worlds import follow, open_world, push
from tests.towns.ground.rays import normals
from tests.towns.made.nets import hilly
from wcsim.bridge.mirror import on_ground
from wcsim.bridge.world import World
from wcsim.types import F64, ActorKind, SeatSpec, StartSpec
from wcsim.types.street import StreetMesh

RIDERS = """<routes>
    <vType id="car" vClass="passenger"/><vType id="bike" vClass="bicycle"/><vType id="walker" vClass="pedestrian"/>
    <person id="along" type="walker" depart="0" departPos="20"><walk edges="WC CE" arrivalPos="40"/></person>
    <person id="across" type="walker" depart="0" departPos="30"><walk edges="SC CN" arrivalPos="30"/></person>
    <vehicle id="car.east" type="car" depart="0" departSpeed="max"><route edges="WC CE"/></vehicle>
    <vehicle id="bike.west" type="bike" depart="0" departSpeed="max"><route edges="EC CW"/></vehicle>
    <vehicle id="bike.south" type="bike" depart="1" departSpeed="max"><route edges="NC CS"/></vehicle>
    <vehicle id="car.north" type="car" depart="2" departSpeed="max"><route edges="SC CN"/></vehicle>
</routes>"""


def land_m(x: float, y: float) -> float:
    return 210.0 + 0.08 * x + 0.05 * y + 1.5 * math.sin(x / 25.0)


@pytest.fixture(scope="module")
def slope(corner: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The corner town on the side of a hill, with cyclists."""
    town = tmp_path_factory.mktemp("slope") / "slope"
    shutil.copytree(corner, town)
    (net,) = town.glob("*.net.xml.gz")
    plain = town / "plain.xml"
    plain.write_bytes(gzip.decompress(net.read_bytes()))
    net.write_bytes(gzip.compress(hilly(plain, plain, land_m).read_bytes()))
    plain.unlink()
    (routes,) = town.glob("*.rou.xml")
    routes.write_text(RIDERS)
    return town


def surface_m(mesh: StreetMesh, points_W_m: F64) -> F64:
    """Height (n,) of the mesh's lowest face under each point (n, 3), which is the ground."""
    corners = mesh.vertices_W_m[mesh.faces].astype(np.float64)
    normal = normals(corners)
    flat = np.flatnonzero(normal[:, 2] > 1e-9)
    tree = shapely.STRtree(shapely.polygons(corners[flat][:, :, :2]))
    point, face = tree.query(shapely.points(points_W_m[:, :2]), predicate="intersects")
    face = flat[face]
    ahead = points_W_m[point, :2] - corners[face, 0, :2]
    z_m = corners[face, 0, 2] - (normal[face, :2] * ahead).sum(axis=1) / normal[face, 2]
    found = np.full(len(points_W_m), np.inf)
    np.minimum.at(found, point, z_m)
    return found


def start(x: float, y: float, heading: float) -> SeatSpec:
    return SeatSpec(start=StartSpec(p_W_m=(x, y), yaw_rad=heading, goal_W_m=(40.0, -4.5)))


def test_actors_stand_on_the_slope_and_lean_with_it(slope: Path) -> None:
    with open_world(slope, "world.mirror_radius_m=80", spec=start(-22.0, -4.5, 0.0)) as world:
        mesh, seen, slopes = world.street.mesh, set(), []
        for _ in range(120):
            actors = follow(world).actors
            seen |= {actor.id for actor in actors}
            points = np.array([actor.p_W_m for actor in actors]).reshape(-1, 3)
            assert (np.abs(points[:, 2] - surface_m(mesh, points)) < 0.02).all()
            for actor in actors:
                half = 0.5 * actor.size_lwh_m[0] * np.array([math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)])
                rise = float(np.diff(_lands_m(world, actor.p_W_m[:2] + np.array([-half, half])))[0])
                if actor.kind is ActorKind.PEDESTRIAN:
                    assert actor.pitch_rad == 0.0
                else:
                    assert actor.pitch_rad == pytest.approx(math.atan2(rise, actor.size_lwh_m[0]), abs=1e-6)
                    slopes.append(actor.pitch_rad)
        assert seen == {"p:along", "p:across", "v:car.east", "v:car.north", "v:bike.west", "v:bike.south"}
        assert max(slopes) > 0.04 and min(slopes) < -0.04


def _lands_m(world: World, points_W_m: F64) -> F64:
    return world.street.grid.height_at(points_W_m) - world.street.grid.raised_at(points_W_m)


def test_who_is_on_a_bridge_keeps_sumos_height(slope: Path) -> None:
    with open_world(slope, spec=start(-22.0, -4.5, 0.0)) as world:
        follow(world)
        actor = next(actor for actor in world.snapshot.actors if actor.kind is ActorKind.CAR)
        (low,) = on_ground((actor,), world.street.grid)
        assert np.allclose(low.p_W_m, actor.p_W_m)
        deck = replace(actor, p_W_m=actor.p_W_m + np.array([0.0, 0.0, 6.0]), pitch_rad=0.03)
        (high,) = on_ground((deck,), world.street.grid)
        assert high.p_W_m[2] == deck.p_W_m[2] and high.pitch_rad == 0.03


@pytest.mark.parametrize("heading", [0.0, 1.2, 2.6, -1.9])
def test_a_wheelchair_starts_on_a_slope_without_a_jump(slope: Path, heading: float) -> None:
    with open_world(slope, spec=start(-30.0, -4.6, heading)) as world:
        before, peak = world.seats[0].chair.state(), 0.0
        for _ in range(3):
            peak = max(peak, float(np.abs(push(world).sensors.imu.accel_peak_mps2).max()))
        after = world.seats[0].chair.state()
        ahead = 0.3 * np.array([math.cos(heading), math.sin(heading)])
        rise = float(np.diff(_lands_m(world, before.p_WB_m[:2] + np.array([-ahead, ahead])))[0])
        assert before.pitch_rad == pytest.approx(math.atan2(rise, 0.6), abs=0.01)
        assert np.linalg.norm(after.p_WB_m - before.p_WB_m) < 0.02
        assert peak < 1.0
