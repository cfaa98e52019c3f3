"""Clients that learn the first phase together, and of which a suite chooses the one that learns the second."""

import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.agents.evaluation.suite.lists import block_of, suite_in, written_list
from tests.cli.conftest import finished, parsed, start
from tests.cli.training.test_clients import SMALL
from tests.support.events import read_events
from tests.support.yardstick import waited
from wcsim.agents.clients.group_run import ResolvedGroupRun, open_group_run_folder, read_chosen_client_name
from wcsim.agents.evaluation.suite.result_files import result_of
from wcsim.agents.evaluation.suite.rows import pooled_rows
from wcsim.agents.networks import costs
from wcsim.agents.opening.list_file import write_list
from wcsim.agents.runs.metrics import STEP_COLUMNS, read_metrics
from wcsim.agents.runs.run_folder import open_run
from wcsim.cli.main import main
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.cli.training import phases_apart
from wcsim.cli.training.phases_apart import _best_of, _figures_of, _first_phase, _policy_of, _second_phase
from wcsim.cli.training.train_clients import TrainClientsOptions, resolve_clients
from wcsim.config import resolve
from wcsim.errors import PolicyError
from wcsim.server.specs import RunInfo
from wcsim.view.report.learning_curve import Training
from wcsim.view.report.training_page import _client_sections

STEPS = ("--steps", 32, "--set", "learn.phase1_steps=16", "--set", "learn.checkpoint_every=8")


@pytest.fixture(scope="module")
def suite(corner, tmp_path_factory):
    return written_list(corner, tmp_path_factory.mktemp("list"), max_steps=12)


def a_group(*words):
    options = TrainClientsOptions(clients="patch,fig6", steps=100, set=words)
    return ResolvedGroupRun(clients=resolve_clients(options), out=Path("x"), info=RunInfo(seed=1))


def test_the_paper_chooses_by_kpi_1_and_trains_figure_6_in_a_supervised_way():
    learn = resolve("paper").learn
    assert (learn.select_by, learn.network, learn.phase1, learn.margin) == ("kpi1", "fig6", "supervised", 1.0)
    assert resolve("dqn").learn.select_by == ""


def test_only_the_best_has_a_second_phase_and_a_fading_rate_waits_for_it():
    run = a_group("learn.phase1_steps=30", "learn.learning_rate_fade=0.5")
    assert [client.steps for client in run.clients] == [100, 100]
    first = _first_phase(run)
    assert [client.steps for client in first.clients] == [30, 30] and not first.last
    assert {resolve(client.config, client.shortened).learn.learning_rate_fade for client in first.clients} == {0.0}
    second = _second_phase(run, "fig6")
    assert [client.steps for client in second.clients] == [30, 100] and second.last and second.resume
    assert second.clients[1].shortened is None


UNNAMED = {name: "" for name in ("suite", "set", "list_sha256", "changed", "list_name", "preset", "network", "out")}


def test_the_highest_score_goes_on_then_fewer_crashes_then_the_first_seat():
    def result(**scores):
        follow = pooled_rows("follow", (), ())[1]
        rows = [
            replace(follow, policy=_policy_of(Path("r"), n), score=s, crashes_own=c) for n, (s, c) in scores.items()
        ]
        return replace(result_of({}, **UNNAMED), pooled=(replace(follow, score=0.9), *rows))

    def best(**scores):
        return _best_of(_figures_of(result(**scores), Path("r"), list(scores)))

    assert best(a=(0.1, 0), b=(0.3, 5), c=(0.2, 0)) == "b"
    assert best(a=(0.3, 2), b=(0.3, 1)) == "b"
    assert best(a=(0.3, 1), b=(0.3, 1)) == "a"
    assert best(a=(None, 0), b=(0.1, 9)) == "b"


def test_a_choice_that_names_no_client_is_refused(tmp_path):
    assert read_chosen_client_name(tmp_path, ["a"]) == ""
    (tmp_path / "selection").mkdir()
    for best in ('"b"', "3", "null"):
        (tmp_path / "selection" / "choice.json").write_text(f'{{"best": {best}}}')
        with pytest.raises(PolicyError, match="names no client"):
            read_chosen_client_name(tmp_path, ["a"])


def check(run, best, left):
    folder = open_group_run_folder(run)
    assert folder.manifest.status == "done"
    assert (open_run(run / best).manifest.steps, open_run(run / left).manifest.steps) == (32, 16)
    assert {row["phase"] for row in read_metrics(run / left / "metrics.csv")} == {"1"}
    assert {row["phase"] for row in read_metrics(run / best / "metrics.csv")} == {"1", "2"}
    events = [(event["event"], event.get("who")) for event in read_events(run)]
    assert events.count(("chosen", best)) == 1 and ("compared", left) in events
    assert all(open_run(run / name).policy("phase1").is_dir() for name in (best, left))


