"""Rounds of driving and learning: the same data and weights whatever becomes of the worlds on the way.

Which towns a run drives in, and which are made for it.
"""

import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from tests.agents.rounds.small_runs import SMALL, outcome, rows_of, run_in, train_in, weights_of
from tests.support.cluster.workpieces import workers
from tests.support.one_process import in_this_process
from tests.support.worlds import dqn_config
from wcsim.agents.danger.policy import load_danger
from wcsim.agents.rounds import train_rounds
from wcsim.agents.rounds.train_rounds import RoundProgress, _find_towns, train_danger
from wcsim.agents.runs.data_folder import DATA, NETWORK, SEGMENTS, read_segment
from wcsim.agents.runs.run_folder import ResolvedRun, open_run
from wcsim.config import RunConfig
from wcsim.core import files
from wcsim.errors import InterruptedRunError, PolicyError, TownError
from wcsim.server.workers.machines import WorkerPoolSettings
from wcsim.towns.scenario.town import Town, find_town


def test_towns_are_made_where_somebody_drives_in_them_alone(corner_town, tmp_path, monkeypatch):
    made = list[Path]()
    monkeypatch.setattr(train_rounds, "make_town", lambda out, drawn, wishes: made.append(out))
    monkeypatch.setattr(train_rounds, "open_town", lambda out: corner_town)
    driven, read = (dqn_config("collect.made_towns=2", f"collect.segments={count}") for count in (1, 0))
    assert _find_towns(corner_town, (), read, tmp_path, 3) == (str(corner_town.address),) and not made
    assert _find_towns(corner_town, (), driven, tmp_path, 3) == (str(corner_town.address),) * 3 and len(made) == 2


def test_towns_of_the_command_take_turns_with_those_of_the_configuration(corner, corner_town, tmp_path):
    config = dqn_config(f'collect.towns=["{corner}"]')
    assert _find_towns(corner_town, ("helsinki",), config, tmp_path, 3) == (
        str(corner),
        find_town("helsinki").address,
        str(corner),
    )
    with pytest.raises(TownError, match="monaco is a test town"):
        _find_towns(corner_town, (), dqn_config('collect.towns=["monaco"]'), tmp_path, 3)


@pytest.fixture(scope="module")
def straight(corner: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rounds") / "straight"
    with in_this_process():
        train_in(corner, out)
    return out


def test_a_run_leaves_data_rounds_and_a_policy_that_drives(straight: Path):
    assert len(list((straight / DATA / SEGMENTS).iterdir())) == 6
    assert [json.loads(line)["event"] for line in (straight / "events.jsonl").read_text().splitlines()] == ["done"]
    assert open_run(straight).manifest.status == "done"
    rows = (straight / "metrics.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["round", "0", "1", "2"]
    config = dqn_config(*SMALL)
    policy = load_danger(straight / "policies" / "final", "own", config)
    shape = (1, config.cameras[0].height_px, config.cameras[0].width_px)
    seen = {"depth": np.full(shape, 200, np.uint8), "seg": np.full(shape, 8, np.uint8)}
    seen |= {"imu": np.zeros(8, np.float32), "odometry": np.zeros(2, np.float32)}
    policy.begin()
    policy.reset()
    assert 0 <= policy.act({**seen, "joystick": np.array([0.0, 1.0], np.float32)}) < 81


@pytest.mark.proof
def test_a_network_of_two_cameras_is_trained_in_rounds(corner: Path, corner_town: Town, tmp_path: Path):
    run = run_in(corner, tmp_path / "seen", 'env.camera=["front","rear"]', "collect.segments=1")
    train_danger(run, corner_town)
    policy = load_danger(run.out / "policies" / "final", "own", run.config)
    assert policy.senses == ("odometry", "gyro")
    last = sorted((run.out / DATA / SEGMENTS).iterdir())[-1]
    assert NETWORK in read_segment(last).driver


def test_the_network_drives_from_the_third_round_on(straight: Path):
    drivers = [set(read_segment(path).driver.tolist()) for path in sorted((straight / DATA / SEGMENTS).iterdir())]
    assert [NETWORK in who for who in drivers] == [False, False, False, False, True, True]


def test_two_worlds_and_one_that_is_killed_give_the_same_data_and_weights(straight: Path, corner: Path, tmp_path: Path):
    killed: list[int] = []

    def kill_one() -> None:
        while not killed:
            time.sleep(0.1)
            for worker in workers():
                if (tmp_path / "two" / DATA / SEGMENTS).is_dir():  # one segment is there already
                    worker.kill()
                    killed.append(worker.pid)
                    return

    thread = threading.Thread(target=kill_one, daemon=True)
    thread.start()
    train_in(corner, tmp_path / "two", machines=WorkerPoolSettings(count=2))
    assert killed
    assert outcome(tmp_path / "two") == outcome(straight)


@pytest.mark.proof
def test_a_run_that_was_stopped_goes_on_to_the_same_weights(straight: Path, corner: Path, tmp_path: Path):
    out = tmp_path / "stopped"

    def stop(now: RoundProgress) -> None:
        if now.round == 1 and now.updates:
            raise KeyboardInterrupt

    with pytest.raises(InterruptedRunError, match=r"the policy of the complete rounds.*wcsim resume"):
        train_in(corner, out, progress=stop)
    assert open_run(out).manifest.status == "interrupted"
    kept = {
        name: files.sha256_from_file(out / "policies" / name / "weights.safetensors") for name in ("round-001", "final")
    }
    assert kept["final"] == kept["round-001"] != weights_of(straight)
    segment = sorted((out / DATA / SEGMENTS).iterdir())[-1]
    if segment.name.split("-")[1] == "002":  # what was being driven may be cut short
        segment.write_bytes(segment.read_bytes()[:100])
    train_in(corner, out, resume=True)
    assert outcome(out) == outcome(straight)


def test_a_run_that_was_stopped_in_its_first_round_has_no_policy(corner: Path, tmp_path: Path):
    def stop(now: RoundProgress) -> None:
        raise KeyboardInterrupt

    with in_this_process(), pytest.raises(InterruptedRunError, match="no policy yet"):
        train_in(corner, tmp_path / "run", progress=stop)
    assert not (tmp_path / "run" / "policies" / "final").exists()


def test_a_run_goes_on_with_its_own_settings_alone(straight: Path, corner: Path, corner_town: Town):
    config: RunConfig = dqn_config(*SMALL, "danger.width=12")
    other = ResolvedRun(config=config, out=straight, info=run_in(corner, straight).info, resume=True)
    with pytest.raises(PolicyError, match="resume with its own"):
        train_danger(other, corner_town)


@pytest.mark.proof
def test_a_ray_cluster_gives_the_same_data_and_weights(straight: Path, corner: Path, tmp_path: Path):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'wcsim[cluster]'")
    out, told = tmp_path / "ray", []
    seen: set[str] = set()

    def show(now: RoundProgress) -> None:
        seen.update(worker.name for worker in now.workers)

    machines = WorkerPoolSettings(cluster="local", report=told.append)
    train_in(corner, out, machines=machines, progress=show)
    assert outcome(out) == outcome(straight)
    assert seen == {"127.0.0.1/1"} and not [line for line in told if "processor" in line]
    rows = rows_of(out)
    keys = [f"3-{number:03d}-{index:04d}" for number in range(3) for index in range(2)]
    assert sorted(row["key"] for row in rows) == keys
    assert all(row["how"] == "done" and row["bytes"] > 0 for row in rows)
    assert "token" not in (out / "cluster" / "ray.log").read_text().lower()
