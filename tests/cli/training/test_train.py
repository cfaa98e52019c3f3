"""What is shown of a training, and what one leaves behind that fails or is stopped."""

import errno
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from wcsim.agents.learning.callbacks import TrainProgress
from wcsim.agents.opening.learner_registry import DANGER_ROUNDS
from wcsim.agents.rounds import train_rounds
from wcsim.agents.rounds.train_rounds import RoundProgress
from wcsim.agents.runs.run_folder import ResolvedRun
from wcsim.cli.shared.consoles import StageBar
from wcsim.cli.shared.exit_codes import NothingSavedInterrupt
from wcsim.cli.shared.training import (
    compute_finished_share,
    make_progress_callback,
    remove_run_without_results,
    train_single_network,
)
from wcsim.config import resolve
from wcsim.errors import ConfigError, DiskFullError, InterruptedRunError, WorkersError
from wcsim.server.specs import RunInfo
from wcsim.server.workers.machines import HERE, WorkerPoolSettings

Show = Callable[[RoundProgress], object]


@pytest.fixture
def run(tmp_path: Path) -> ResolvedRun:
    info = RunInfo(seed=1, town="corner")
    return ResolvedRun(config=resolve("quick"), out=tmp_path / "runs" / "a", info=info)


def stopped(policy: str) -> Callable[..., Path]:
    """A training that is stopped when it has kept a policy, or before."""

    def train(run: ResolvedRun, town: object, machines: WorkerPoolSettings, show: Show, stage: object) -> Path:
        (run.out / "data").mkdir(parents=True)
        if policy:
            (run.out / "policies" / policy).mkdir(parents=True)
        raise InterruptedRunError("stopped")

    return train


def test_what_was_stopped_before_its_first_segment_leaves_nothing(run, corner_town, monkeypatch):
    monkeypatch.setattr(train_rounds, "train_danger", stopped(""))
    with pytest.raises(NothingSavedInterrupt, match="first segment"):
        train_single_network(run, corner_town, machines=HERE)
    assert not run.out.parent.exists()


def test_what_was_stopped_later_is_kept(run, corner_town, monkeypatch):
    monkeypatch.setattr(train_rounds, "train_danger", stopped("round-000"))
    with pytest.raises(InterruptedRunError):
        train_single_network(run, corner_town, machines=HERE)
    assert (run.out / "policies" / "round-000").is_dir()


def test_a_log_file_says_when_a_round_is_driven_and_when_it_is_learned(run, corner_town, monkeypatch, capsys):
    def train(run: ResolvedRun, town: object, machines: WorkerPoolSettings, show: Show, stage: object) -> Path:
        for back in (1, 2):
            show(RoundProgress(round=0, rounds=3, segments=back, of=2))
        show(RoundProgress(round=0, rounds=3, segments=2, of=2, learned=1))
        show(RoundProgress(round=0, rounds=3, segments=2, of=2, updates=7, loss=0.5))
        return run.out

    monkeypatch.setattr(train_rounds, "train_danger", train)
    train_single_network(run, corner_town, machines=HERE)
    driven, learned = capsys.readouterr().err.splitlines()
    assert re.fullmatch(r"round 1 of 3, 2 of 2 segments: learning, about \d+ s left", driven)
    assert re.fullmatch(r"round 1 of 3, 2 of 2 segments, 7 updates, loss 0.5000, about \d+ s left", learned)


def test_the_work_of_rounds_adds_up():
    config = resolve("quick", "collect.rounds=3")
    of = config.collect.segments
    shares = [
        compute_finished_share(RoundProgress(round=0, rounds=3, segments=back, of=of), config) for back in range(of + 1)
    ]
    for number in range(3):
        for learned in (1, config.danger.updates):
            now = RoundProgress(round=number, rounds=3, segments=of, of=of, learned=learned)
            shares.append(compute_finished_share(now, config))
        shares.append(compute_finished_share(replace(now, updates=config.danger.updates * (number + 1)), config))
    assert shares[0] == 0.0 and shares[-1] == pytest.approx(1.0)
    assert shares == sorted(shares)
    without = resolve("quick", "collect.segments=0")
    assert compute_finished_share(RoundProgress(round=1, rounds=2, segments=0, of=0), without) == pytest.approx(0.5)


def test_a_demo_says_what_its_settings_make_it_do():
    config = resolve("quick")
    told = DANGER_ROUNDS.describe(config)
    assert f"{config.collect.rounds} rounds" in told and f"{config.danger.updates} updates" in told
    assert "learns from the oracle's labels, not rewards" in told
    assert "from crashes that happened" in DANGER_ROUNDS.describe(resolve("reward"))
    assert DANGER_ROUNDS.describe(resolve("quick", "collect.rounds=1")).startswith("1 round of ")


CURED = [DiskFullError("x: no room"), OSError(errno.ENOSPC, "No space left on device"), WorkersError("head is dead")]


@pytest.mark.parametrize("error", [*CURED, ConfigError("no")], ids=lambda error: type(error).__name__)
def test_what_can_be_cured_removes_nothing(tmp_path, error):
    run = tmp_path / "run"
    with pytest.raises(type(error)), remove_run_without_results(run):
        run.mkdir()
        raise error
    assert run.exists() == (error in CURED)


def test_what_was_there_before_stays(tmp_path):
    with pytest.raises(ConfigError), remove_run_without_results(tmp_path):
        raise ConfigError("no")
    assert tmp_path.exists()


@pytest.mark.parametrize("kept", ["data/segments/1-000-0000.npz.zst", "policies/phase1", "checkpoints/step-1"])
def test_work_stays_whatever_has_ended_it(tmp_path, kept):
    run = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt), remove_run_without_results(run):
        (run / kept).mkdir(parents=True)
        raise KeyboardInterrupt
    assert (run / kept).exists()


def test_no_more_steps_are_told_than_there_are_to_do(capsys):
    with StageBar("loading the town") as bar:
        make_progress_callback(bar)(TrainProgress(step=52, total_steps=50, phase=2, episodes=1, crashes=0, kpi1=None))
    assert capsys.readouterr().err == "phase 2: 50/50 steps, 1 episode, 0 crashes\n"


@pytest.mark.parametrize("command", ["train", "train-q"])
def test_help_loads_nothing_that_a_training_needs(command: str) -> None:
    code = f"import sys; from wcsim.cli.main import main; sys.argv = ['wcsim', '{command}', '--help']; main()"
    ends = "; ".join(["import atexit, sys", "atexit.register(lambda: print(*sys.modules, file=sys.stderr))", code])
    done = subprocess.run([sys.executable, "-c", ends], capture_output=True, text=True, check=True)
    heavy = {"numpy", "pydantic", "torch", "gymnasium", "libsumo", "pybullet", "numba", "wcsim.config"}
    assert "--preset" in done.stdout and not heavy & set(done.stderr.split())
