"""The page of a training: what the log holds, for each client."""

import csv
from dataclasses import replace

import pytest

from tests.support.worlds import dqn_config
from wcsim.agents.clients.group_run import create_group_run_folder
from wcsim.agents.runs.metrics import COLUMNS, STEP_COLUMNS, MetricsFile, append_round_metrics
from wcsim.agents.runs.run_folder import create_run_folder, make_run_manifest
from wcsim.cli.main import main
from wcsim.errors import PolicyError
from wcsim.server.specs import RunInfo
from wcsim.view.report.learning_curve import TrainedSteps, crossing, read_training
from wcsim.view.report.training_page import write_training_page

INFO = RunInfo(seed=1, town="corner")


def row(step, **changes):
    plain = dict.fromkeys(COLUMNS, 0)
    told = {"step": step, "phase": 1, "length": 10, "crash_reason": ""}
    return {**plain, **told, **changes}


def several(path, *names):
    config = dqn_config()
    create_group_run_folder(path, config, make_run_manifest(config, INFO), dict.fromkeys(names, config))
    return path


def one(path):
    config = dqn_config()
    return create_run_folder(path, config, make_run_manifest(config, INFO)).path


def table(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def log(folder, *rows):
    folder.mkdir(exist_ok=True)
    metrics = MetricsFile(folder / "metrics.csv")
    for each in rows:
        metrics.add(each)


def log_steps(folder, *kpi1, phase=1):
    """A row of steps.csv for each hundred steps."""
    steps = MetricsFile(folder / "steps.csv", columns=STEP_COLUMNS)
    for place, distance in enumerate(kpi1, start=1):
        steps.add({"step": 100 * place, "phase": phase, "kpi1_greedy": distance, "elapsed_s_wall": 6.0 * place})


def test_both_curves_of_every_client_are_what_the_log_says(tmp_path):
    run = several(tmp_path / "run", "a", "b")
    second = row(25, phase=2, length=5, cut=1), row(30, phase=2, crashed=1), row(60, phase=2, length=30)
    log(run / "a", row(10), *second)
    log(run / "b", row(15, length=60))
    log_steps(run / "a", 0.5, 0.25)
    log_steps(run / "b", 0.5)
    assert main(["report", str(run)]) == 0
    text = (run / "report.html").read_text()
    assert "Fig. 7a" in text and "Fig. 7b" in text and "http" not in text.replace("http-equiv", "")
    distances, lengths = (table(run / "report" / f"fig-7{name}.csv") for name in ("a-kpi1", "b-length"))
    assert [(r["client"], r["step"], float(r["kpi1"])) for r in distances] == [
        ("a", "100", 0.5), ("a", "200", 0.25), ("b", "100", 0.5),
    ]  # fmt: skip
    assert [float(r["mean_of_20"]) for r in lengths] == [10.0, 20.0], "of the second phase alone"
    assert [r["crashed"] for r in lengths] == ["1", "0"], "the one that its world cut is in no figure"
    assert [(r["episodes"], r["cut"]) for r in table(run / "report" / "clients.csv")] == [("3", "1"), ("1", "0")]
    assert (run / "report" / "fig-7a-kpi1.svg").is_file()


def test_several_runs_are_one_page_that_says_which_is_which(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    group, alone = several(tmp_path / "run", "a", "b"), one(tmp_path / "alone")
    log(group / "a")
    log(group / "b", row(15))
    log(alone)
    log_steps(group / "a", *(1.0 - 0.03 * k for k in range(1, 26)))
    log_steps(group / "b", 0.1)
    log_steps(alone, *[0.1] * 25)
    assert main(["report", "run", "alone"]) == 0
    told = capsys.readouterr().out
    assert "run/a: KPI 1 (mean of 2000 steps) never falls below 0.1768" in told
    assert "run/b: KPI 1: a mean needs 2000 steps" in told
    assert "alone: KPI 1 (mean of 2000 steps) is below 0.1768 from step 2000 on (2.0 min)" in told
    page = (tmp_path / "runs" / "report" / "report.html").read_text()
    assert "KPI 1 below 0.1768 from step" in page and "town corner, seed 1" in page
    clients = table(tmp_path / "runs" / "report" / "report" / "clients.csv")
    found = {r["client"]: r["KPI 1 below 0.1768 from step"] for r in clients}
    assert found == {"run/a": "", "run/b": "", "alone": "2000"}
    assert main(["report", "run", "alone", "--out", "other"]) == 0
    assert (tmp_path / "other" / "report" / "fig-7a-kpi1.svg").is_file()


def test_rounds_of_danger_networks_are_drawn_beside_the_episodes_of_others(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    danger, values = one(tmp_path / "danger"), one(tmp_path / "values")
    for number, new, steps, crashes in ((0, 2000, 7000, 8), (1, 4000, 11000, 4)):  # 5000 are of --data
        append_round_metrics(
            danger / "metrics.csv",
            (number, steps, new, 0.25, crashes, 900 * number, 3 * number, 500, 5, 50 * (number + 1), 0.5, 1.0, 2.0),
        )
    assert main(["report", "danger"]) == 0
    told = "danger: 2 rounds, 11000 steps, 100 updates, loss 0.500, 1.0 crashes per 1000 steps"
    assert told in capsys.readouterr().out
    page = (danger / "report.html").read_text()
    assert "Rounds of driving and learning" in page and "Fig. 7a" not in page
    alive = [
        (found["round"], float(found["steps-between-crashes"]))
        for found in table(danger / "report" / "steps-between-crashes.csv")
    ]
    assert alive == [("2", 300.0)] and "Fig. 7b" not in page, "of the network alone"
    log(values, row(10), row(20, phase=2))
    assert main(["report", "danger", "values"]) == 0
    both = (tmp_path / "runs" / "report" / "report.html").read_text()
    assert "Rounds of driving and learning" in both and "Fig. 7b" in both


def test_values_that_promise_too_much_are_drawn_where_they_are_known(tmp_path):
    run = one(tmp_path / "alone")
    log(run, row(10, overestimate=""), row(20, overestimate=0.25), row(30, overestimate=-0.75))
    write_training_page(read_training([run]), run)
    rows = table(run / "report" / "overestimate.csv")
    assert [(r["step"], float(r["overestimate"]), float(r["mean_of_20"])) for r in rows] == [
        ("20", 0.25, 0.25), ("30", -0.75, -0.25),
    ]  # fmt: skip
    log(run, row(10, overestimate=""))
    assert "value minus return</h3>" not in write_training_page(read_training([run]), run).read_text()


def rows_of(*kpi1):
    return [TrainedSteps(step=100 * k, phase=2, kpi1=value, elapsed_s=k) for k, value in enumerate(kpi1, start=1)]


def test_a_crossing_is_of_the_mean_of_2000_steps_and_says_when_it_was_left_again():
    assert crossing(rows_of(*[0.1] * 19)) == crossing([]), "too few to say"
    assert (crossing(rows_of(*[0.1] * 20)).step, crossing(rows_of(*[0.1] * 20)).elapsed_s) == (2000, 20)
    assert crossing(rows_of(*[0.1768] * 20)).step == 2000
    assert crossing(rows_of(*[0.18] * 50)).step is None
    late = crossing(rows_of(*[0.5] * 5, *[0.1] * 100))
    assert (late.step, late.left, late.last) == (2200, None, pytest.approx(0.1))  # three of twenty are 0.5
    sittings = [replace(row, elapsed_s=row.elapsed_s % 8) for row in rows_of(*[0.1] * 30)]
    assert crossing(sittings).elapsed_s == 7 + 7 + 4, "two sittings of 7 s before, and 4 s of the third"
    left = crossing(rows_of(*[0.1] * 20, *[0.9] * 20))
    assert (left.step, left.left) == (2000, 2200)


def test_a_log_without_episodes_or_with_damage_is_refused(tmp_path):
    run = several(tmp_path / "run", "a")
    with pytest.raises(PolicyError, match="no client has logged"):
        write_training_page(read_training([run]), run)
    for damage in ({"cut": "x"}, {"length": ""}, {"overestimate": "nan"}):
        log(run / "a", row(10, **damage))
        with pytest.raises(PolicyError, match="damaged at step"):
            read_training([run])
    log(run / "a", row(10))
    for damage in ("x", "inf"):
        log_steps(run / "a", damage)
        with pytest.raises(PolicyError, match="damaged at step"):
            read_training([run])
