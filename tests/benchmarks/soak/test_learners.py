"""Learners in one street whose processes are killed and stopped: `python -m benchmarks soak --networks`."""

import json
from dataclasses import replace

import pytest

from benchmarks.scripts.soak import SoakOptions, _soaked
from benchmarks.scripts.soak import run as soak
from benchmarks.soak.planned import FaultOrder
from tests.cli.conftest import start
from tests.cli.training.test_clients import SMALL
from wcsim.errors import InterruptedRunError
from wcsim.server.launch.states import ProcessRestartRules

NOTHING = dict.fromkeys(("lost", "doubled", "unrecovered", "orphans", "leaked_shm"), 0)
SIX = "fig6,conv3d,patch,fig6,patch,convlstm"


def six(steps, *words):
    """What six learners of very different speed are told, who go through two ends of epochs."""
    ends = ("--set", f"world.epoch_ticks={5 * steps // 12}")
    return "--networks", SIX, "--steps", steps, "--slow", 6, *words, *ends


def soaked(folder, corner, *words, timeout_s=280):
    """The result of a soak, which must be as it should be."""
    words = ("soak", "--town", corner, "--json", "soak.json", "--out", "kept", *words, *SMALL)
    child = start(folder, *words, program="benchmarks")
    out, err = child.communicate(timeout=timeout_s)
    assert (folder / "soak.json").is_file(), err
    told = json.loads((folder / "soak.json").read_text())
    assert (child.returncode, told["wrong"]) == (0, []), (out, err)
    return told["runs"]


def test_a_learner_is_not_given_up_for_the_deaths_that_a_soak_causes(corner_town, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr("wcsim.cli.training.clients.train_clients", lambda *given: asked.append(given[-1]))
    monkeypatch.setattr("benchmarks.soak.learners.soak_learners", lambda order, run, told, train: train(None))
    options = SoakOptions(networks="patch,fig6", kills=150, stops=140)
    _soaked(options, corner_town, tmp_path / "run-1", FaultOrder(kills=150, stops=140, lease_s=10.0))
    plain = ProcessRestartRules()
    assert asked == [replace(plain, deaths=290 + plain.deaths)]
    assert asked[0].wait_s(290) == plain.longest_s


def test_a_soak_that_a_signal_stops_is_no_result_and_not_begun_again(corner, tmp_path, monkeypatch):
    begun = []

    def stopped(*given):
        begun.append(given)
        raise InterruptedRunError("stopped")

    monkeypatch.setattr("wcsim.cli.training.clients.train_clients", stopped)
    options = SoakOptions(networks="patch,fig6", steps=100, twice=True, town=str(corner), out=tmp_path / "kept")
    with pytest.raises(InterruptedRunError, match="stopped; an incomplete soak shows nothing: start it again"):
        soak(options)
    assert len(begun) == 1


@pytest.mark.proof
def test_six_learners_lose_nothing_through_kills_stops_and_ends_of_epochs(tmp_path, corner):
    words = six(480, "--kills", 4, "--stops", 3, "--lease", 8, "--seed", 4)
    (run,) = soaked(tmp_path, corner, *words, "--set", "learn.checkpoint_every=40", timeout_s=590)
    assert (run["kills"], run["stops"]) == (4, 3)
    assert {key: run[key] for key in NOTHING} == NOTHING
    assert run["slowest_over_median"] > 1.5  # 2.2 on an idle machine; beside another soak all are slow


@pytest.mark.proof
def test_two_runs_of_six_learners_have_one_journal_through_an_end_of_an_epoch(tmp_path, corner):
    runs = soaked(tmp_path, corner, *six(120, "--twice", "--lease", 120), timeout_s=590)
    assert len({run["journal_hash"] for run in runs}) == 1
    weights = [
        (tmp_path / "kept" / run / name / "policies" / "final" / "weights.safetensors").read_bytes()
        for name in ("fig6", "convlstm")
        for run in ("run-1", "run-2")
    ]
    assert weights[0] == weights[1] != weights[2] == weights[3], "learned while waiting, by the clock of a busy machine"
