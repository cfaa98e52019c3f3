import io
import json
import runpy
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard

from tests.agents.danger import sights
from tests.agents.danger.sights import write_segment
from tests.support.worlds import dqn_config
from wcsim.agents.runs import data_folder
from wcsim.agents.runs.data_folder import (
    DrivingSegment,
    DrivingSegmentKey,
    hash_segments,
    join_segments,
    read_data_manifest,
    read_segment,
    require_same_data_settings,
    segment_path_from_name,
    write_data_manifest,
)
from wcsim.config import resolve
from wcsim.errors import PolicyError

KEY = DrivingSegmentKey(run=1, round=2, index=3)
TOWN = "0" * 64
EXAMPLES = Path(__file__).parents[3] / "examples"
PLANT = (EXAMPLES / "fwd.toml").read_text()


def a_segment(rows: int = 7, seed: int = 0) -> DrivingSegment:
    """Of one episode."""
    return sights.a_segment(rows, seed, ends=())


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.npz.zst"


def refused(path: Path, told: str) -> None:
    with pytest.raises(PolicyError, match=told):
        read_segment(path)


def test_a_segment_is_read_as_it_was_written_and_its_bytes_follow_from_it_alone(tmp_path: Path):
    segment, path = a_segment(), segment_path_from_name(tmp_path, KEY.name)
    sha256 = write_segment(path, segment)
    for name, column in read_segment(path, sha256).arrays().items():
        assert column.dtype == segment.arrays()[name].dtype and (column == segment.arrays()[name]).all(), name
    assert write_segment(tmp_path / "again", a_segment()) == sha256
    assert write_segment(tmp_path / "other", a_segment(seed=1)) != sha256


def test_a_segment_may_lack_the_oracle_and_an_older_one_does_not_tell_whose_fault_a_crash_was(path: Path):
    none = np.zeros((7, 0), np.uint8)
    segment = replace(a_segment(), visible=none, truth=none, crashed=np.arange(7) == 6)
    write_segment(path, segment)
    assert read_segment(path).truth.shape == (7, 0)
    path.write_bytes(packed(**{name: column for name, column in segment.arrays().items() if name != "own"}))
    assert not read_segment(path).own.any()


def test_segments_are_joined_in_their_order():
    one, other = a_segment(3), a_segment(4, seed=1)
    both = join_segments([one, other])
    assert len(both) == 7 and (both.action[3:] == other.action).all()
    with pytest.raises(ValueError, match="expected one"):
        join_segments([])


@pytest.mark.parametrize("bytes_left", [0, 10, 2000])
def test_a_segment_that_was_cut_short_is_refused(path: Path, bytes_left: int):
    write_segment(path, a_segment())
    path.write_bytes(path.read_bytes()[:bytes_left])
    refused(path, "cannot be read")


def test_a_segment_that_was_exchanged_is_refused(path: Path):
    sha256 = write_segment(path, a_segment())
    write_segment(path, a_segment(seed=1))
    with pytest.raises(PolicyError, match="damaged or replaced"):
        read_segment(path, sha256)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e38])
def test_numbers_that_are_none_are_refused(path: Path, value: float):
    segment = a_segment()
    segment.imu[2, 1] = value
    write_segment(path, segment)
    refused(path, "not finite")


@pytest.mark.parametrize(
    "changes",
    [
        {"action": np.full(7, 81, np.uint8)},
        {"action": np.full(7, 3.5)},
        {"action": np.array(["x"] * 7)},
        {"driver": np.full(7, 4, np.uint8)},
        {"reward": np.float32(1.0)},
        {"imu": np.zeros(7, np.float32)},
        {"wish": np.zeros((7, 1), np.float32)},
        {"seg": np.zeros((7, 24, 31), np.uint8)},
        {"depth": np.zeros((7, 24, 32), np.uint16)},
        {"truth": np.full((7, 69), 255, np.uint8)},
        {"ended": np.zeros(6, np.bool_)},
    ],
    ids=lambda changes: f"{next(iter(changes))}-{next(iter(changes.values())).dtype}",
)
def test_columns_that_fit_nothing_are_refused(path: Path, changes: dict[str, np.ndarray]):
    path.write_bytes(packed(**{**a_segment().arrays(), **changes}))
    refused(path, r"another form|do not fit|rows")


def test_a_segment_without_a_row_is_refused(path: Path):
    path.write_bytes(packed(**{name: column[:0] for name, column in a_segment().arrays().items()}))
    refused(path, "do not fit")


def test_a_segment_that_says_it_is_larger_than_memory_is_refused(path: Path):
    claim = io.BytesIO()
    np.lib.format.write_array_header_1_0(claim, {"descr": "<f4", "fortran_order": False, "shape": (10**14,)})
    path.write_bytes(packed(**a_segment().arrays() | {"reward": claim.getvalue()}))
    refused(path, "cannot be read")


def test_a_small_file_that_would_fill_the_memory_is_refused_before_it_does(path: Path, monkeypatch):
    black = {name: np.zeros((2000, 24, 32), np.uint8) for name in ("depth", "seg")}
    path.write_bytes(packed(**a_segment(2000).arrays() | black))
    read_segment(path)
    monkeypatch.setattr(data_folder, "SEGMENT", replace(data_folder.SEGMENT, limit_bytes=1 << 20))
    assert path.stat().st_size < 1 << 19
    refused(path, "more than")


