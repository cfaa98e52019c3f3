"""The reference back end sees what the rasteriser sees, at its own sample points; and the rasteriser is much faster."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.camera import compare
from benchmarks.camera.compare import compare_renderers, pooled
from benchmarks.camera.embree import depth_agrees
from tests.physics.renderer.render_oracle import CAMERA, actor, crowd
from tests.support.samples import strip_street
from tests.towns.ground.rays import normals
from wcsim.errors import ConfigError
from wcsim.physics.buffers import new_images
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import actor_instances
from wcsim.physics.renderer.raster import RasterRenderer
from wcsim.physics.renderer.tiny_renderer import TinyRenderer, corner_shift
from wcsim.physics.sensors.camera_geometry import look_along
from wcsim.types import ActorKind, ClassId


@pytest.fixture(scope="module")
def store():
    """The sample street with its kerbs turned towards the road: TinyRenderer draws front faces only."""
    mesh = strip_street().mesh
    corners = mesh.vertices_W_m[mesh.faces]
    normal = normals(corners)
    kerb = np.isin(mesh.face_class, (ClassId.KERB, ClassId.LOWERED_KERB))
    wrong = kerb & (normal[:, 1] * corners[:, 0, 1] > 0.0)
    faces = mesh.faces.copy()
    faces[wrong] = faces[wrong][:, ::-1]
    return GeometryStore(replace(mesh, faces=faces))


def poses_outside(actors, seed, count):
    """Camera poses that are inside nobody."""
    rng = np.random.default_rng(seed)
    poses = []
    while len(poses) < count:
        p = np.array([rng.uniform(0, 60), rng.uniform(-6, 6), rng.uniform(0.7, 1.8)])
        reach = [math.hypot(*a.size_lwh_m[:2]) / 2 + 0.3 - math.dist(a.p_W_m[:2], p[:2]) for a in actors]
        if max(reach) < 0.0:
            poses.append(look_along(p, rng.uniform(-math.pi, math.pi), rng.uniform(-0.4, 0.2)))
    return poses


def test_agrees_with_the_rasteriser(store):
    actors = crowd(1)
    instances, raster = actor_instances(actors), RasterRenderer(store)
    classes, depths = [], []
    with TinyRenderer(store) as tiny:
        for T_CW in poses_outside(actors, 5, 12):
            mine, other = new_images(320, 240, False), new_images(320, 240, False)
            raster.render(CAMERA, corner_shift(T_CW, CAMERA.focal_px), instances, mine)
            tiny.render(CAMERA, T_CW, instances, other)
            classes.append((mine.class_id == other.class_id).mean())
            depths.append(depth_agrees(mine.depth_m, other.depth_m).mean())
    assert np.mean(classes) >= 0.999 and np.mean(depths) >= 0.995


def test_bodies_follow_the_instances_and_leave_again(store):
    with TinyRenderer(store) as tiny:
        T_CW, out = look_along((0, 0, 1), 0.0, -0.1), new_images(320, 240, True)
        tiny.render(CAMERA, T_CW, actor_instances([actor(ActorKind.CAR, 8, 0), actor(ActorKind.CAR, 8, 3)]), out)
        both = (out.class_id == ClassId.CAR).sum()
        tiny.render(CAMERA, T_CW, actor_instances([actor(ActorKind.CAR, 8, 3)]), out)
        one = (out.class_id == ClassId.CAR).sum()
        tiny.render(CAMERA, T_CW, actor_instances([]), out)
        assert both > one > 0 and (out.class_id != ClassId.CAR).all()
        assert out.rgb is not None and out.rgb.std() > 5
        tiny.close()  # a second close does nothing


def test_the_rasteriser_is_many_times_faster_on_the_same_pictures(store):
    actors = crowd(1)
    pictures = compare_renderers(store, CAMERA, poses_outside(actors, 3, 4), actor_instances(actors), rounds=2)
    result = pooled(pictures)
    assert result.ratio_vs_tiny > 10.0  # a scene of a few thousand triangles; real towns have many more
    assert result.tiny.same_class >= 0.999 and result.tiny.same_depth >= 0.995
    assert result.embree is not None and min(result.embree.same_class, result.embree.same_depth) >= 0.999
    assert result.pictures == 4 and 0.0 < result.rgb_extra_ms < result.tiny_ms_median
    assert min(p.ms for p in pictures) <= result.ms_median <= max(p.ms for p in pictures)


def test_without_embree_its_column_stays_empty(store, monkeypatch):
    monkeypatch.setattr(compare, "has_embree", lambda: False)
    pose = look_along((10.3, 0.2, 1), 0.1, -0.2)
    result = pooled(compare_renderers(store, CAMERA, [pose], actor_instances([]), rounds=1))
    assert result.embree is None and result.tiny.same_class > 0.99


def test_a_wrong_picture_does_not_agree(store, monkeypatch):
    faces = store.arrays.faces.copy()
    faces[::7] = 0  # every seventh triangle of the street is lost
    monkeypatch.setattr(store, "arrays", store.arrays._replace(faces=faces))
    raster = RasterRenderer(store)
    monkeypatch.undo()
    monkeypatch.setattr(compare, "RasterRenderer", lambda _: raster)
    poses = [look_along((10.3, 0.2, 1), yaw, -0.2) for yaw in (0.1, 2.0)]
    result = pooled(compare_renderers(store, CAMERA, poses, actor_instances([]), rounds=1))
    assert result.embree is not None
    assert max(result.embree.same_depth, result.tiny.same_depth) < 0.995


def test_a_comparison_needs_something_to_compare(store):
    with pytest.raises(ConfigError, match="at least one"):
        compare_renderers(store, CAMERA, [], actor_instances([]))
    with pytest.raises(ConfigError, match="at least one"):
        pooled([])
