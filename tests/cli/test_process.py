"""The command as a process of its own: what lands on the terminal, pipes that close, and Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.towns import TINY_BBOX, tiny_osm
from wcsim.cli.shared.exit_codes import Exit

COMMAND = (sys.executable, "-m", "wcsim")


def start(folder: Path, *words: object, **more: object) -> subprocess.Popen[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "80"}
    return subprocess.Popen(
        [*COMMAND, *(str(word) for word in words)],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **more,
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("snapshot", "atlantis"), "unknown town 'atlantis'"),
        (("scene", "run", "nothing"), "unknown scene 'nothing'"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_a_mistake_is_one_line_and_code_2(tmp_path, words, told):
    child = start(tmp_path, *words)
    out, err = child.communicate(timeout=200)
    assert (child.returncode, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("wcsim: ")
    assert told in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [("snapshot", "--out", "x.png"), ("video", "--out", "x.webm")], ids=lambda w: w[0])
def test_pictures_and_videos_come_without_chatter(tmp_path, corner, words):
    child = start(tmp_path, *words[:1], corner, "--seconds", "0.3", "--width", "64", *words[1:])
    out, err = child.communicate(timeout=200)
    assert (child.returncode, err) == (0, "")
    assert out.startswith(words[-1])
    assert out.count("\n") == 1


@pytest.mark.parametrize("words", [("town", "list"), ("town", "--help"), ("test", "--help"), ("--help",)], ids=" ".join)
def test_a_reader_that_leaves_early_hears_nothing(tmp_path, words):
    with start(tmp_path, *words) as child:
        child.stdout.close()
        assert child.stderr.read() == ""
        assert child.wait(timeout=120) in (1, 141)


def test_an_import_that_is_ended_leaves_nothing(tmp_path):
    (tmp_path / "tiny.osm").write_text(tiny_osm(), encoding="utf-8")
    child = start(tmp_path, "town", "import", "--osm", "tiny.osm", "--bbox", TINY_BBOX, "--name", "mine")
    towns = tmp_path / "scenarios" / "sumo"
    while not list(towns.glob(".mine.*")):
        assert child.poll() is None
        time.sleep(0.005)
    child.terminate()
    _, err = child.communicate(timeout=200)
    assert (child.returncode, err.splitlines()[-1]) == (143, "wcsim: terminated")
    assert "Traceback" not in err
    assert [path.name for path in tmp_path.rglob("*")] == ["tiny.osm"]


def test_ctrl_c_keeps_what_was_learned_and_resume_goes_on(wcsim, folder, corner):
    total = 300
    words = (
        *("train-q", "--town", corner, "--out", "run"),
        *("--set", f"learn.total_steps={total}", "--set", "learn.phase1_steps=40", "--set", "learn.train_every=10"),
        *("--set", "learn.network=patch", "--set", "learn.batch_size=4", "--set", "learn.aid=none"),
        *("--set", "world.warmup_s=0", "--set", "cameras.0.width_px=40", "--set", "cameras.0.height_px=36"),
    )
    child = start(folder, *words)
    while f"/{total} steps" not in child.stderr.readline():
        assert child.poll() is None
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=200)
    assert child.returncode == Exit.STOPPED, err
    assert "Traceback" not in err
    assert "wcsim resume run" in err
    manifest = json.loads((folder / "run" / "manifest.json").read_text())
    assert manifest["status"] == "interrupted"
    assert 0 < manifest["steps"] < total
    assert (folder / "run" / "policies" / "final" / "policy.json").is_file()
    told = wcsim("resume", "run", "--steps", 299)
    assert (told.code, told.err.count("\n"), "299" in told.err) == (Exit.REFUSED, 1, True), told
    told = wcsim("resume", "run")
    assert told.code == 0, told
    assert "\nrun folder: run" in told.out
    assert json.loads((folder / "run" / "manifest.json").read_text())["status"] == "done"
    config = (folder / "run" / "config.json").read_text()
    (folder / "run" / "config.json").write_text(config.replace('"gamma": 0.9', '"gamma": 0.8'))
    told = wcsim("resume", "run")
    assert (told.code, "damaged" in told.err) == (Exit.REFUSED, True), told
    (folder / "run" / "config.json").write_text(config)
    told = wcsim("resume", "run", "--steps", total + 20)
    assert told.code == 0, told
    assert json.loads((folder / "run" / "manifest.json").read_text())["steps"] >= total + 20
