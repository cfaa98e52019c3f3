"""Errors about whole things: their rates, how long they last, where they come from, and that nothing is kept."""

import math
import sys
from dataclasses import replace

import numba
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.physics.renderer.render_oracle import actor, crowd
from tests.physics.rig import shoot
from tests.physics.sensors.test_camera import plant
from tests.support.samples import strip_street
from tests.support.yardstick import multiple
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import CameraConfig, RunConfig
from wcsim.physics.buffers import Images, new_images
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import actor_instances
from wcsim.physics.renderer.raster import RasterRenderer
from wcsim.physics.sensors import object_noise
from wcsim.physics.sensors.camera import CameraRig, _CameraNoise
from wcsim.physics.sensors.camera_geometry import look_along, pinhole
from wcsim.physics.sensors.object_noise import ObjectNoise, object_rates
from wcsim.physics.sensors.pixel_noise import child, normal_quantiles
from wcsim.supervisor.palette import make_cityscapes_class_table
from wcsim.towns.scenario.town import find_town
from wcsim.types import ActorKind, ClassId, SeatSpec

LEVELS = ("good", "usual", "poor")
CAMERA = pinhole(CameraConfig())
USUAL = CameraConfig(name="front", width_px=80, height_px=60, noise={"objects": "usual"})


def law_of(level: str, **changes):
    return ObjectNoise(level, CAMERA, 0.1)._law._replace(**changes)


@numba.njit
def named(key, factors, c, law):
    out = np.empty(len(factors), np.int64)
    for tick in range(len(factors)):
        out[tick] = object_noise._name_of(key, tick, c, factors[tick], law)
    return out


