"""The numbers of metrics.csv for TensorBoard, by a stand-in for its writer: the package itself need not be here."""

import sys
from types import SimpleNamespace

import pytest

from tests.agents.learning.test_train import CAMERA, config, street
from tests.agents.rounds.small_runs import train_in
from tests.agents.toy import ToyStreet, train_toy
from tests.support.one_process import in_this_process
from wcsim.agents.runs.metrics import COLUMNS, TensorBoardLog, read_metrics, read_round_metrics
from wcsim.cli.training.train import run, run_train_q
from wcsim.errors import ConfigError

MODULE = "torch.utils.tensorboard"
WRITERS = []


class Writer:
    """What TensorBoard's SummaryWriter is asked for."""

    def __init__(self, folder, purge_step=None):
        self.folder, self.purge_step, self.scalars, self.closed = folder, purge_step, [], False
        WRITERS.append(self)

    def add_scalar(self, tag, value, step):
        assert not self.closed
        self.scalars.append((tag, value, step))

    def flush(self):
        """All is kept at once."""

    def close(self):
        self.closed = True


@pytest.fixture
def board(monkeypatch):
    monkeypatch.setitem(sys.modules, MODULE, SimpleNamespace(SummaryWriter=Writer))
    WRITERS.clear()
    return WRITERS


def test_every_number_of_the_log_is_a_scalar(board, tmp_path):
    done = train_toy(config(tensorboard=True, total_steps=120, phase1_steps=40), tmp_path / "run", street, seed=1)
    (writer,) = board
    assert (writer.folder, writer.purge_step, writer.closed) == (str(done / "tensorboard"), None, True)
    rows = read_metrics(done / "metrics.csv")
    for tag, name in (("episode/kpi1", "kpi1"), ("episode/return", "return"), ("train/epsilon", "epsilon")):
        told = [(step, value) for found, value, step in writer.scalars if found == tag]
        assert told == [(int(row["step"]), pytest.approx(float(row[name]), rel=1e-4)) for row in rows]
    tags = {tag.partition("/")[2] for tag, *_ in writer.scalars}
    assert tags <= set(COLUMNS) - {"crash_reason", "step", "episode"} and "overestimate" in tags


def test_so_is_every_number_of_a_round(board, corner, tmp_path):
    with in_this_process():
        train_in(corner, tmp_path / "run", "learn.tensorboard=true", "collect.rounds=2")
    first, second = board
    assert (first.folder, first.purge_step, second.purge_step) == (str(tmp_path / "run" / "tensorboard"), 0, 1)
    (row, _) = read_round_metrics(tmp_path / "run" / "metrics.csv")
    told = {tag: value for tag, value, step in first.scalars if step == 0 and first.closed}
    assert len(told) == 12 and (told["round/new_steps"], told["train/updates"]) == (row.new_steps, row.updates)


def test_tensorboard_reads_them(tmp_path):
    events = pytest.importorskip(
        "tensorboard.backend.event_processing.event_accumulator", reason="tensorboard is not installed"
    )
    with TensorBoardLog(tmp_path) as log:
        log.add({"step": 7, "return": 2.5})
    (read,) = events.EventAccumulator(str(tmp_path / "tensorboard")).Reload().Scalars("episode/return")
    assert (read.step, read.value) == (7, 2.5)


def test_a_run_that_goes_on_drops_what_was_lost(board, tmp_path):
    TensorBoardLog(tmp_path, last_step=120).close()
    assert [writer.purge_step for writer in board] == [121]


def test_without_the_package_it_is_said_before_a_folder_is_made(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, MODULE, None)
    with pytest.raises(ConfigError, match="python -m pip install tensorboard"):
        train_toy(config(tensorboard=True), tmp_path / "run", lambda: ToyStreet(CAMERA), seed=1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", [run, run_train_q])
def test_its_option_is_there_for_either_way_to_train(command, corner, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, MODULE, None)
    with pytest.raises(ConfigError, match="python -m pip install tensorboard"):
        command(["--town", str(corner), "--out", str(tmp_path / "run"), "--tensorboard"])
    assert list(tmp_path.iterdir()) == []
