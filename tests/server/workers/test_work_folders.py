"""What a process of a node leaves when it is killed goes when the next one begins, and what lives keeps its own."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from tests.support.cluster.workpieces import echo, hang_once, tell_pid
from wcsim.core.own_folder import LOCK
from wcsim.server.workers.cluster_node import compress_input_files, run_work_piece
from wcsim.server.workers.machines import Call, WorkInputFiles, WorkPiece, WorkResult


def work(folder: str, call: Call, piece: str) -> WorkResult:
    """A piece that needs a network, in this process."""
    needed = WorkInputFiles(address=folder, folder=Path(folder), names=("weights",))
    return run_work_piece(
        "here/1", WorkPiece(key="a/1", call=call, piece=piece), (needed,), compress_input_files(needed)
    )


def be_a_worker(folder: str, piece: str) -> None:
    """Hang at a piece, as a process that the machine has stopped."""
    work(folder, hang_once, piece)


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The node's folder for temporary files."""
    place = tmp_path / "tmp"
    place.mkdir()
    monkeypatch.setenv("TMPDIR", str(place))
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


def test_what_a_killed_worker_leaves_goes_with_the_next_piece(temporary: Path, tmp_path: Path) -> None:
    net = tmp_path / "net"
    net.mkdir()
    (net / "weights").write_text("w")
    code = f"from {__name__} import be_a_worker; import sys; be_a_worker(*sys.argv[1:3])"
    words = [sys.executable, "-c", code, str(net), str(tmp_path / "once")]
    child = subprocess.Popen(words, cwd=Path(__file__).parents[3], stderr=subprocess.DEVNULL)
    try:
        until_s = time.monotonic() + 60.0
        while not (tmp_path / "once").exists():
            assert child.poll() is None and time.monotonic() < until_s
            time.sleep(0.02)
        (left,) = temporary.iterdir()
        assert {path.name for path in left.rglob("*")} == {LOCK, "parcel-0", "net", "weights"}
        assert work(str(net), tell_pid, "").data == str(os.getpid()).encode()
        assert list(temporary.iterdir()) == [left], "it lives, and its files stay"
        child.kill()
        assert child.wait(10.0) < 0
        assert left.is_dir()
    finally:
        child.kill()
        child.wait()
    assert work(str(net), echo, "x").data == b"x"
    assert list(temporary.iterdir()) == []
