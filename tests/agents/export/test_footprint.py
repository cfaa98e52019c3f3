"""What measures an exported model leaves no process behind."""

from __future__ import annotations

import signal
from pathlib import Path

import psutil
import pytest

from wcsim.agents.export import footprint


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


def test_a_model_that_says_more_than_a_pipe_holds_ends_while_it_is_throttled(tmp_path: Path, monkeypatch) -> None:
    talker, throttle, ended = tmp_path / "talker.py", footprint._throttle, []
    talker.write_text("import json, sys\nsys.stdout.write(json.dumps({'wall_ms': [0.123456] * 20_000}))\n")

    def watched(process, share):
        throttle(process, share)
        ended.append(process.poll())

    monkeypatch.setattr(footprint, "_PROGRAM", str(talker))
    monkeypatch.setattr(footprint, "_throttle", watched)
    monkeypatch.setattr(footprint, "_PATIENCE_S", 60.0)
    told = footprint._told(tmp_path / "model.onnx", tmp_path / "reference.npz", ("depth",), 0.5)
    assert ended == [0], "it ended by itself, and not because nobody waited any longer"
    assert len(told["wall_ms"]) == 20_000, "some 200 kB"
