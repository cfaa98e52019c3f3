"""What measures an exported model leaves no process behind."""

from __future__ import annotations

import signal
from pathlib import Path

import psutil
import pytest

from wcsim.agents.danger.export import footprint


class Ended(KeyboardInterrupt):
    """As a SIGTERM is raised: `subprocess` knows KeyboardInterrupt itself alone."""


def test_a_model_that_stands_still_when_its_measurement_is_ended_is_killed(tmp_path: Path, monkeypatch) -> None:
    seen = []

    def interrupted(process, share):
        seen.append(psutil.Process(process.pid))
        process.send_signal(signal.SIGSTOP)
        raise Ended

    monkeypatch.setattr(footprint, "_throttle", interrupted)
    with pytest.raises(Ended):
        footprint._told(tmp_path / "model.onnx", tmp_path / "reference.npz", ("depth",), 0.5)
    assert not seen[0].is_running()
