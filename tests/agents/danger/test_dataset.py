"""Recorded driving as lessons: what is seen, what is unsafe, and everything turned where left and right change."""

import numpy as np
import pytest
import torch

from tests.agents.danger.sights import HEIGHT_PX, WIDTH_PX, a_segment, all_of, lectures, small_config
from tests.support.samples import ACTIONS
from wcsim.agents.danger.dataset import Dataset, _frame_windows
from wcsim.agents.danger.network import spec_of
from wcsim.agents.danger.street_map import MIRRORED, SIDE, SLICES, FeatureExtractor

BOTH = ("danger.eye=both", "learn.network=fig6", "env.window=3")


def test_a_mirror_turns_pictures_vector_start_and_labels():
    config = small_config(*BOTH)
    lessons = lectures(config, 20)
    rows = all_of(lessons)
    street, vector, swept, frames = lessons.batch(rows).inputs
    turned = lessons.batch(rows, mirror=True)
    assert torch.equal(turned.inputs[0], street.flip(-1)) and not torch.equal(turned.inputs[0], street)
    signs = torch.ones(vector.shape[1])
    signs[list(MIRRORED)] = -1.0
    assert torch.equal(turned.inputs[1], vector * signs) and (vector[:, list(MIRRORED)] != 0.0).any()
    assert torch.equal(turned.inputs[3], frames.flip(-1)) and frames.shape == (20, 3, 2, HEIGHT_PX, WIDTH_PX)
    assert torch.equal(turned.unsafe, lessons.batch(rows).unsafe[:, ACTIONS.mirror])
    same = turned.inputs[2] == flipped(swept)[:, ACTIONS.mirror]
    assert same.float().mean() > 0.97, "the roll-outs begin in the mirrored state, so they sweep the mirrored cells"
    assert (swept == flipped(swept)[:, ACTIONS.mirror]).float().mean() < 0.9


def flipped(swept: torch.Tensor) -> torch.Tensor:
    """The same cells on the other side, the points of the chair in the order that they have there."""
    columns = swept % SIDE
    other = swept - columns + (SIDE - 1 - columns)
    eye = FeatureExtractor(small_config())
    chair = eye.chair
    order = [int(np.argmin(np.abs(chair - row * (1, -1, 1)).sum(1))) for row in chair]
    points = other.view(*swept.shape[:2], -1, len(chair))[..., order]
    return points.reshape(swept.shape)


def unsafe_of(segment, *words):
    lessons = Dataset(small_config(*words))
    lessons.add(segment)
    return lessons.batch(all_of(lessons)).unsafe.numpy()


def test_an_action_is_unsafe_already_a_step_before_it_is_and_never_for_another_episode():
    segment = a_segment(12, ends=(5,))
    segment.visible[:] = 255
    segment.visible[4, 7] = segment.visible[6, 8] = 2
    for ahead, rows in ((0, [4]), (1, [3, 4]), (2, [2, 3, 4])):
        unsafe = unsafe_of(segment, f"danger.ahead={ahead}")
        assert np.flatnonzero(unsafe[:, 7]).tolist() == rows
        assert np.flatnonzero(unsafe[:, 8]).tolist() == [6], "row 5 ended its episode"


def test_the_teacher_is_the_one_that_was_asked_for():
    segment = a_segment(6, ends=())
    segment.visible[:], segment.truth[:] = 255, 0
    assert not unsafe_of(segment, "danger.teacher=visible", "danger.ahead=0").any()
    assert unsafe_of(segment, "danger.teacher=truth", "danger.ahead=0").all()


def test_windows_hold_the_pictures_of_their_own_episode():
    config = small_config(*BOTH)
    segment, lessons = a_segment(8, ends=(3,)), Dataset(config)
    lessons.add(segment)
    frames = lessons.batch(all_of(lessons)).inputs[3].numpy()
    wanted = [[0, 0, 0], [0, 0, 1], [0, 1, 2], [1, 2, 3], [4, 4, 4], [4, 4, 5], [4, 5, 6], [5, 6, 7]]
    assert _frame_windows(segment.ended, 3).tolist() == wanted
    for row, window in enumerate(wanted):
        assert np.array_equal(frames[row, :, 0], segment.seg[window])
        assert np.array_equal(frames[row, :, 1], segment.depth[window])


def test_an_eye_sees_the_windows_that_its_lessons_have():
    config = small_config(*BOTH)
    segment, eye = a_segment(5, ends=()), FeatureExtractor(config, 1, pictures=spec_of(config).pictures)
    lessons = Dataset(config)
    lessons.add(segment)
    told = lessons.batch(all_of(lessons)).inputs[3].numpy()
    for row in range(5):
        seen = {"depth": segment.depth[row][None], "seg": segment.seg[row][None], "imu": segment.imu[row]}
        sight = eye.extract({**seen, "odometry": segment.odometry[row], "joystick": segment.wish[row]})
        eye.command(int(segment.action[row]))
        assert np.array_equal(sight.frames, told[row])


def test_half_of_a_batch_is_tight_where_there_is_tightness():
    config = small_config("danger.ahead=0", "danger.tight_share=0.5")
    lessons = lectures(config, 40)
    assert 0.2 < lessons.tight_share < 0.8
    shares = [float(lessons.draw().unsafe.any(1).float().mean()) for _ in range(20)]
    assert np.mean(shares) > lessons.tight_share + 0.1
    assert all(share >= 0.5 for share in shares)


@pytest.mark.parametrize(
    "words, drawn",
    [
        ((), {True, False}),
        (("cameras.0.yaw_deg=20",), {True, False}),
        (BOTH, {True, False}),
        ((*BOTH, "cameras.0.yaw_deg=20"), {False}),
        ((*BOTH, "cameras.0.p_BC_m=[0.35,0.1,1.0]"), {False}),
        (("danger.eye=picture", "cameras.0.yaw_deg=-20"), {False}),
    ],
    ids=str,
)
def test_pictures_are_mirrored_where_the_camera_looks_straight_ahead_from_the_middle(words, drawn, monkeypatch):
    lessons, mirrored = lectures(small_config(*words), 20), []
    batch = lessons.batch
    monkeypatch.setattr(lessons, "batch", lambda picks, mirror: mirrored.append(mirror) or batch(picks, mirror))
    for _ in range(20):
        lessons.draw()
    assert set(mirrored) == drawn


def test_roll_outs_are_swept_for_whom_they_are_read_alone():
    for words, many in (((), 4 * SLICES), (("danger.eye=picture",), 0)):
        swept = lectures(small_config(*words), 6).draw().inputs[2]
        assert (swept.shape[2] > 0) == (many > 0)
