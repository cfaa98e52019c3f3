"""The engine: the street as bodies, roles, limits, refusals; and the plant that is loaded into it."""

import numpy as np
import pybullet
import pytest

from tests.physics.rig import flat_street, mesh, ray_down, rig, step_street
from tests.support.samples import KERB_M, strip_street
from wcsim.config import ChairConfig
from wcsim.errors import ConfigError, PhysicsError
from wcsim.physics.engine import Engine, Role, _split, _tidy
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.types import ClassId


def test_the_street_is_a_few_bodies_and_stands_where_the_mesh_says(engine):
    engine.add_street(strip_street().mesh)
    assert engine.bullet.getNumBodies() == 4
    roles = [engine.tag_of(body).role for body in range(4)]
    assert sorted(role.value for role in roles) == ["building", "ground", "kerb", "static"]
    heights = ray_down(engine, np.array([[10.0, 0.0], [10.0, 5.5], [60.0, 14.0], [25.1, 6.7], [500.0, 0.0]]))
    assert heights == pytest.approx([0.0, KERB_M, 9.0, 5.0, -np.inf], abs=1e-6)


def test_a_closed_engine_leaves_nothing_behind():
    with Engine(1 / 240) as engine:
        number = engine.bullet.number
    engine.close()
    assert pybullet.getConnectionInfo(physicsClientId=number)["isConnected"] == 0


def test_a_mesh_over_the_limits_is_cut_into_few_pieces(monkeypatch):
    monkeypatch.setattr("wcsim.physics.engine.MAX_FACES", 100)
    count = 260
    xs = np.arange(count + 1, dtype=float)
    vertices = np.concatenate([np.c_[xs, 0 * xs, 0 * xs], np.c_[xs, 0 * xs + 1, 0 * xs]])
    k = np.arange(count)
    faces = np.concatenate([np.c_[k, k + 1, k + count + 1], np.c_[k + 1, k + count + 2, k + count + 1]])
    parts = list(_split(_tidy(vertices, faces)))
    assert len(parts) == 8 and max(len(part.faces) for part in parts) <= 100
    assert sum(len(part.faces) for part in parts) == 2 * count
    sides = [np.diff(part.vertices_m[part.faces], axis=1) for part in parts]
    assert sum(np.abs(np.cross(side[:, 0], side[:, 1])).sum() / 2 for side in sides) == pytest.approx(count)


def test_seams_are_welded_and_slivers_go():
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1.00001, 0, 0], [1, 1, 0], [0, 1.00002, 0], [2, 0, 0]]
    tidy = _tidy(np.array(corners, float), np.array([[0, 1, 2], [3, 4, 5], [0, 3, 6]]))
    assert len(tidy.faces) == 2  # the third has no height
    assert len(tidy.vertices_m) == 4


def test_a_mesh_that_cannot_be_used_is_refused(engine):
    good = flat_street()
    for vertices, faces, classes in (
        (good.vertices_W_m * np.nan, good.faces, good.face_class),
        (good.vertices_W_m, good.faces + 100, good.face_class),
        (good.vertices_W_m[:, :2], good.faces, good.face_class),
    ):
        with pytest.raises(PhysicsError, match="street mesh"):
            engine.add_street(mesh(vertices, faces, classes))


def test_steps_and_ids_out_of_bounds_are_refused(engine):
    with pytest.raises(PhysicsError, match="physics step"):
        Engine(0.1)
    with pytest.raises(PhysicsError, match="solver_iterations"):
        Engine(1 / 240, solver_iterations=0)
    with pytest.raises(PhysicsError, match="unknown"):
        engine.tag_of(77)


def test_an_empty_street_is_no_street(engine):
    engine.add_street(mesh(np.zeros((0, 3)), np.zeros((0, 3)), ClassId.ROAD))
    assert engine.bullet.getNumBodies() == 0


def test_masses_and_centre_of_mass_are_those_asked_for():
    with rig(step_street(0.0), user_mass_kg=120.0, com_height_m=0.6) as r:
        body, bullet = r.chair.body_id, r.engine.bullet
        masses = [bullet.getDynamicsInfo(body, -1)[0]]
        middles = [bullet.getBasePositionAndOrientation(body)[0]]
        for link in range(bullet.getNumJoints(body)):
            masses.append(bullet.getDynamicsInfo(body, link)[0])
            middles.append(bullet.getLinkState(body, link, computeForwardKinematics=1)[0])
    assert sum(masses) == pytest.approx(230.0)
    whole = np.average(middles, axis=0, weights=masses)
    assert whole == pytest.approx([r.chair.spec.mass.com_x_m, 0.0, 0.6], abs=0.002)


def test_wheels_are_round(on_flat):
    shapes = {
        on_flat.engine.bullet.getCollisionShapeData(on_flat.chair.body_id, link)[0][2]
        for name, link in on_flat.chair._body.links.items()
        if name.startswith(("wheel", "caster"))
    }
    assert shapes == {pybullet.GEOM_CYLINDER}  # a hull of 32 corners would say GEOM_MESH


def test_roles_cover_every_class_of_the_street(engine):
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    found = {}
    for class_id in ClassId:
        before = engine.bullet.getNumBodies()
        engine.add_street(mesh(corners, [[0, 1, 2]], class_id))
        found[class_id] = engine.tag_of(before).role
    assert {c for c, role in found.items() if role is Role.KERB} == {ClassId.KERB, ClassId.LOWERED_KERB}
    assert found[ClassId.CROSSWALK] is found[ClassId.TERRAIN] is Role.GROUND
    assert found[ClassId.FENCE] is Role.BUILDING and found[ClassId.POLE] is Role.STATIC


def test_only_known_plants():
    assert plant_spec(ChairConfig()).wheel.radius_m == 0.178
    with pytest.raises(ConfigError, match="expected one of: mwd, rwd"):
        plant_spec(ChairConfig(plant="tank"))
