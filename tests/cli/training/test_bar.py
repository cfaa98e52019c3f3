"""What a training that fails leaves behind."""

from __future__ import annotations

import errno

import pytest

from wcsim.agents.learning.callbacks import TrainProgress
from wcsim.cli.shared.stage_bar import StageBar
from wcsim.cli.training.bar import gone_if_nothing_came_of_it, steps_shown
from wcsim.errors import ConfigError, DiskFullError, WorkersError

CURED = [DiskFullError("x: no room"), OSError(errno.ENOSPC, "No space left on device"), WorkersError("head is dead")]


@pytest.mark.parametrize("error", [*CURED, ConfigError("no")], ids=lambda error: type(error).__name__)
def test_what_can_be_cured_removes_nothing(tmp_path, error):
    run = tmp_path / "run"
    with pytest.raises(type(error)), gone_if_nothing_came_of_it(run):
        run.mkdir()
        raise error
    assert run.exists() == (error in CURED)


def test_what_was_there_before_stays(tmp_path):
    with pytest.raises(ConfigError), gone_if_nothing_came_of_it(tmp_path):
        raise ConfigError("no")
    assert tmp_path.exists()


@pytest.mark.parametrize("kept", ["data/segments/1-000-0000.npz.zst", "policies/phase1", "checkpoints/step-1"])
def test_work_stays_whatever_has_ended_it(tmp_path, kept):
    run = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt), gone_if_nothing_came_of_it(run):
        (run / kept).mkdir(parents=True)
        raise KeyboardInterrupt
    assert (run / kept).exists()


def test_no_more_steps_are_told_than_there_are_to_do(capsys):
    with StageBar("loading the town") as bar:
        steps_shown(bar)(TrainProgress(step=52, total_steps=50, phase=2, episodes=1, crashes=0, kpi1=None))
    assert capsys.readouterr().err == "phase 2: 50/50 steps, 1 episode, 0 crashes\n"
