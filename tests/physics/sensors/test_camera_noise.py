"""The errors of cameras: stereo depth, lost pixels, frayed classes, grainy colours, and their keys."""

import itertools
import math

import numpy as np
import pytest

from tests.physics.rig import shoot
from tests.physics.sensors.test_camera import plant
from tests.support.yardstick import multiple
from wcsim.config import CameraConfig
from wcsim.physics.buffers import Images
from wcsim.physics.sensors.camera import CameraRig, _CameraNoise
from wcsim.physics.sensors.camera_geometry import pinhole
from wcsim.physics.sensors.pixel_noise import child, normals
from wcsim.types import ClassId

QUIET = {"sigma_px": 0.0, "step_px": 0.0, "shadow": False, "dropout": 0.0, "grazing_dropout": 0.0, "z_min_m": 0.0}


def camera(noise, **changes) -> CameraConfig:
    return CameraConfig(**{"noise": noise, **changes})


def stereo(**changes) -> CameraConfig:
    """A camera with one error of depth, or those given."""
    return camera({"depth": {**QUIET, **changes}})


def laid_over(config: CameraConfig, depth_m=None, class_id=None, rgb=None) -> Images:
    """Noisy copies of the given pictures."""
    shape = next(image.shape[:2] for image in (depth_m, class_id, rgb) if image is not None)
    images = Images(
        depth_m=np.full(shape, 5.0, np.float32) if depth_m is None else np.array(depth_m, np.float32),
        class_id=np.full(shape, ClassId.ROAD, np.uint8) if class_id is None else np.array(class_id, np.uint8),
        rgb=None if rgb is None else np.array(rgb, np.uint8),
    )
    _CameraNoise(config, pinhole(config)).lay_over(images, 1)
    return images


def wall(z_m: float) -> np.ndarray:
    return np.full((240, 320), z_m, np.float32)


def test_normal_numbers_are_normal():
    drawn = normals(5, 200_000)
    assert abs(drawn.mean()) < 0.01 and drawn.std() == pytest.approx(1.0, abs=0.01)
    assert (drawn**4).mean() == pytest.approx(3.0, abs=0.1)
    assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 0.01
    assert abs(np.corrcoef(drawn, normals(child(5, 0), 200_000))[0, 1]) < 0.01


@pytest.mark.parametrize("z_m", [2.0, 4.0, 6.0])
def test_depth_spreads_with_its_square(z_m):
    got = laid_over(stereo(sigma_px=0.08), wall(z_m)).depth_m
    focal_px = 0.5 * 848 / math.tan(math.radians(87.0) / 2)
    expected = z_m**2 * 0.08 / (focal_px * 0.05)
    assert got.std() == pytest.approx(expected, rel=0.03)
    assert got.mean() == pytest.approx(z_m, abs=max(0.01 * z_m, expected**2))


def test_disparity_comes_in_steps():
    got = np.unique(laid_over(stereo(sigma_px=0.3, step_px=1 / 32), wall(6.0)).depth_m.astype(float))
    focal_px = 0.5 * 848 / math.tan(math.radians(87.0) / 2)
    steps = focal_px * 0.05 / got * 32
    assert len(got) > 10 and np.abs(steps - np.rint(steps)).max() < 1e-3


@pytest.mark.parametrize("near_m, far_m, baseline_m", [(1.0, 5.0, 0.05), (2.0, 8.0, 0.12), (0.6, 40.0, 0.05)])
def test_the_shadow_is_on_the_left_of_what_is_near_and_as_wide_as_it_must_be(near_m, far_m, baseline_m):
    scene = wall(far_m)
    scene[80:160, 150:200] = near_m
    config = stereo(shadow=True, baseline_m=baseline_m)
    lost = laid_over(config, scene).depth_m == 0.0
    width = pinhole(config).focal_px * baseline_m * (1 / near_m - 1 / far_m)
    edge = math.ceil(pinhole(config).focal_px * baseline_m / far_m)  # where the right imager's picture ends
    for row in (80, 120, 159):
        columns = np.flatnonzero(lost[row, edge:]) + edge
        assert columns[-1] == 149 and np.array_equal(columns, np.arange(columns[0], 150))
        assert len(columns) == pytest.approx(width, abs=0.51)
    assert not lost[:80, edge:].any() and not lost[160:, edge:].any()


