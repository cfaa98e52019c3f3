from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.worlds import dqn_config
from wcsim.agents.collecting.data_folder import (
    data_digest,
    read_manifest,
    read_segment,
    require_same_settings,
    segment_path,
    write_manifest,
    write_segment,
)
from wcsim.agents.collecting.segment import Segment, SegmentKey, joined
from wcsim.errors import PolicyError

KEY = SegmentKey(run=1, round=2, index=3)
TOWN = "0" * 64


def a_segment(rows: int = 7, seed: int = 0) -> Segment:
    rng = np.random.default_rng(seed)
    return Segment(
        depth=rng.integers(0, 256, (rows, 24, 32)).astype(np.uint8),
        seg=rng.integers(0, 34, (rows, 24, 32)).astype(np.uint8),
        imu=rng.normal(size=(rows, 8)).astype(np.float32),
        odometry=rng.normal(size=(rows, 2)).astype(np.float32),
        stick=rng.normal(size=(rows, 2)).astype(np.float32),
        wish=rng.normal(size=(rows, 2)).astype(np.float32),
        action=rng.integers(0, 81, rows).astype(np.uint8),
        driver=np.zeros(rows, np.uint8),
        visible=np.full((rows, 81), 255, np.uint8),
        truth=np.full((rows, 81), 255, np.uint8),
        reward=rng.normal(size=rows).astype(np.float32),
        crashed=np.zeros(rows, np.bool_),
        ended=np.arange(rows) == rows - 1,
        delay=np.full(rows, 2, np.uint8),
    )


def test_a_segment_is_read_as_it_was_written_and_its_bytes_follow_from_it_alone(tmp_path: Path):
    segment, path = a_segment(), segment_path(tmp_path, KEY)
    sha256 = write_segment(path, segment)
    for name, column in read_segment(path, sha256).arrays().items():
        assert column.dtype == segment.arrays()[name].dtype and (column == segment.arrays()[name]).all(), name
    assert write_segment(tmp_path / "again", a_segment()) == sha256
    assert write_segment(tmp_path / "other", a_segment(seed=1)) != sha256


def test_segments_are_joined_in_their_order():
    one, other = a_segment(3), a_segment(4, seed=1)
    both = joined([one, other])
    assert len(both) == 7 and (both.action[3:] == other.action).all()
    with pytest.raises(ValueError, match="expected one"):
        joined([])


@pytest.mark.parametrize("bytes_left", [0, 10, 2000])
def test_a_segment_that_was_cut_short_is_refused(tmp_path: Path, bytes_left: int):
    path = tmp_path / "a.npz.zst"
    write_segment(path, a_segment())
    path.write_bytes(path.read_bytes()[:bytes_left])
    with pytest.raises(PolicyError, match="cannot be read"):
        read_segment(path)


def test_a_segment_that_was_exchanged_is_refused(tmp_path: Path):
    path = tmp_path / "a.npz.zst"
    sha256 = write_segment(path, a_segment())
    write_segment(path, a_segment(seed=1))
    with pytest.raises(PolicyError, match="damaged or exchanged"):
        read_segment(path, sha256)


def test_numbers_that_are_none_are_refused(tmp_path: Path):
    segment, path = a_segment(), tmp_path / "a.npz.zst"
    segment.imu[2, 1] = np.nan
    write_segment(path, segment)
    with pytest.raises(PolicyError, match="not finite"):
        read_segment(path)


def test_data_of_another_camera_is_refused_and_told(tmp_path: Path):
    config = dqn_config()
    write_manifest(tmp_path, config, {"corner": TOWN}, {"b": "1" * 64, "a": "2" * 64})
    file = read_manifest(tmp_path)
    require_same_settings(tmp_path, file, dqn_config("learn.gamma=0.9"))
    assert file.data_sha256 == data_digest({"a": "2" * 64, "b": "1" * 64})
    with pytest.raises(PolicyError, match=r"cameras\.0\.width_px"):
        require_same_settings(tmp_path, file, dqn_config("cameras.0.width_px=40"))
    with pytest.raises(PolicyError, match="chair"):
        require_same_settings(tmp_path, file, dqn_config("chair.v_max_mps=2.0"))