def test_the_lowest_kpi_1_of_the_first_phase_goes_on_or_whom_the_user_names(tmp_path, capsys, monkeypatch):
    times_ms = {"patch": 3.0, "fig6": 99.0}
    monkeypatch.setattr(costs, "measure_network_cost", lambda name, *size: SimpleNamespace(p50_ms=times_ms[name]))
    run = replace(a_group(), out=tmp_path)
    for name, first, last in (("patch", 0.9, 0.3), ("fig6", 0.2, 0.35)):
        rows = [(first, 1)] * 5 + [(last, 1)] * 20 + [(0.0, 2)]
        lines = [f"{100 * (n + 1)},{phase},{kpi1},{n}.0" for n, (kpi1, phase) in enumerate(rows)]
        (tmp_path / name).mkdir()
        (tmp_path / name / "steps.csv").write_text("\n".join([",".join(STEP_COLUMNS), *lines, ""]))
    options = TrainClientsOptions(clients="patch,fig6")
    assert phases_apart._choose(options, run, "kpi1", None) == "patch"
    clients = {
        "patch": {"kpi1": 0.3, "ms": 3.0, "late_ms": 0.0},
        "fig6": {"kpi1": 0.35, "ms": 99.0, "late_ms": 0.0},
    }
    choice = {"by": "kpi1", "clients": clients, "best": "patch"}
    assert parsed(tmp_path / "selection" / "choice.json") == choice
    assert "KPI 1, last 2000 steps" in (told := capsys.readouterr().out) and "learns the second phase" in told
    times_ms["patch"] = 101.0  # too slow, so that it is not chosen
    assert phases_apart._choose(options, run, "kpi1", None) == "fig6"
    times_ms["fig6"] = 102.0  # both are: the faster one goes on, and the command says so
    assert phases_apart._choose(options, run, "kpi1", None) == "patch"
    assert "all clients are slower" in " ".join(capsys.readouterr().err.split())
    assert (
        phases_apart._choose(options, run, "fig6", None)
        == "fig6"
        == read_chosen_client_name(tmp_path, ["patch", "fig6"])
    )
    ((_, title, (exhibit,)),) = _client_sections(Training(manifests={str(tmp_path): {}}, clients={}))
    assert exhibit.csv.splitlines() == ["client,KPI 1,learned on", "patch,0.3,", "fig6,0.35,second phase"]
    assert "The user chose fig6" in exhibit.says and title == "Which client learns the second phase"


@pytest.mark.proof
def test_one_command_trains_compares_and_goes_on_with_the_best(tmp_path, corner, suite, monkeypatch):
    words = ("train-clients", "patch,fig6", "--town", corner, "--select-by", suite, "--out", "run", *STEPS, *SMALL)
    child = start(tmp_path, *words, "--json", "x.json")
    out, _ = finished(child)
    run = tmp_path / "run"
    choice = parsed(run / "selection" / "choice.json")
    best = choice["best"]
    (left,) = {"patch", "fig6"} - {best}
    assert choice["clients"][best]["score"] >= choice["clients"][left]["score"]
    check(run, best, left)
    told = " ".join(out.split())
    assert "learns the second phase" in told and "stops after the first phase" in told
    assert f"wcsim test run/{best}" in told
    result = parsed(tmp_path / "x.json")
    assert {c["name"]: (c["ticks"], c["missing"], c["duplicated"]) for c in result["clients"]} == {
        best: (32, 0, 0),
        left: (16, 0, 0),
    }
    assert main(["report", str(run)]) == 0
    page = (run / "report.html").read_text()
    assert "Which client learns the second phase" in page and (run / "report" / "selection.csv").is_file()
    monkeypatch.chdir(tmp_path)
    assert main(["resume", "run"]) == 0  # all is done: nothing is driven or learned
    check(run, best, left)


@pytest.mark.proof
def test_what_is_stopped_while_clients_are_compared_goes_on_there(tmp_path, corner):
    file = suite_in(corner, *[block_of(corner, max_steps=60)] * 3).file
    blocks = [block.model_copy(update={"seed": seed}) for seed, block in enumerate(file.blocks)]
    write_list(file.model_copy(update={"blocks": tuple(blocks)}), tmp_path / "three.json")
    words = ("patch,fig6", "--town", corner, "--select-by", "three.json", "--out", "run", *STEPS, *SMALL)
    child = start(tmp_path, "train-clients", *words)
    kept = tmp_path / "run" / "selection" / "kept"
    waited(lambda: list(kept.glob("*.json")), within_s=280.0)
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=60)
    assert (child.returncode, "while clients were compared" in err) == (ExitCode.STOPPED, True), err
    before = {path.name: path.stat().st_mtime_ns for path in kept.glob("*.json")}
    assert len(before) < 9 and not (kept.parent / "choice.json").exists()
    child = start(tmp_path, "resume", "run")
    finished(child)
    after = {path.name: path.stat().st_mtime_ns for path in kept.glob("*.json")}
    assert len(after) == 9 and {name: after[name] for name in before} == before
    best = read_chosen_client_name(tmp_path / "run", ["patch", "fig6"])
    check(tmp_path / "run", best, *({"patch", "fig6"} - {best}))