@pytest.mark.parametrize("way", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_what_is_packed_once_more_may_unpack_to_anything_and_is_refused(path: Path, way: int):
    path.write_bytes(packed(way, **a_segment().arrays()))
    refused(path, "packed in another way")


@pytest.mark.parametrize("shape", ["(" * 3000, "-" * 9000 + "1", "(" + "'x'," * 9])
def test_a_header_that_numpy_fails_at_is_refused(path: Path, shape: str):
    head = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}}}\n".encode()
    column = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head
    path.write_bytes(packed(**a_segment().arrays() | {"reward": column}))
    refused(path, "cannot be read")


def packed(way: int = zipfile.ZIP_STORED, **columns: np.ndarray | bytes) -> bytes:
    """A segment's file of any columns."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", way) as held:
        for name, column in columns.items():
            array = io.BytesIO(column if isinstance(column, bytes) else b"")
            if not isinstance(column, bytes):
                np.lib.format.write_array(array, np.asarray(column))
            held.writestr(f"{name}.npy", array.getvalue())
    return zstandard.ZstdCompressor().compress(out.getvalue())


def test_data_of_another_camera_is_refused_and_told(tmp_path: Path):
    config = dqn_config()
    write_data_manifest(tmp_path, config, {"corner": TOWN}, {"b": "1" * 64, "a": "2" * 64})
    file = read_data_manifest(tmp_path)
    require_same_data_settings(tmp_path, file, dqn_config("learn.gamma=0.9"))
    assert file.data_sha256 == hash_segments({"a": "2" * 64, "b": "1" * 64})
    for other in (
        "world.tick_s=0.05",
        "cameras.0.width_px=40",
        "cameras.0.pitch_deg=10",
        "cameras.0.roll_deg=10",
        "chair.v_max_mps=2.0",
    ):
        with pytest.raises(PolicyError, match=other.partition("=")[0]):
            require_same_data_settings(tmp_path, file, dqn_config(other))
    two = 'env.camera=["front","rear"]'
    with pytest.raises(PolicyError, match=r"env\.camera"):
        require_same_data_settings(tmp_path, file, dqn_config(two))
    write_data_manifest(tmp_path, dqn_config(two), {"corner": TOWN}, {})
    require_same_data_settings(tmp_path, read_data_manifest(tmp_path), dqn_config(two))
    with pytest.raises(PolicyError, match=r"cameras\.1\.pitch_deg"):
        turned = resolve(dqn_config(two), "cameras.1.pitch_deg=0")
        require_same_data_settings(tmp_path, read_data_manifest(tmp_path), turned)


def test_a_wheelchair_of_ones_own_is_known_by_what_its_file_says(tmp_path: Path):
    first, kept = tmp_path / "mine.toml", tmp_path / "run" / "plant.toml"
    kept.parent.mkdir()
    first.write_text(PLANT)
    kept.write_text(PLANT)
    write_data_manifest(tmp_path, dqn_config(f"chair.plant={first}"), {"corner": TOWN}, {})
    file = read_data_manifest(tmp_path)
    require_same_data_settings(tmp_path, file, dqn_config(f"chair.plant={kept}"))
    first.write_text(f"{PLANT}# another one\n")
    for other in (str(first), "rwd"):
        with pytest.raises(PolicyError, match=r"other settings \(chair\.plant\)"):
            require_same_data_settings(tmp_path, file, dqn_config(f"chair.plant={other}"))


def test_data_of_before_with_other_scenes_or_labels_is_refused(tmp_path: Path):
    write_data_manifest(tmp_path, dqn_config(), {"corner": TOWN}, {})
    said = json.loads((tmp_path / "data.json").read_text())
    for version in (1, 2):
        (tmp_path / "data.json").write_text(json.dumps({**said, "schema_version": version}))
        with pytest.raises(PolicyError, match="schema_version"):
            read_data_manifest(tmp_path)


@pytest.mark.filterwarnings("ignore")
def test_a_folder_is_a_dataset_of_minari(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """By the example; `minari.load_dataset` then gives every number back."""
    minari = pytest.importorskip("minari", reason="minari is not installed: pip install 'minari[hdf5]' pillow")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    ends = np.array([0, 0, 1, 0, 0, 0, 1], np.bool_)
    segment = replace(a_segment(), ended=ends, crashed=ends & (np.arange(7) < 3))
    write_segment(segment_path_from_name(tmp_path, KEY), segment)
    monkeypatch.setattr(sys, "argv", ["to_minari.py", str(tmp_path), "wcsim/street-v0"])
    runpy.run_path(str(EXAMPLES / "to_minari.py"))
    episodes = list(minari.load_dataset("wcsim/street-v0").iterate_episodes())
    rows = (slice(0, 3), slice(3, 7))
    for episode, part, ended in zip(episodes, rows, ([True, False], [False, True]), strict=True):
        for name in ("depth", "seg", "imu", "stick"):
            assert np.array_equal(episode.observations[name][:-1], segment.arrays()[name][part]), name
        assert episode.actions.tolist() == segment.action[part].tolist()
        assert np.array_equal(episode.rewards, segment.reward[part])
        assert [bool(episode.terminations[-1]), bool(episode.truncations[-1])] == ended
