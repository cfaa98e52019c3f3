"""What measures an exported model leaves no process behind."""

from pathlib import Path

from wcsim.agents.export import footprint


def test_a_model_that_says_more_than_a_pipe_holds_ends_while_it_is_throttled(tmp_path: Path, monkeypatch) -> None:
    talker, throttle, ended = tmp_path / "talker.py", footprint._throttle, []
    talker.write_text("import json, sys\nsys.stdout.write(json.dumps({'wall_ms': [0.123456] * 20_000}))\n")

    def watched(process, share):
        throttle(process, share)
        ended.append(process.poll())

    monkeypatch.setattr(footprint, "_PROGRAM", str(talker))
    monkeypatch.setattr(footprint, "_throttle", watched)
    monkeypatch.setattr(footprint, "_TIMEOUT_S", 60.0)
    told = footprint._measure_apart(tmp_path / "model.onnx", tmp_path / "reference.npz", ("depth",), 0.5)
    assert ended == [0], "it ended by itself, and not because nobody waited any longer"
    assert len(told["wall_ms"]) == 20_000, "some 200 kB"
