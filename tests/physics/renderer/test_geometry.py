"""Geometry store, templates and instances."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.physics.renderer.render_oracle import actor, crowd
from tests.support.samples import USUAL_OUTLINE, strip_street
from wcsim.core.frames import quaternion_from_ypr
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.geometry import GeometryStore, _connected_parts
from wcsim.physics.renderer.instances import (
    ChairPose,
    _gait_phases,
    actor_instances,
    chair_instances,
    rotation_of,
)
from wcsim.physics.renderer.models.catalog import (
    FIGURES,
    GAIT_PHASES,
    POSTURES,
    STANDING,
    Template,
    _body_parts,
    actor_templates,
    template_of,
)
from wcsim.physics.renderer.models.paint import Paint
from wcsim.physics.sensors.camera import FreeCamera
from wcsim.physics.sensors.camera_geometry import look_along
from wcsim.types import ActorKind, ClassId, GroundPaint, StreetMesh

ANGLE = st.floats(-math.pi, math.pi)
LENS = Pinhole(width_px=160, height_px=120, focal_px=80.0, near_m=0.1, range_m=40.0)


@pytest.fixture(scope="module")
def table():
    return actor_templates()


def corners_of(table, t):
    vertices = table.vertices[table.vertices_of[t] : table.vertices_of[t + 1]].astype(float)
    return vertices[table.faces[table.faces_of[t] : table.faces_of[t + 1]]]


def test_regrouping_keeps_every_triangle_and_its_class(store):
    mesh = strip_street().mesh

    def rows(vertices, faces, classes):
        soup = np.c_[vertices[faces].reshape(len(faces), 9), classes]
        return soup[np.lexsort(soup.T)]

    mine = rows(store.arrays.vertices, store.global_faces(), store.arrays.face_class)
    assert np.array_equal(mine, rows(mesh.vertices_W_m, mesh.faces, mesh.face_class))


def test_a_store_joined_from_parts_draws_what_the_whole_draws():
    street = strip_street().mesh
    end = len(street.chunk_faces) - 1
    parts = [GeometryStore(chunks_of(street, chunks)) for chunks in (range(end // 2), range(end // 2, end))]
    nobody = actor_instances(())
    for x_m, yaw_rad in ((10.0, 0.0), (35.0, 0.4), (60.0, 2.5)):
        eye = look_along((x_m, 5.5, 1.2), yaw_rad, -0.2)
        whole = FreeCamera(street, LENS).look(eye, nobody)
        joined = FreeCamera(GeometryStore.joined(parts), LENS).look(eye, nobody)
        assert (joined.class_id == whole.class_id).mean() > 0.999  # equal depths are drawn in another order
        assert np.abs(joined.depth_m - whole.depth_m).max() < 1e-3
        assert len(np.unique(whole.class_id)) >= 4


def test_paint_changes_colours_on_the_road_alone_and_neither_depth_nor_class():
    street = strip_street().mesh
    line_m = np.array([[[x, -0.1, 0.01], [x + 3, -0.1, 0.01], [x + 3, 0.1, 0.01], [x, 0.1, 0.01]] for x in (0, 9, 18)])
    house_m = line_m + np.array([52.0, 12.0, 0.0])  # within a house, where nobody sees it
    quads_W_m = np.concatenate([line_m, house_m]).astype(np.float32)
    paint = GroundPaint(quads_W_m=quads_W_m, mark=np.zeros(len(quads_W_m), np.uint8))
    eye, walker = look_along((-4.0, 0.5, 1.2), 0.0, -0.2), actor_instances((actor(ActorKind.CAR, 12.0, 0.0),))
    plain = FreeCamera(street, LENS).look(eye, walker)
    painted = FreeCamera(replace(street, paint=paint), LENS).look(eye, walker)
    assert np.array_equal(plain.depth_m, painted.depth_m) and np.array_equal(plain.class_id, painted.class_id)
    changed = (plain.rgb != painted.rgb).any(axis=-1)
    assert changed.sum() > 20 and set(np.unique(plain.class_id[changed])) == {ClassId.ROAD}
    parts = [GeometryStore(replace(street, paint=paint.part(np.arange(6) % 2 == k))) for k in (0, 1)]
    joined = FreeCamera(GeometryStore.joined(parts), LENS).look(eye, walker)
    assert np.array_equal(joined.rgb, painted.rgb)


def chunks_of(mesh, chunks):
    """Some chunks of a mesh as one of its own."""
    faces = np.concatenate([mesh.faces[mesh.chunk_faces[c] : mesh.chunk_faces[c + 1]] for c in chunks])
    classes = np.concatenate([mesh.face_class[mesh.chunk_faces[c] : mesh.chunk_faces[c + 1]] for c in chunks])
    used, own = np.unique(faces, return_inverse=True)
    return StreetMesh(
        vertices_W_m=mesh.vertices_W_m[used],
        faces=own.reshape(-1, 3).astype(np.int32),
        face_class=classes,
        chunk_vertices=np.array([0, len(used)], np.int32),
        chunk_faces=np.array([0, len(faces)], np.int32),
    )


def test_spheres_hold_their_chunks_and_chunks_are_small(store):
    street = store.arrays
    assert len(street.spheres) > 4
    for c, sphere in enumerate(street.spheres):
        vertices = street.vertices[street.chunk_vertices[c] : street.chunk_vertices[c + 1]]
        faces = street.faces[street.chunk_faces[c] : street.chunk_faces[c + 1]]
        away = np.linalg.norm(vertices - sphere[:3], axis=1)
        assert away.max() <= sphere[3] < 40.0
        assert faces.min() == 0 and faces.max() == len(vertices) - 1


def test_templates_fill_the_unit_box(table):
    for t in range(Template.PEDESTRIAN):
        points = corners_of(table, t).reshape(-1, 3)
        assert points.min(axis=0) == pytest.approx([-0.5, -0.5, 0.0], abs=1e-6)
        assert points.max(axis=0) == pytest.approx([0.5, 0.5, 1.0], abs=1e-6)
    for figure in range(len(FIGURES)):
        first = Template.PEDESTRIAN + POSTURES * figure
        standing = corners_of(table, first + STANDING).reshape(-1, 3)
        assert np.ptp(standing, axis=0) == pytest.approx([1, 1, 1], abs=1e-6)
        for phase in range(GAIT_PHASES):  # strides reach out of the box, not further than its ball allows for
            points = corners_of(table, first + phase).reshape(-1, 3) * (0.25, 0.5, 1.75)
            away = np.linalg.norm(points - (0.0, 0.0, 0.875), axis=1)
            assert away.max() <= 0.54 * np.linalg.norm((0.25, 0.5, 1.75))
            assert np.ptp(points[:, 0]) > (0.6 if phase % 2 == 0 else 0.25)


@pytest.mark.parametrize(
    "template, most",
    [
        (Template.CAR, 150),
        (Template.BUS, 120),
        (Template.BICYCLE, 350),
        (Template.MOTORCYCLE, 350),
        (Template.SCOOTER, 350),
        (Template.PEDESTRIAN, 250),
    ],
)
def test_templates_keep_their_triangle_budget(table, template, most):
    assert table.faces_of[template + 1] - table.faces_of[template] <= most


def test_solids_are_closed_and_look_outward(table):
    """What the rasteriser needs to skip back faces: every edge of a piece is run once each way; decals lie on skin."""
    for t in range(len(table.faces_of) - 1):
        faces = table.faces[table.faces_of[t] : table.faces_of[t + 1]]
        edges = {}
        for face in faces.tolist():
            for k in range(3):
                edge = (face[k], face[(k + 1) % 3])
                assert edge not in edges, "two faces of one piece run an edge the same way"
                edges[edge] = True
        open_edges = sum((b, a) not in edges for a, b in edges)
        assert open_edges % 4 == 0 and open_edges <= 4 * 16  # four a decal
        corners = corners_of(table, t)
        volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
        assert volume > 0.0


def test_every_kind_has_a_template_and_its_classes(table):
    with_rider = {Template.MOTORCYCLE, Template.BICYCLE, Template.SCOOTER}
    for kind in ActorKind:
        t = template_of(kind)
        classes = set(table.face_class[table.faces_of[t] : table.faces_of[t + 1]].tolist())
        assert (ClassId.RIDER in classes) == (t in with_rider)
    chair = slice(table.faces_of[Template.WHEELCHAIR], table.faces_of[Template.WHEELCHAIR + 1])
    assert set(table.face_class[chair].tolist()) == {ClassId.PERSON, ClassId.DYNAMIC}


def test_a_seat_s_wheelchair_has_the_size_of_its_model_and_its_axle_at_the_origin():
    points = np.concatenate([piece.part.vertices_m for piece in _body_parts("WHEELCHAIR")])
    assert np.ptp(points, axis=0) == pytest.approx((1.12, 0.62, 1.45), abs=0.03)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    wheels = np.concatenate([p.part.vertices_m for p in _body_parts("WHEELCHAIR") if p.paint is Paint.TYRE])
    drive = wheels[wheels[:, 2] > 0.25]  # only the drive wheels are so high
    assert drive[:, 0].mean() - middle[0] == pytest.approx(-USUAL_OUTLINE.middle_x_m, abs=0.02)


@given(yaw=ANGLE, pitch=st.floats(-1.5, 1.5), roll=ANGLE)
def test_one_turn_in_three_spellings(yaw, pitch, roll):
    q = np.array(quaternion_from_ypr(yaw, pitch, roll))
    chair = ChairPose(seat=0, p_WB_m=np.array([3.0, -2.0, 0.5]), q_WB=q, outline=USUAL_OUTLINE)
    row = chair_instances([chair])
    T_WM = row.placed.T_WM[0]
    R = rotation_of(q)
    assert T_WM[:, :3] / USUAL_OUTLINE.size_lwh_m == pytest.approx(R, abs=1e-9)
    assert T_WM[:, 3] == pytest.approx(chair.p_WB_m + R @ (USUAL_OUTLINE.middle_x_m, 0.0, 0.0))
    forward = [math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), math.sin(pitch)]
    assert R[:, 0] == pytest.approx(forward, abs=1e-9)  # nose up is positive


def test_instances_keep_order_place_size_and_colour():
    people = crowd(5, count=12)
    first, again = actor_instances(people), actor_instances(people)
    assert len(first) == 12
    assert np.array_equal(first.p_W_m, [p.p_W_m for p in people])
    assert np.array_equal(first.scale_m, [p.size_lwh_m for p in people])
    assert np.array_equal(first.colour_seed, again.colour_seed)
    assert len(set(first.colour_seed.tolist())) == 12


@given(yaw=ANGLE, x=st.floats(-900, 900), y=st.floats(-900, 900), seed=st.integers(0, 2**32 - 1))
def test_a_walker_goes_through_all_phases_in_order(yaw, x, y, seed):
    ahead = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    places = np.array([x, y, 0.0]) + np.arange(0, 3.2, 0.13)[:, None] * ahead
    n = len(places)
    seeds, stride_m = np.full(n, seed, np.uint32), np.full(n, 1.4)
    phases = _gait_phases(places, np.full(n, yaw), np.full(n, 1.3), seeds, stride_m).tolist()
    steps = [(b - a) % 4 for a, b in itertools.pairwise(phases)]
    assert set(phases) == {0, 1, 2, 3} and set(steps) <= {0, 1}


def test_a_standing_person_keeps_still():
    places = np.column_stack([np.arange(0, 3, 0.1), np.zeros(30), np.zeros(30)])
    phases = _gait_phases(places, np.zeros(30), np.zeros(30), np.full(30, 7, np.uint32), np.full(30, 1.4))
    assert set(phases.tolist()) == {STANDING}


def test_kinds_are_told_apart_by_id_not_by_order():
    a, b = actor(ActorKind.CAR, 0, 0, number=1), actor(ActorKind.CAR, 5, 0, number=2)
    forward, backward = actor_instances([a, b]), actor_instances([b, a])
    assert forward.colour_seed[0] == backward.colour_seed[1]


def test_connected_parts_are_houses_and_crossings(store):
    mesh = strip_street().mesh
    thing = _connected_parts(mesh.vertices_W_m, mesh.faces, mesh.face_class)
    for class_id in (ClassId.BUILDING, ClassId.POLE, ClassId.CROSSWALK):
        assert len(set(thing[mesh.face_class == class_id].tolist())) == 1
    assert not set(thing[mesh.face_class == ClassId.BUILDING]) & set(thing[mesh.face_class == ClassId.POLE])
