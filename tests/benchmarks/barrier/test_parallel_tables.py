"""`python -m benchmarks parallel`: its tables, of made numbers; no run is trained."""

import json
import subprocess
from functools import partial
from pathlib import Path

import pytest

from benchmarks.__main__ import main

STEPS = 100
WORLD_S = {1: 10.0, 2: 12.0}  # by the number of clients
WALL_S = {1: 60.0, 2: 80.0}
PARTS = ("world", "barrier", "infer", "learn", "overlap")


def trained(clock, words, **_):
    """Stands in for `wcsim train-clients`: writes what the command would, and moves the clock on as it would."""
    folder, result = (Path(words[words.index(option) + 1]) for option in ("--out", "--json"))
    networks = words[words.index("train-clients") + 1].split(",")
    count = len(networks)
    shares = {"acting_s": 7.0, "learning_s": 20.0, "overlap_s": 9.0, "world_s": WORLD_S[count], "others_s": 5.0 * count}
    folder.mkdir(parents=True)
    waits = {"clients": dict.fromkeys(networks, shares), "waited_s": {}}
    (folder / "waits.json").write_text(json.dumps(waits))
    result.write_text(json.dumps({"ticks_per_s": STEPS / (WALL_S[count] - 20.0)}))
    clock[0] += WALL_S[count]
    return subprocess.CompletedProcess(words, 0, "", "")


@pytest.fixture
def told(tmp_path, capsys, monkeypatch):
    """What the bench prints and writes."""
    clock = [0.0]
    monkeypatch.setattr("benchmarks.scripts.parallel.subprocess.run", partial(trained, clock))
    monkeypatch.setattr("benchmarks.scripts.parallel.time.monotonic", lambda: clock[0])
    monkeypatch.setattr("benchmarks.scripts.parallel.os.sched_setaffinity", lambda pid, cores: None)
    monkeypatch.setattr("benchmarks.scripts.parallel.os.sched_getaffinity", lambda pid: {0, 1})
    file = tmp_path / "told.json"
    words = ["--clients", "patch,fig6", "--steps", str(STEPS), "--json", str(file)]
    assert main(["parallel", *words]) == 0
    return capsys.readouterr().out, json.loads(file.read_text())


def test_the_parts_of_a_row_sum_to_all_of_its_time(told):
    lines = told[0].splitlines()
    headings = next(line for line in lines if line.strip().startswith("client")).split()
    cells = [line.split() for line in lines if len(line.split()) == len(headings)]
    rows = [dict(zip(headings, row, strict=True)) for row in cells if row[1] in ("together", "alone")]
    assert [(row["client"], row["run"]) for row in rows] == [
        ("patch", "together"), ("fig6", "together"), ("patch", "alone"), ("fig6", "alone"),
    ]  # fmt: skip
    for row in rows:
        assert sum(float(row[part]) for part in PARTS) == pytest.approx(float(row["total"]))
    assert [row["world"] for row in rows] == ["12.0", "12.0", "10.0", "10.0"]
    assert {row["overlap"] for row in rows} == {"-9.0"} and {row["start"] for row in rows} == {"20.0"}


def test_what_sharing_saves_is_the_difference(told):
    out, result = told
    (group,) = result["groups"]
    assert (group["together_s"], group["sequential_s"], group["speedup"]) == pytest.approx((80.0, 120.0, 1.5))
    saved = [group[f"saved_{what}_s"] for what in ("world", "start", "rest")]
    assert saved == pytest.approx([2 * 10.0 - 12.0, 20.0, 40.0 - 8.0 - 20.0])
    assert "2 clients on 2 cores: together 80.0 s, one after the other 120.0 s: 1.50 times as fast" in out
