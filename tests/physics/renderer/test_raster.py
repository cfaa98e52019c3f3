"""The rasteriser against Embree, and its own promises."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.camera.embree import RayOracle, depth_agrees
from tests.physics.renderer.render_oracle import CAMERA, SIZES, actor, crowd
from tests.support.samples import strip_street
from wcsim.errors import ConfigError
from wcsim.physics.buffers import Images, new_images
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import actor_instances
from wcsim.physics.renderer.raster import RasterRenderer
from wcsim.physics.sensors.camera_geometry import look_along, look_at
from wcsim.types import ActorKind, ClassId

NOBODY = actor_instances(())
NO_IDS = np.zeros((240, 320), np.uint8)


def shot(renderer, T_CW, instances=NOBODY, camera=CAMERA, rgb=False):
    out = new_images(camera.width_px, camera.height_px, rgb)
    renderer.render(camera, T_CW, instances, out)
    return out


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_ray_casts_at_pixel_centres(store, raster, seed):
    instances = actor_instances(crowd(seed))
    oracle = RayOracle(store, instances)
    rng = np.random.default_rng(100 + seed)
    for _ in range(4):
        p = (rng.uniform(0, 60), rng.uniform(-6, 6), rng.uniform(0.7, 1.8))
        T_CW = look_along(p, rng.uniform(-math.pi, math.pi), rng.uniform(-0.4, 0.2))
        out, (depth, classes) = shot(raster, T_CW, instances), oracle.image(CAMERA, T_CW)
        assert (out.class_id == classes).mean() >= 0.999
        assert depth_agrees(out.depth_m, depth).mean() >= 0.999


def test_agrees_in_the_middle_of_a_crowd(store, raster):
    rng = np.random.default_rng(8)
    people = [
        actor(ActorKind.PEDESTRIAN, *rng.uniform(-1.2, 1.2, 2), yaw=rng.uniform(-3, 3), number=i) for i in range(40)
    ]
    instances = actor_instances([*people, actor(ActorKind.CAR, 1.5, 0.0, yaw=0.3)])
    oracle = RayOracle(store, instances)
    for yaw in np.linspace(0, 2 * math.pi, 8):
        T_CW = look_along((0.0, 0.0, 1.0), yaw, -0.2)
        out, (depth, classes) = shot(raster, T_CW, instances), oracle.image(CAMERA, T_CW)
        assert depth.min() < 0.3, "somebody must stand at the lens, or the near plane cuts nothing"
        assert out.depth_m.min() >= CAMERA.near_m * 0.999
        assert (out.class_id == classes).mean() >= 0.999
        assert depth_agrees(out.depth_m, depth).mean() >= 0.999


@given(
    x=st.floats(-5, 75), y=st.floats(-8, 8), z=st.floats(0.3, 12), yaw=st.floats(-math.pi, math.pi),
    pitch=st.floats(-1.5, 0.5), focal=st.floats(30, 400), seed=st.integers(0, 3),
)  # fmt: skip
@settings(max_examples=60)
def test_culling_drops_nothing_that_is_visible(x, y, z, yaw, pitch, focal, seed):
    store = GeometryStore(strip_street().mesh)
    camera = replace(CAMERA, width_px=96, height_px=72, focal_px=focal)
    T_CW, instances = look_along((x, y, z), yaw, pitch), actor_instances(crowd(seed))
    culled = shot(RasterRenderer(store), T_CW, instances, camera, rgb=True)
    drawn = shot(RasterRenderer(store, cull=False), T_CW, instances, camera, rgb=True)
    assert np.array_equal(culled.class_id, drawn.class_id)
    assert np.array_equal(culled.depth_m, drawn.depth_m)


def test_sky_has_its_class_and_the_range_as_depth(raster):
    out = shot(raster, look_along((0, 0, 1), 0.0, 1.2))
    assert (out.class_id == ClassId.SKY).all()
    assert (out.depth_m == np.float32(CAMERA.range_m)).all()


def test_depth_is_measured_along_the_axis_and_ends_at_the_range(raster):
    out = shot(raster, look_along((0, 0, 1.0), 0.0, 0.0))
    row = 200  # 1 m above a flat road: depth = height * focal / rows below the middle
    assert out.depth_m[row] == pytest.approx(CAMERA.focal_px / (row + 0.5 - 120), rel=1e-4)
    far = (out.class_id != ClassId.SKY).any(axis=1)
    assert out.depth_m[far].max() <= CAMERA.range_m
    assert out.depth_m[far & (out.depth_m[:, 160] < 40)][:, 160].max() > 30


@pytest.mark.parametrize("kind", list(ActorKind))
def test_every_kind_fills_the_box_of_its_actor(raster, kind):
    size = SIZES[kind]
    thing = actor_instances([actor(kind, 30.0, 0.0, 20.0, speed=0.0)])  # in the air, before the sky
    camera = Pinhole(width_px=1200, height_px=480, focal_px=900.0, near_m=0.1, range_m=40.0)
    middle_m = 20.0 + size[2] / 2
    full = shot(raster, look_at((30.0, -25.0, middle_m), (30.0, 0.0, middle_m)), thing, camera)
    rows, columns = np.nonzero(full.class_id != ClassId.SKY)
    # Seen from the side over 25 m: the silhouette lies between the near and the far side of the box.
    near, far = camera.focal_px / (25 - size[1] / 2), camera.focal_px / (25 + size[1] / 2)
    slack = 0.25 if kind is ActorKind.PEDESTRIAN else 0.0  # standing with the feet together
    assert size[0] * (far * (1 - slack)) - 2 <= np.ptp(columns) + 1 <= size[0] * near + 2
    assert size[2] * far * 0.97 - 2 <= np.ptp(rows) + 1 <= size[2] * near + 2
    expected = {
        ActorKind.CAR: {ClassId.CAR},
        ActorKind.TRUCK: {ClassId.TRUCK},
        ActorKind.BUS: {ClassId.BUS},
        ActorKind.TRAM: {ClassId.TRAIN},
        ActorKind.MOTORCYCLE: {ClassId.MOTORCYCLE, ClassId.RIDER},
        ActorKind.BICYCLE: {ClassId.BICYCLE, ClassId.RIDER},
        ActorKind.SCOOTER: {ClassId.MOTORCYCLE, ClassId.RIDER},
        ActorKind.PEDESTRIAN: {ClassId.PERSON},
        ActorKind.WHEELCHAIR: {ClassId.DYNAMIC, ClassId.PERSON},
        ActorKind.OTHER: {ClassId.DYNAMIC},
    }[kind]
    assert set(full.class_id[rows, columns].tolist()) == expected


def test_an_actor_faces_its_way_with_the_nose_up(raster):
    camera = Pinhole(width_px=400, height_px=300, focal_px=300.0, near_m=0.1, range_m=60.0)
    T_CW = look_at((30.0, -12.0, 1.0), (30.0, 0.0, 1.0))  # looks north, east is right

    def image(yaw, pitch):
        rider = actor_instances([actor(ActorKind.SCOOTER, 30.0, 0.0, 0.5, yaw, pitch, size=(3.0, 0.8, 1.8))])
        return shot(raster, T_CW, rider, camera).class_id == ClassId.MOTORCYCLE

    def handlebar_column(scooter):
        return np.argwhere(scooter)[0, 1]  # the first row from above

    assert handlebar_column(image(0.0, 0.0)) > 210
    assert handlebar_column(image(math.pi, 0.0)) < 190
    wheels, right = image(0.0, 0.3), np.arange(400) > 200
    assert np.argwhere(wheels & right)[:, 0].max() < np.argwhere(wheels & ~right)[:, 0].max() - 10


def test_the_same_picture_twice_and_with_or_without_colours(raster):
    instances, T_CW = actor_instances(crowd(3)), look_along((5, 5.5, 1.1), 0.1, -0.2)
    first, second = shot(raster, T_CW, instances, rgb=True), shot(raster, T_CW, instances, rgb=True)
    plain = shot(raster, T_CW, instances)
    assert np.array_equal(first.rgb, second.rgb) and np.array_equal(first.depth_m, second.depth_m)
    assert np.array_equal(first.depth_m, plain.depth_m) and np.array_equal(first.class_id, plain.class_id)
    assert plain.rgb is None


def test_colours_tell_ground_sky_stripes_and_paints(raster):
    sky = shot(raster, look_along((0, 0, 1), 0.0, 1.2), rgb=True).rgb
    assert (sky[..., 2] > sky[..., 0]).all()
    stripes = shot(raster, look_along((40.0, 0.0, 3.0), 0.0, -math.pi / 2), rgb=True)
    zebra = stripes.rgb[stripes.class_id == ClassId.CROSSWALK].mean(axis=1)
    assert 0.4 < (zebra > 190).mean() < 0.6 and (zebra < 140).any()
    colours = set()
    for number in range(30):
        car = actor_instances([actor(ActorKind.CAR, 6.0, 0.0, number=number)])
        colours.add(tuple(shot(raster, look_along((0, 0, 1), 0.0, -0.1), car, rgb=True).rgb[125, 160].tolist()))
    assert len(colours) >= 8


def test_zebra_stripes_lie_across_the_way_people_walk(raster):
    """The crossing of the sample is 4 m along the road and 8 m across it: walking is along y, bars along x."""
    down = shot(raster, look_along((40.0, 0.0, 3.0), math.pi / 2, -math.pi / 2), rgb=True)
    bright = down.rgb.mean(axis=2)  # up in the image is +y
    assert np.abs(np.diff(bright[:, 160])).sum() > 5 * np.abs(np.diff(bright[120, 130:190])).sum()


def test_draws_from_threads_into_their_own_buffers(raster):
    from concurrent.futures import ThreadPoolExecutor

    instances = actor_instances(crowd(2))
    poses = [look_along((x, 5.5, 1.1), 0.2, -0.2) for x in range(0, 32)]
    alone = [shot(raster, T_CW, instances, rgb=True) for T_CW in poses]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda T_CW: shot(raster, T_CW, instances, rgb=True), poses))
    assert all(np.array_equal(a.rgb, b.rgb) for a, b in zip(alone, together, strict=True))


@pytest.mark.parametrize(
    "out",
    [
        Images(depth_m=np.zeros((10, 10), np.float32), class_id=np.zeros((10, 10), np.uint8)),
        Images(depth_m=np.zeros((240, 320)), class_id=NO_IDS),
        Images(depth_m=np.zeros((240, 640), np.float32)[:, ::2], class_id=NO_IDS),
        replace(new_images(320, 240, rgb=False), rgb=np.zeros((240, 320, 4), np.uint8)),
        replace(new_images(320, 240, rgb=False), instance=np.zeros((240, 320), np.int64)),
    ],
)
def test_refuses_buffers_that_do_not_fit(raster, out):
    with pytest.raises(ConfigError, match="new_images"):
        raster.render(CAMERA, look_along((0, 0, 1), 0.0, 0.0), NOBODY, out)


def colours_of(picture, rgb):
    return np.abs(picture.astype(int) - rgb).max(axis=-1) < 30


def test_the_stones_of_kerbs_tell_their_height_in_colours_alone(raster):
    high, low = (236, 128, 26), (150, 186, 222)
    along, over = (shot(raster, look_along((x, 6.0, 1.6), -math.pi / 2, -0.5), rgb=True) for x in (20.0, 40.0))
    stones = colours_of(along.rgb, high)
    beside = {ClassId.SIDEWALK, ClassId.KERB, ClassId.ROAD}
    assert stones.sum() > 20 and set(np.unique(along.class_id[stones])) <= beside
    middle = over.rgb[:, CAMERA.width_px // 2 - 3 : CAMERA.width_px // 2 + 3]
    assert not colours_of(middle, high).any(), "a crossing is flush"
    ramp = shot(raster, look_along((37.0, 6.0, 1.6), -math.pi / 2, -0.5), rgb=True)
    assert colours_of(ramp.rgb, low).any() and colours_of(ramp.rgb, high).any(), "it rises beside the crossing"


def test_near_ground_has_a_grain(raster):
    out = shot(raster, look_along((10.0, 5.5, 1.2), 0.0, -0.3), rgb=True)
    for kind in (ClassId.SIDEWALK, ClassId.ROAD, ClassId.TERRAIN):
        near = (out.class_id == kind) & (out.depth_m < 6.0)
        assert near.sum() > 100 and len(np.unique(out.rgb[near], axis=0)) > 10


def test_who_stands_on_the_ground_darkens_it_and_nothing_else(raster):
    T_CW = look_along((5.0, 0.0, 1.6), 0.0, -0.3)
    alone, beside = (
        shot(raster, T_CW, actor_instances(who), rgb=True) for who in ((), (actor(ActorKind.PEDESTRIAN, 9.0, 0.0),))
    )
    ground = (beside.class_id == alone.class_id) & (alone.class_id == ClassId.ROAD)
    change = beside.rgb.astype(int).sum(axis=-1) - alone.rgb.astype(int).sum(axis=-1)
    darker = ground & (change < 0)
    assert darker.sum() > 10 and not (ground & (change > 0)).any()
    assert np.abs(alone.depth_m[darker] - 4.0).max() < 1.5
