"""The numbers of metrics.csv for TensorBoard, by a stand-in for its writer: the package itself need not be here."""

import signal
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest

from tests.agents.learning.test_train import CAMERA, config, street
from tests.agents.online.test_train_online import Sensing
from tests.agents.online.test_train_online import config as danger_config
from tests.agents.toy import ToyStreet, a_run
from wcsim.agents.learning.train import train
from wcsim.agents.learning.watching.metrics import COLUMNS, read_metrics
from wcsim.agents.learning.watching.tensorboard import BoardLog
from wcsim.agents.online.train_online import train_online
from wcsim.errors import ConfigError, InterruptedRunError

MODULE = "torch.utils.tensorboard"


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


WRITERS: list[Writer] = []


@pytest.fixture
def board(monkeypatch):
    monkeypatch.setitem(sys.modules, MODULE, SimpleNamespace(SummaryWriter=Writer))
    WRITERS.clear()
    return WRITERS


def test_every_number_of_the_log_is_a_scalar(board, tmp_path):
    run = train(a_run(config(tensorboard=True), tmp_path / "run", 1), street)
    (writer,) = board
    assert (writer.folder, writer.purge_step, writer.closed) == (str(run / "tensorboard"), None, True)
    rows = read_metrics(run / "metrics.csv")
    for tag, name in (("episode/kpi1", "kpi1"), ("episode/return", "return"), ("train/epsilon", "epsilon")):
        told = [(step, value) for found, value, step in writer.scalars if found == tag]
        assert told == [(int(row["step"]), pytest.approx(float(row[name]), rel=1e-4)) for row in rows]
    tags = {tag.partition("/")[2] for tag, *_ in writer.scalars}
    assert tags <= set(COLUMNS) - {"crash_reason", "step", "episode"} and "overestimate" in tags


def test_a_danger_network_that_learns_as_it_drives_writes_scalars_too(board, tmp_path):
    asked = a_run(danger_config("learn.tensorboard=true"), tmp_path / "run", 1, town_sha256="0" * 64)
    stops = Sensing(at=150, call=lambda: signal.raise_signal(signal.SIGTERM))
    with pytest.raises(InterruptedRunError):
        train_online(asked, lambda: stops)
    run = train_online(replace(asked, resume=True), Sensing)
    assert [(each.folder, each.purge_step, each.closed) for each in board] == [
        (str(run / "tensorboard"), None, True),
        (str(run / "tensorboard"), 153, True),
    ]
    told = [(step, value) for each in board for tag, value, step in each.scalars if tag == "train/updates"]
    assert told == [(int(row["step"]), int(row["updates"])) for row in read_metrics(run / "metrics.csv")]


def test_a_run_that_goes_on_drops_what_was_lost(board, tmp_path):
    BoardLog(tmp_path, keep_to_step=120).close()
    assert [writer.purge_step for writer in board] == [121]


def test_without_the_package_it_is_said_before_a_folder_is_made(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, MODULE, None)
    with pytest.raises(ConfigError, match="python -m pip install tensorboard"):
        train(a_run(config(tensorboard=True), tmp_path / "run", 1), lambda: ToyStreet(CAMERA))
    with pytest.raises(ConfigError, match="python -m pip install tensorboard"):
        train_online(a_run(danger_config("learn.tensorboard=true"), tmp_path / "run", 1), Sensing)
    assert list(tmp_path.iterdir()) == []