def test_what_the_right_imager_cannot_see_is_lost():
    lost = laid_over(stereo(shadow=True), wall(1.0)).depth_m == 0.0
    width = round(pinhole(CameraConfig()).focal_px * 0.05)
    assert lost[:, : width - 1].all() and not lost[:, width + 1 :].any()


def test_a_wall_seen_at_an_angle_hides_nothing_of_itself():
    columns = np.broadcast_to(1.0 / np.linspace(1 / 8.0, 1 / 0.8, 320), (240, 320))
    for scene in (columns, columns[:, ::-1]):
        lost = laid_over(stereo(shadow=True), scene).depth_m == 0.0
        assert not lost[:, 12:].any()


def test_what_is_too_near_and_what_is_nothing():
    scene = wall(0.25)
    scene[:, 100:200], scene[:, 200:] = 0.3, 40.0
    got = laid_over(stereo(z_min_m=0.28, sigma_px=0.01), scene).depth_m
    assert (got[:, :100] == 0.0).all() and (got[:, 100:200] > 0.28).all()
    assert (got[:, 200:] == 40.0).all()  # nothing is hit there: no error, no hole


def test_far_disparities_end_at_the_range():
    got = laid_over(stereo(sigma_px=0.2), wall(35.0)).depth_m
    assert (got == 40.0).any() and got.max() == 40.0 and got.min() > 5.0


@pytest.mark.parametrize("patch_px", [1, 5])
def test_patches_are_lost_at_their_rate(patch_px):
    lost = laid_over(stereo(dropout=0.05, patch_px=patch_px), wall(3.0)).depth_m == 0.0
    assert lost.mean() == pytest.approx(0.05, abs=0.01)
    corners = lost[::patch_px, ::patch_px]
    whole = np.kron(corners, np.ones((patch_px, patch_px), bool))[:240, :320]
    assert np.array_equal(whole, lost)


def test_flatly_seen_ground_is_lost_and_other_ground_is_not():
    config = CameraConfig(pitch_deg=0.0, noise={"depth": {**QUIET, "grazing_deg": 6.0, "grazing_dropout": 0.4}})
    below = np.maximum((np.arange(240) + 0.5 - 120) / pinhole(config).focal_px, 1e-6)
    ground = np.broadcast_to(np.minimum(1.0 / below, 40.0)[:, None], (240, 320))  # level, 1 m below
    lost = laid_over(config, ground).depth_m == 0.0
    aside = (np.arange(320) + 0.5 - 160) / pinhole(config).focal_px
    flat = np.degrees(np.arctan2(below[:, None], np.hypot(1.0, aside)))  # of the ray above the ground
    assert lost[(flat < 5.9) & (ground < 39.0)].mean() == pytest.approx(0.4, abs=0.03)
    assert not lost[flat > 6.1].any()


def borders(classes: np.ndarray, reach: int) -> np.ndarray:
    """Pixels with another class at most `reach` away."""
    padded = np.pad(classes, reach, mode="edge")
    near = np.zeros(classes.shape, bool)
    for row in range(2 * reach + 1):
        for column in range(2 * reach + 1):
            near |= padded[row : row + classes.shape[0], column : column + classes.shape[1]] != classes
    return near


@pytest.mark.parametrize("reach, grain", [(1, 1), (2, 1), (2, 3)])
def test_classes_change_at_borders_only_and_to_a_neighbours(reach, grain):
    classes = np.full((240, 320), ClassId.ROAD, np.uint8)
    classes[:, 160:] = ClassId.SIDEWALK
    classes[100:140, 40:60] = ClassId.PERSON
    noise = {"border_px": reach, "border_share": 0.5, "grain_px": grain, "dropout": 0.0}
    got = laid_over(camera({"classes": noise}), class_id=classes)
    changed = got.class_id != classes
    assert not changed[~borders(classes, reach)].any()
    at_edge = changed[:, 159:161].mean()
    assert at_edge == pytest.approx(0.5 * reach / (2 * reach + 1), abs=0.06 * grain)
    assert set(np.unique(got.class_id)) == {ClassId.ROAD, ClassId.SIDEWALK, ClassId.PERSON}


def test_patches_lose_their_class():
    got = laid_over(camera({"classes": {"border_px": 0, "dropout": 0.1, "patch_px": 4}}), class_id=wall(7)).class_id
    assert (got == ClassId.VOID).mean() == pytest.approx(0.1, abs=0.02)
    assert set(np.unique(got)) == {ClassId.VOID, ClassId.ROAD}


