"""What a training that fails leaves behind."""

from __future__ import annotations

import errno

import pytest

from wcsim.cli.training.bar import gone_if_nothing_came_of_it
from wcsim.errors import ConfigError, DiskFullError

FULL = [DiskFullError("x: no room"), OSError(errno.ENOSPC, "No space left on device")]


@pytest.mark.parametrize("error", [*FULL, ConfigError("no")], ids=lambda error: type(error).__name__)
def test_a_full_disk_removes_nothing(tmp_path, error):
    run = tmp_path / "run"
    with pytest.raises(type(error)), gone_if_nothing_came_of_it(run):
        run.mkdir()
        raise error
    assert run.exists() == (error in FULL)


def test_what_was_there_before_stays(tmp_path):
    with pytest.raises(ConfigError), gone_if_nothing_came_of_it(tmp_path):
        raise ConfigError("no")
    assert tmp_path.exists()