def stretches(wrong: np.ndarray) -> np.ndarray:
    """How many ticks each stretch of errors lasts, but for those at both ends."""
    edges = np.flatnonzero(np.diff(wrong.astype(np.int8)))
    edges = edges[int(wrong[0]) :]
    return edges[1::2] - edges[: len(edges) // 2 * 2 : 2]


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", ["PERSON", "RIDER", "TRUCK", "KERB"])
def test_shares_confusion_and_durations_are_those_of_the_table(level, name):
    row, c = object_rates()[level]["wrong"][name], ClassId[name]
    seen = named(np.uint64(7), np.ones(1_000_000), int(c), law_of(level))
    lasts = stretches(seen != c)
    few = 5.0 / math.sqrt(len(lasts))  # five standard errors, as stretches are what is independent
    assert (seen != c).mean() == pytest.approx(sum(row.values()), rel=1.5 * few)
    for other, share in row.items():
        told = object_noise.MISSED if other == "missed" else ClassId[other]
        assert (seen == told).mean() == pytest.approx(share, rel=1.5 * few * math.sqrt(sum(row.values()) / share))
    assert 0.1 * lasts.mean() == pytest.approx(object_rates()[level]["wrong_s"], rel=few)
    # A chain with two states: what has lasted says nothing of how long it still lasts.
    longer = lasts[lasts > 5] - 5
    assert longer.mean() == pytest.approx(lasts.mean(), rel=1.6 * few)


@settings(max_examples=10)
@given(st.floats(1.0, 30.0), st.sampled_from([0.0, 0.3]), st.sampled_from(LEVELS), st.integers(0, 2**63))
@example(1.2, 0.0, "usual", 1)
@example(1.2, 0.3, "usual", 1)
def test_the_odds_grow_by_the_factor_and_one_that_drifts_and_jitters_hardly_shortens_errors(middle, by, level, key):
    law, c, tick = law_of(level), ClassId.PERSON, np.arange(400_000)
    jitter = 1.0 + by * np.random.default_rng(key).uniform(-1.0, 1.0, len(tick))
    factors = middle * 1.3 ** np.sin(tick / 80.0) * jitter
    odds = factors * law.wrong[c] / (1.0 - law.wrong[c])
    share, r = odds / (1.0 + odds), law.leaves / (1.0 - law.wrong[c])
    ends = r * share[:-1] * (1.0 - share[1:]) + (1.0 - r) * np.maximum(0.0, share[:-1] - share[1:])
    wrong = named(np.uint64(key), factors, int(c), law) != c
    lasts = stretches(wrong)
    few = 6.0 / math.sqrt(len(lasts))
    assert wrong.mean() == pytest.approx(share.mean(), rel=2.0 * few)
    assert lasts.mean() == pytest.approx(share.sum() / ends.sum(), rel=few)
    least = 0.9 if by == 0.0 else 0.4  # a word near its border is passed again and again
    assert lasts.mean() * law.tick_s > least * (1.0 - few) * object_rates()[level]["wrong_s"]


@pytest.mark.parametrize("level", LEVELS)
def test_shares_follow_from_the_published_figures_as_the_file_says(level):
    rates = object_rates()[level]

    def lost(percent):
        return (100.0 - percent) / (100.0 + percent)

    for name, percent in rates["iou_percent"].items():
        if name in rates["wrong"]:
            assert sum(rates["wrong"][name].values()) == pytest.approx(0.5 * lost(percent), abs=2e-4)
    kerb = (
        lost(72.7) * lost(rates["iou_percent"]["SIDEWALK"]) / lost(object_rates()["usual"]["iou_percent"]["SIDEWALK"])
    )
    assert sum(rates["wrong"]["KERB"].values()) == pytest.approx(0.5 * kerb, abs=2e-4)
    within = 1.0 - lost(74.50) / lost(72.11)  # of people: category and class of Fast-SCNN-D
    people = rates["wrong"]["PERSON"]
    assert people["RIDER"] / sum(people.values()) == pytest.approx(within, abs=2e-3)


def drawn(actors, T_CW):
    """The true picture of a street, with instances."""
    images, rows = new_images(320, 240, False, True), actor_instances(actors)
    RasterRenderer(GeometryStore(strip_street().mesh)).render(CAMERA, T_CW, rows, images)
    return images, rows


def copied(images: Images) -> Images:
    return replace(images, class_id=images.class_id.copy(), depth_m=images.depth_m.copy())


def test_a_missed_person_takes_the_class_behind_and_keeps_the_depth():
    T_CW = look_along((0.0, 5.5, 1.1), 0.0, -0.1)
    true, rows = drawn((actor(ActorKind.PEDESTRIAN, 5.0, 5.5, 0.12, number=1),), T_CW)
    empty, _ = drawn((), T_CW)
    noise = ObjectNoise("usual", CAMERA, 0.1)
    only = {"false_chance": 0.0, "border_px": 0.0, "stereo_share": 0.0}
    noise._law = noise._law._replace(**only, stands=np.ones(40, np.bool_), wrong=noise._law.wrong * 0.0)
    noise._law.wrong[ClassId.PERSON] = 0.5
    noise._law.upto[ClassId.PERSON, 0], noise._law.stands[ClassId.PERSON] = 1.0, False
    person, missed, whole = true.instance == 0, 0, 0
    for tick in range(200):
        out = copied(true)
        noise.lay_over(out, true.instance, T_CW, rows, tick, 0.12, 3)
        assert out.depth_m.tobytes() == true.depth_m.tobytes()
        assert np.array_equal(out.class_id[~person], true.class_id[~person])
        gone = (out.class_id != ClassId.PERSON)[person]
        assert gone.all() or not gone.any()
        missed, whole = missed + gone.all(), whole + 1
        if gone.all():
            assert (out.class_id == empty.class_id)[person].mean() > 0.8
    assert 0.2 < missed / whole < 0.8


def test_who_is_hidden_or_small_is_missed_more_and_who_is_whole_is_not():
    T_CW = look_along((0.0, 5.5, 1.1), 0.0, -0.1)

    def share(*actors):
        true, rows = drawn(actors, T_CW)
        wrong = []
        for key in range(600):
            args = (true.instance, true.depth_m, rows.colour_seed, np.uint64(key), 5, law_of("usual"))
            wrong.append(object_noise._names(*args)[0, ClassId.PERSON] != ClassId.PERSON)
        return np.mean(wrong)

    person = actor(ActorKind.PEDESTRIAN, 6.0, 5.5, 0.12, number=1)
    whole = share(person)
    assert whole == pytest.approx(0.065, abs=0.04)
    assert share(person, actor(ActorKind.CAR, 4.0, 7.3, 0.12, yaw=math.pi / 2, number=2)) > 2.0 * whole
    assert share(replace(person, p_W_m=np.array([35.0, 5.5, 0.12]))) > 1.5 * whole


def test_false_people_stand_as_often_and_as_long_as_the_table_says():
    law = law_of("poor", false_near_m=1.0, false_far_m=100.0)
    T_CW = look_along((0.0, 0.0, 20.0), 0.0, -math.pi / 2)  # down: an ellipse is seen at full size wherever it stands
    shown, lived = [], []
    for tick in range(6000):
        classes = np.full((240, 320), ClassId.ROAD, np.uint8)
        far = np.full((240, 320), 40.0, np.float32)
        object_noise._add_false(classes, far, T_CW, 0.0, np.uint64(5), 0.1 * tick, law)
        shown.append((classes == ClassId.PERSON).mean())
        lived.append(classes[::8, ::8] == ClassId.PERSON)
    half_m, tall_m = object_noise.FALSE_HALF_M, object_noise.FALSE_TALL_M
    ellipse_m2 = (
        math.pi * half_m * 0.5 * tall_m
    )  # on the picture and on the ground alike: nearer is larger, and leaves sooner
    assert np.reshape(shown, (-1, 10)).mean(0) == pytest.approx(np.full(10, np.mean(shown)), rel=0.25)  # at any phase
    assert np.mean(shown) == pytest.approx(object_rates()["poor"]["false_100_m2"] / 100.0 * ellipse_m2, rel=0.15)
    lasted = np.concatenate([stretches(row) for row in np.array(lived).reshape(6000, -1).T if row.any()])
    assert lasted.min() >= 3 and np.quantile(lasted, 0.97) <= 10 and lasted.mean() == pytest.approx(6.5, abs=0.6)


def test_borders_wander_by_their_deviation_and_slowly():
    law, edges = law_of("poor"), []
    half = np.full((240, 320), ClassId.ROAD, np.uint8)
    half[:, 180:] = ClassId.SIDEWALK
    for tick in range(4000):
        out = half.copy()
        object_noise._wander(out, np.uint64(9), 0.1 * tick / law.border_s, law, normal_quantiles())
        edges.append(out[[100, 160, 161, 0]].argmax(axis=1) - 180)  # between knots, of which there is one every 40
    moved = np.array(edges, float)
    assert moved[:, :2].std() == pytest.approx(math.sqrt(law.border_px**2 + 1 / 12), rel=0.1)
    assert np.corrcoef(moved[:-1, 0], moved[1:, 0])[0, 1] > 0.85
    assert abs(np.corrcoef(moved[:-25, 0], moved[25:, 0])[0, 1]) < 0.1
    assert np.corrcoef(moved[:, 1], moved[:, 2])[0, 1] > 0.95 and abs(np.corrcoef(moved[:, 0], moved[:, 3])[0, 1]) < 0.1


def test_stereo_fails_in_places_of_the_world_at_its_rate_and_for_its_time():
    law = law_of("poor", stereo_share=0.2, range_m=60.0)

    def failed(x_m, now):
        depth = np.full((240, 320), 10.0, np.float32)
        object_noise._fail_stereo(depth, look_along((x_m, 0.0, 10.0), 0.0, -math.pi / 2), np.uint64(4), now, law)
        return depth

    one = failed(0.0, 0.0)
    all_ = np.concatenate([failed(30.0 * place, 0.0).ravel() for place in range(40)])
    assert (all_ != 10.0).mean() == pytest.approx(0.2, abs=0.02)
    assert (all_ == 0.0).mean() == pytest.approx(0.1, abs=0.02)
    by = np.abs(all_[(all_ != 10.0) & (all_ > 0.0)] / 10.0 - 1.0)
    assert by.max() <= 0.4 + 1e-6 and by.mean() == pytest.approx(0.2, abs=0.02)
    block_m = law.block_px * 10.0 / CAMERA.focal_px  # the camera moves by whole blocks: the same places are seen
    moved = failed(5 * block_m, 0.0)
    assert (moved[5 * law.block_px :] == one[: -5 * law.block_px]).mean() > 0.97
    assert np.mean(failed(0.0, 0.05) == one) > 0.95 and np.mean((failed(0.0, 1.5) != 10.0) & (one != 10.0)) < 0.08


def shots(rig: CameraRig, seat: int, ticks) -> dict[int, bytes]:
    out = {}
    for tick in ticks:
        frame = shoot(rig, plant(x=0.1 * tick), crowd(3), tick=tick, seat=seat)[0]
        out[tick] = frame.depth_m.tobytes() + frame.class_id.tobytes()
    return out


def test_errors_are_those_of_seed_seat_camera_and_tick_alone(mesh):
    with CameraRig(mesh, (USUAL,), seats=3) as rig, CameraRig(mesh, (USUAL,), seats=1, threads=3) as other:
        for each in (rig, other):
            each.begin(5)
        seen = shots(rig, 0, range(12))
        assert shots(rig, 1, range(12)) != seen
        rig.begin(5)
        assert shots(rig, 0, (7,))[7] == seen[7], "nothing is kept from one picture to the next"
        assert shots(other, 0, range(11, -1, -1)) == seen
        rig.begin(6)
        assert shots(rig, 0, range(12)) != seen


def test_who_is_missed_is_counted_as_shown(mesh):
    exact = USUAL.model_copy(update={"noise": None})
    with CameraRig(mesh, (USUAL,), seats=1) as rig, CameraRig(mesh, (exact,), seats=1) as other:
        for each in (rig, other):
            shoot(each, plant(), crowd(3), tick=4, counted=True)
        assert rig.shown_px(0) == other.shown_px(0) != {}


def test_a_missed_surface_throws_no_shadow():
    noise = _CameraNoise(CameraConfig(noise={"depth": {"sigma_px": 0.0, "dropout": 0.0}}), CAMERA)
    images = new_images(320, 240, False)
    images.depth_m[:] = 5.0
    images.depth_m[:, 200:220] = 0.0
    noise.lay_over(images, 1)
    assert (images.depth_m[:, 40:200] > 4.0).all() and (images.depth_m[:, 200:220] == 0.0).all()


def test_errors_about_things_cost_less_than_those_of_pixels():
    T_CW = look_along((0.0, 5.5, 1.1), 0.0, -0.26)
    true, rows = drawn(crowd(4), T_CW)
    objects, pixels = ObjectNoise("usual", CAMERA, 0.1), _CameraNoise(CameraConfig(noise="typical"), CAMERA)
    ticks = iter(range(10**6))
    mine = multiple(lambda: objects.lay_over(copied(true), true.instance, T_CW, rows, next(ticks), 0.0, 1))
    assert mine < 0.9 * multiple(lambda: pixels.lay_over(copied(true), next(ticks)))  # about half


@pytest.mark.proof
def test_levels_lose_about_as_much_of_a_town_as_their_networks_do(monkeypatch):
    """In percent: intersection over union of each class, its part within 15 m, and what is published (-s prints it)."""
    lay_over, fold = ObjectNoise.lay_over, make_cityscapes_class_table().astype(np.int64)
    white = _CameraNoise(CameraConfig(noise={"classes": {}}), CAMERA)  # without it the borders of things are exact
    noises = {level: ObjectNoise(level, CAMERA, 0.1) for level in LEVELS}
    pairs = {level: np.zeros((2, 40, 40)) for level in LEVELS}

    def look(_, images, instance, T_CW, rows, tick, ground_m, key):
        near = (images.depth_m < 15.0).astype(np.int64)
        for level, noise in noises.items() if tick % 10 == 0 else ():
            for own in range(4):
                out = copied(images)
                lay_over(noise, out, instance, T_CW, rows, tick, ground_m, child(key, own))
                white.lay_over(out, child(child(key, own), tick))
                at = 1600 * near + 40 * fold[images.class_id] + fold[out.class_id]
                pairs[level] += np.bincount(at.ravel(), minlength=3200).reshape(2, 40, 40)

    monkeypatch.setattr(ObjectNoise, "lay_over", look)
    config = RunConfig(cameras=(CameraConfig(noise={"objects": "usual"}),))
    for town in ("helsinki", "monaco"):
        with World(find_town(town), config, (SeatSpec(),) * 8, 4) as world:
            for _ in range(400):
                next(rollout(world))
    found = {}
    for level, (far, near) in pairs.items():
        iou, by = [100.0 * np.diag(n) / np.maximum(1, n.sum(0) + n.sum(1) - np.diag(n)) for n in (far + near, near)]
        published = object_rates()[level]["iou_percent"]
        seen = [name for name in published if (far + near)[ClassId[name]].sum() > 0.0]
        found[level] = np.mean([(iou[ClassId[name]], published[name]) for name in seen], axis=0)
        rows = {name: np.round((iou[ClassId[name]], by[ClassId[name]], published[name]), 1) for name in seen}
        sys.stdout.write(f"{level} {found[level].round(1)} {rows}\n")
        assert abs(found[level][0] - found[level][1]) < 15.0
    assert found["poor"][0] < found["usual"][0] < found["good"][0]
