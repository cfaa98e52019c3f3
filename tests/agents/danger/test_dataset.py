"""Recorded driving as lessons: what is seen, what is unsafe, and everything turned where left and right change."""

import numpy as np
import pytest
import torch

from tests.agents.danger.sights import HEIGHT_PX, TWO, a_segment, all_of, lectures, lessons_of, small_config
from tests.support.samples import ACTIONS
from wcsim.agents.danger.dataset import CRASH_S, Dataset
from wcsim.agents.danger.street_map import MIRRORED, SIDE, FeatureExtractor
from wcsim.errors import PolicyError


def test_a_mirror_turns_pictures_vector_start_and_labels():
    lessons = lectures(small_config(), 20)
    rows = all_of(lessons)
    street, vector, swept = lessons.batch(rows).inputs
    turned = lessons.batch(rows, mirror=True)
    assert torch.equal(turned.inputs[0], street.flip(-1)) and not torch.equal(turned.inputs[0], street)
    signs = torch.ones(vector.shape[1])
    signs[list(MIRRORED)] = -1.0
    assert torch.equal(turned.inputs[1], vector * signs) and (vector[:, list(MIRRORED)] != 0.0).any()
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
    lessons = lessons_of(small_config(*words), segment)
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


def test_a_crash_overrules_an_oracle_that_saw_none():
    segment = a_segment(30, ends=())
    segment.visible[:] = 255
    segment.action[:] = ahead = ACTIONS.nearest((0.0, 1.0))
    segment.delay[:] = 0
    assert not unsafe_of(segment)[:, ahead].any()
    segment.crashed[-1] = segment.own[-1] = True
    assert np.flatnonzero(unsafe_of(segment)[:, ahead]).tolist() == list(range(29 - round(10 * CRASH_S), 30))


def test_to_back_where_no_camera_looked_is_unsafe_but_for_a_teacher_of_crashes():
    segment = a_segment(6, ends=())
    segment.visible[:], segment.odometry[:] = 255, 0.0
    back = ACTIONS.nearest((0.0, -1.0))
    assert unsafe_of(segment)[:, back].any()
    assert not (unsafe_of(segment, "danger.teacher=crashes") == 1.0)[:, back].any()


def test_lessons_hold_the_street_as_a_chair_of_several_cameras_sees_it():
    config, segment = small_config(TWO), a_segment(5, ends=(), cameras=2)
    eye, lessons = FeatureExtractor(config, 1), lessons_of(config, segment)
    front, rear = slice(HEIGHT_PX), slice(HEIGHT_PX, None)
    streets = lessons.batch(all_of(lessons)).inputs[0].numpy()
    for row in range(5):
        seen = {"depth": segment.depth[row][None, front], "seg": segment.seg[row][None, front]}
        seen |= {"rear_depth": segment.depth[row][None, rear], "rear_seg": segment.seg[row][None, rear]}
        seen |= {"imu": segment.imu[row], "odometry": segment.odometry[row], "joystick": segment.wish[row]}
        sight = eye.extract(seen)
        eye.command(int(segment.action[row]))
        assert np.array_equal(sight.picture / np.float32(255.0), streets[row])
    with pytest.raises(PolicyError, match="pictures of"):
        Dataset(config).add(a_segment(5))


def test_half_of_a_batch_is_tight_where_there_is_tightness():
    config = small_config("danger.ahead=0", "danger.tight_share=0.5")
    lessons = lectures(config, 40)
    assert 0.2 < lessons.tight_share < 0.8
    shares = [float(lessons.draw().unsafe.any(1).float().mean()) for _ in range(20)]
    assert np.mean(shares) > lessons.tight_share + 0.1
    assert all(share >= 0.5 for share in shares)
