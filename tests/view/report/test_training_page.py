"""The page of a training: what the log holds, for each client."""

import csv

import pytest

from wcsim.agents.learning.metrics import COLUMNS, MetricsFile
from wcsim.errors import PolicyError
from wcsim.view.report.training_page import Training, read_training, write_training_page

MANIFEST = {"town": "corner", "seed": 1, "status": "done", "steps": 60}


def row(step, **changes):
    plain = dict.fromkeys(COLUMNS, 0)
    told = {"step": step, "phase": 1, "length": 10, "kpi1": 0.5, "kpi1_greedy": "", "crash_reason": ""}
    return {**plain, **told, **changes}


def written(folder, rows):
    folder.mkdir(parents=True, exist_ok=True)
    metrics = MetricsFile(folder / "metrics.csv")
    for each in rows:
        metrics.add(each)


def read(folder, monkeypatch, **manifest):
    monkeypatch.setattr("wcsim.view.report.training_page.read_json", lambda path, name: {**MANIFEST, **manifest})
    return read_training(folder)


def test_both_curves_of_every_client_are_what_the_log_says(tmp_path, monkeypatch):
    written(tmp_path / "a", [row(10), row(20, kpi1_greedy=0.25, length=30), row(30, phase=2, crashed=1)])
    written(tmp_path / "b", [row(15, length=60)])
    path = write_training_page(read(tmp_path, monkeypatch, clients=["a", "b"]), tmp_path)
    text = path.read_text(encoding="utf-8")
    assert "Fig. 7a" in text and "Fig. 7b" in text and "http" not in text.replace("http-equiv", "")
    with (tmp_path / "report" / "fig-7a-kpi1.csv").open() as file:
        distances = list(csv.DictReader(file))
    with (tmp_path / "report" / "fig-7b-length.csv").open() as file:
        lengths = list(csv.DictReader(file))
    assert [(r["client"], r["step"], float(r["kpi1"])) for r in distances] == [
        ("a", "10", 0.5), ("a", "20", 0.25), ("a", "30", 0.5), ("b", "15", 0.5),
    ]  # fmt: skip
    assert [float(r["mean_of_20"]) for r in lengths] == [10.0, 20.0, pytest.approx(50 / 3, abs=1e-5), 60.0]
    assert [r["crashed"] for r in lengths] == ["0", "0", "1", "0"]
    assert (tmp_path / "report" / "fig-7a-kpi1.svg").is_file()


def test_a_run_of_one_client_is_its_own_client(tmp_path, monkeypatch):
    written(tmp_path, [row(10)])
    assert list(read(tmp_path, monkeypatch).clients) == [tmp_path.name]


def test_a_log_without_episodes_or_with_damage_is_refused(tmp_path, monkeypatch):
    with pytest.raises(PolicyError, match="no client has finished"):
        write_training_page(Training(manifest=MANIFEST, clients={"a": ()}), tmp_path)
    for damage in ({"kpi1": "x"}, {"length": ""}, {"kpi1": "inf"}):
        written(tmp_path, [row(10, **damage)])
        with pytest.raises(PolicyError, match="damaged at step"):
            read(tmp_path, monkeypatch)
