"""What travels: files by their names, bounded where they arrive, the same there as here."""

from pathlib import Path
from typing import Any

import pytest
import zstandard

from tests.support.cluster.workpieces import blunder, read_parcel, refuse
from wcsim.errors import ConfigError, TownError, WorkersError
from wcsim.server.workers import cluster_node
from wcsim.server.workers.cluster_node import _unpack, compress_input_files, run_work_piece
from wcsim.server.workers.machines import WorkInputFiles, WorkPiece, WorkResult


@pytest.fixture
def parcel(tmp_path: Path) -> WorkInputFiles:
    folder = tmp_path / "corner"
    folder.mkdir()
    for name in ("a.net.xml", "b.rou.xml", "secret.txt"):
        (folder / name).write_text(name)
    return WorkInputFiles(address=str(folder), folder=folder, names=("a.net.xml", "b.rou.xml"))


def done(parcel: WorkInputFiles, call=read_parcel, files: Any = None) -> WorkResult:
    work = WorkPiece(key="a/1", call=call, piece=parcel.address)
    return run_work_piece("here/1", work, (parcel,), compress_input_files(parcel) if files is None else files)


def test_what_is_named_travels_under_the_name_of_its_folder_and_is_there_for_its_piece_alone(parcel):
    where, *texts = done(parcel).data.decode().splitlines()
    assert texts == ["a.net.xml", "b.rou.xml"]
    assert Path(where).name == "corner" and not Path(where).exists()


FILE = zstandard.compress(b"x")
NAMED = [{name: FILE} for name in ("../x", "danger/../../x", "/x", "danger/..", b"x", None)]


@pytest.mark.parametrize("files", [*NAMED, b"", ["x"], {"x": "text"}, {"x": b"no frame"}, {"x": FILE[:-1]}])
def test_what_is_no_parcel_or_leads_elsewhere_ends_a_run_in_a_line(parcel, tmp_path, files):
    with pytest.raises((ValueError, TypeError, AttributeError, zstandard.ZstdError)):
        _unpack(files, tmp_path / "a" / "b")
    assert not Path("/x").exists() and not [path for path in tmp_path.rglob("x") if path.is_file()]
    assert "a/1 failed on here/1" in str(done(parcel, files=files).error)


def test_a_name_that_no_file_can_have_is_of_that_machine(parcel):
    for name in ("", "x" * 300):
        assert "Error" in done(parcel, files={name: FILE}).lost


def test_too_much_is_neither_sent_nor_taken_in(parcel, tmp_path, monkeypatch):
    files = compress_input_files(parcel)
    monkeypatch.setattr(cluster_node, "MOST_BYTES", 12)
    with pytest.raises(ConfigError, match="--cluster"):
        compress_input_files(parcel)
    with pytest.raises(ValueError, match="more than 3 bytes"):  # the first one has nine
        _unpack(files, tmp_path / "there")
    monkeypatch.setattr(cluster_node, "MOST_BYTES", 1 << 20)
    monkeypatch.setattr(cluster_node, "_MOST_FILES", 1)
    with pytest.raises(ConfigError, match="2 files"):
        compress_input_files(parcel)
    with pytest.raises(ValueError, match="2 files"):
        _unpack(files, tmp_path / "there")


def test_a_node_tells_what_the_user_can_mend_from_what_only_another_node_can(parcel, monkeypatch):
    assert isinstance(done(parcel, refuse).error, TownError)
    with pytest.raises(WorkersError, match=r"a/1 failed on here/1: ZeroDivisionError.*see Ray's log"):
        raise done(parcel, blunder).error

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cluster_node, "_unpack", full)
    assert "No space" in done(parcel).lost
