"""The command as a process of its own: what lands on the terminal, pipes that close, and Ctrl-C."""

import signal

import pytest

from tests.cli.conftest import finished, parsed, start
from wcsim.cli.shared.exit_codes import ExitCode


def test_a_video_comes_without_chatter_of_what_is_loaded_for_it(tmp_path, corner):
    child = start(tmp_path, "video", corner, "--seconds", "0.3", "--width", "64", "--out", "x.webm", columns=80)
    out, err = child.communicate(timeout=200)
    assert (child.returncode, err) == (0, "")
    assert out.startswith("x.webm")
    assert out.count("\n") == 1


@pytest.mark.parametrize("words", [("town", "list"), ("test", "--help")], ids=" ".join)
def test_a_reader_that_leaves_early_hears_nothing(tmp_path, words):
    with start(tmp_path, *words, columns=80) as child:
        child.stdout.close()
        assert child.stderr.read() == ""
        assert child.wait(timeout=120) in (1, 141)


def test_ctrl_c_keeps_what_was_learned_and_resume_goes_on(wcsim, folder, corner):
    total = 150  # it is told of 50, and has to have some left when the signal comes
    words = (
        *("train-q", "--town", corner, "--out", "run"),
        *("--set", f"learn.total_steps={total}", "--set", "learn.phase1_steps=40", "--set", "learn.train_every=10"),
        *("--set", "learn.network=patch", "--set", "learn.batch_size=4", "--set", "learn.aid=none"),
        *("--set", "world.warmup_s=0", "--set", "cameras.0.width_px=40", "--set", "cameras.0.height_px=36"),
    )
    child = start(folder, *words, columns=80)
    while f"/{total} steps" not in child.stderr.readline():
        assert child.poll() is None
    child.send_signal(signal.SIGINT)
    _, err = finished(child, 200, ExitCode.STOPPED)
    assert "Traceback" not in err
    assert "wcsim resume run" in err
    manifest = parsed(folder / "run" / "manifest.json")
    assert manifest["status"] == "interrupted"
    assert 0 < manifest["steps"] < total
    assert (folder / "run" / "policies" / "final" / "policy.json").is_file()
    result = wcsim("resume", "run", "--steps", total - 1)
    assert (result.code, result.err.count("\n"), str(total - 1) in result.err) == (ExitCode.REFUSED, 1, True), result
    result = wcsim("resume", "run")
    assert result.code == 0, result
    assert "\nrun folder: run" in result.out
    assert parsed(folder / "run" / "manifest.json")["status"] == "done"
    config = (folder / "run" / "config.json").read_text()
    (folder / "run" / "config.json").write_text(config.replace('"gamma": 0.9', '"gamma": 0.8'))
    result = wcsim("resume", "run")
    assert (result.code, "damaged" in result.err) == (ExitCode.REFUSED, True), result
    (folder / "run" / "config.json").write_text(config)
    result = wcsim("resume", "run", "--steps", total + 20)
    assert result.code == 0, result
    assert parsed(folder / "run" / "manifest.json")["steps"] >= total + 20