@pytest.mark.parametrize("snr_db", [20.0, 30.0, 40.0])
def test_colours_have_their_signal_to_noise_ratio(snr_db):
    grey = np.full((240, 320, 3), 127, np.uint8)
    got = laid_over(camera({"rgb": {"snr_db": snr_db}}, rgb=True), rgb=grey).rgb.astype(float) - 127
    rounding = 1 / 12  # variance of whole numbers
    assert 10 * math.log10(255**2 / (got.var() - rounding)) == pytest.approx(snr_db, abs=0.1)
    assert abs(got.mean()) < 0.2
    assert np.abs(np.corrcoef(got.reshape(-1, 3).T) - np.eye(3)).max() < 0.02
    dark = laid_over(camera({"rgb": {"snr_db": snr_db}}, rgb=True), rgb=np.zeros((240, 320, 3), np.uint8)).rgb
    assert dark.max() < 127  # ends at black, does not wrap round


def test_parts_that_are_not_asked_for_stay_exact():
    rgb = np.full((240, 320, 3), 90, np.uint8)
    classes = np.indices((240, 320)).sum(axis=0).astype(np.uint8)
    got = laid_over(stereo(sigma_px=0.1), wall(4.0), classes, rgb)
    assert np.array_equal(got.class_id, classes) and np.array_equal(got.rgb, rgb)
    for noise in (None, "none", {}):
        exact = laid_over(camera(noise), wall(4.0), classes, rgb)
        assert np.array_equal(exact.depth_m, wall(4.0)) and np.array_equal(exact.class_id, classes)


TYPICAL = CameraConfig(name="front", width_px=80, height_px=60, rgb=True, noise="typical")


def shots(rig: CameraRig, seat: int, ticks) -> list[bytes]:
    out = []
    for tick in ticks:
        frame = shoot(rig, plant(), tick=tick, seat=seat)[0]
        out.append(frame.depth_m.tobytes() + frame.class_id.tobytes() + frame.rgb.tobytes())
    return out


def test_noise_is_that_of_seed_seat_camera_and_tick_alone(mesh):
    side = TYPICAL.model_copy(update={"name": "side"})
    with CameraRig(mesh, (TYPICAL,), seats=3) as rig, CameraRig(mesh, (side, TYPICAL), seats=2) as other:
        rig.begin(5)
        seen = shots(rig, 0, range(4))
        assert len(set(seen)) == 4
        assert shots(rig, 1, range(4))[1] != seen[1]
        rig.begin(5)
        for seat in (2, 1, 0):  # in another order
            again = shots(rig, seat, range(4))
        assert again == seen
        rig.begin(6)
        assert shots(rig, 0, range(4))[1] != seen[1]
        other.begin(5)  # another rig, with another camera beside it
        for tick in range(4):
            frame, front = shoot(other, plant(), tick=tick)
            assert front.depth_m.tobytes() == seen[tick][: front.depth_m.nbytes]
            assert not np.array_equal(frame.depth_m, front.depth_m)


def test_the_first_picture_of_an_episode_has_noise_of_its_own(mesh):
    with CameraRig(mesh, (TYPICAL,), seats=1) as rig:
        rig.begin(5)
        shots(rig, 0, (0,))
        last = shots(rig, 0, (1,))
        rig.reset(0)
        assert shots(rig, 0, (1,)) != last


def test_without_noise_a_seed_changes_no_bit(mesh):
    exact = TYPICAL.model_copy(update={"noise": None})
    with CameraRig(mesh, (exact,), seats=2) as rig:
        seen = shots(rig, 0, (0,))
        rig.begin(9)
        assert shots(rig, 0, (0, 3)) == seen * 2 and shots(rig, 1, (0,)) == seen


def test_noise_is_quick():
    config = camera("typical")
    scene, classes = wall(3.0), np.full((240, 320), ClassId.ROAD, np.uint8)
    scene[60:200, 80:180] = 1.5
    images = laid_over(config, scene, classes)
    noise, keys = _CameraNoise(config, pinhole(config)), itertools.count()

    def disturb():
        images.depth_m[:] = scene
        noise.lay_over(images, next(keys))

    assert multiple(disturb) < 10  # about 2
