"""The page of a training: what the log holds, for each client."""

import csv

import pytest

from tests.support.worlds import quick_config
from wcsim.agents.clients.clients_folder import create_clients_folder
from wcsim.agents.learning.metrics import COLUMNS, MetricsFile
from wcsim.agents.runs.run_folder import create_run, make_manifest
from wcsim.cli.main import main
from wcsim.errors import PolicyError
from wcsim.server.specs import RunInfo
from wcsim.view.report.training_page import read_training, write_training_page

INFO = RunInfo(seed=1, town="corner")


def row(step, **changes):
    plain = dict.fromkeys(COLUMNS, 0)
    told = {"step": step, "phase": 1, "length": 10, "kpi1": 0.5, "kpi1_greedy": "", "crash_reason": ""}
    return {**plain, **told, **changes}


def several(path, *names):
    config = quick_config()
    create_clients_folder(path, config, make_manifest(config, INFO), dict.fromkeys(names, config))
    return path


def one(path):
    config = quick_config()
    return create_run(path, config, make_manifest(config, INFO)).path


def log(folder, *rows):
    folder.mkdir(exist_ok=True)
    metrics = MetricsFile(folder / "metrics.csv")
    for each in rows:
        metrics.add(each)


def test_both_curves_of_every_client_are_what_the_log_says(tmp_path):
    run = several(tmp_path / "run", "a", "b")
    log(run / "a", row(10), row(20, kpi1_greedy=0.25, length=30), row(30, phase=2, crashed=1))
    log(run / "b", row(15, length=60))
    assert main(["report", str(run)]) == 0
    text = (run / "report.html").read_text(encoding="utf-8")
    assert "Fig. 7a" in text and "Fig. 7b" in text and "http" not in text.replace("http-equiv", "")
    with (run / "report" / "fig-7a-kpi1.csv").open() as file:
        distances = list(csv.DictReader(file))
    with (run / "report" / "fig-7b-length.csv").open() as file:
        lengths = list(csv.DictReader(file))
    assert [(r["client"], r["step"], float(r["kpi1"])) for r in distances] == [
        ("a", "10", 0.5), ("a", "20", 0.25), ("a", "30", 0.5), ("b", "15", 0.5),
    ]  # fmt: skip
    assert [float(r["mean_of_20"]) for r in lengths] == [10.0, 20.0, pytest.approx(50 / 3, abs=1e-5), 60.0]
    assert [r["crashed"] for r in lengths] == ["0", "0", "1", "0"]
    assert (run / "report" / "fig-7a-kpi1.svg").is_file()


def test_a_run_of_one_client_is_its_own_client(tmp_path):
    run = one(tmp_path / "alone")
    log(run, row(10))
    assert list(read_training(run).clients) == ["alone"]


def test_a_log_without_episodes_or_with_damage_is_refused(tmp_path):
    run = several(tmp_path / "run", "a")
    with pytest.raises(PolicyError, match="no client has finished"):
        write_training_page(read_training(run), run)
    for damage in ({"kpi1": "x"}, {"length": ""}, {"kpi1": "inf"}):
        log(run / "a", row(10, **damage))
        with pytest.raises(PolicyError, match="damaged at step"):
            read_training(run)
