"""Learners on the real environment: Stable-Baselines3's own, ours, and networks and rewards of a user's own."""

from __future__ import annotations

import csv
import json
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from safetensors.numpy import load_file
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

import wcsim
from tests.agents.toy import ToyStreet, a_run
from tests.support.one_process import in_this_process
from wcsim.agents.learning.saved_policy import load_policy
from wcsim.agents.learning.train import train
from wcsim.cli.main import main
from wcsim.config import CameraConfig, RunConfig, resolve

EXAMPLES = Path(__file__).parents[2] / "examples"
STEPS = 152  # a multiple of learn.train_every
SMALL = (
    *("world.warmup_s=0", "cameras.0.width_px=40", "cameras.0.height_px=36", "env.max_steps=40"),
    *(f"learn.total_steps={STEPS}", "learn.phase1_steps=60", "learn.learning_starts=20", "learn.batch_size=8"),
    *("learn.replay_frames=400", "learn.checkpoint_every=100", "learn.episode_steps=40"),
)


def maker(town: Path, config: RunConfig) -> Callable[[], gymnasium.Env[Any, Any]]:
    return lambda: gymnasium.make(wcsim.ENV_ID, town=str(town), config=config)


def without_wall_times(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return [{key: text for key, text in row.items() if not key.endswith("_s_wall")} for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def run(corner, tmp_path_factory) -> Path:
    config = resolve("dqn", SMALL)
    return train(a_run(config, tmp_path_factory.mktemp("runs") / "first", 3, town="corner"), maker(corner, config))


def test_stock_dqn_with_an_eval_callback_learns_unchanged(corner, tmp_path):
    config = resolve("dqn", SMALL)
    env, second = maker(corner, config)(), Monitor(maker(corner, config)())
    try:
        model = DQN(
            "MultiInputPolicy", env, buffer_size=100, learning_starts=10, batch_size=8, train_freq=4, seed=1,
            policy_kwargs={"net_arch": [16]},
        )  # fmt: skip
        before = [value.clone() for value in model.q_net.parameters()]
        callback = EvalCallback(second, eval_freq=30, n_eval_episodes=1, verbose=0, log_path=str(tmp_path))
        model.learn(60, callback=callback)
        assert model.num_timesteps == 60
        assert any((a != b).any() for a, b in zip(before, model.q_net.parameters(), strict=True))
        done = np.load(tmp_path / "evaluations.npz")
        assert list(done["timesteps"]) == [30, 60]
        assert np.isfinite(done["results"]).all()
    finally:
        env.close()
        second.close()


def test_stock_dqn_learns_from_two_worlds_at_once(corner):
    config = resolve("dqn", SMALL)
    envs = DummyVecEnv([maker(corner, config)] * 2)
    try:
        model = DQN("MultiInputPolicy", envs, buffer_size=100, learning_starts=8, batch_size=8, seed=1)
        model.learn(24)
        assert model.num_timesteps == 24
    finally:
        envs.close()


def test_a_run_folder_is_complete(run):
    assert {item.name for item in run.iterdir()} >= {
        *("manifest.json", "config.json", "metrics.csv", "events.jsonl", "checkpoints", "policies")
    }
    manifest = json.loads((run / "manifest.json").read_text())
    assert (manifest["status"], manifest["steps"], manifest["seed"], manifest["town"]) == ("done", STEPS, 3, "corner")
    assert manifest["versions"]["libsumo"]
    assert RunConfig.model_validate_json((run / "config.json").read_text()) == resolve("dqn", SMALL)
    rows = without_wall_times(run / "metrics.csv")
    assert [row["phase"] for row in rows] == sorted(row["phase"] for row in rows)
    assert {row["phase"] for row in rows} == {"1", "2"}
    for stage in ("phase1", "final"):
        folder = run / "policies" / stage
        assert {item.name for item in folder.iterdir()} == {"policy.json", "weights.safetensors"}
        assert load_policy(folder).file.algorithm == "SeqDQN"


def test_equal_seeds_give_equal_runs_in_the_real_street(run, corner, tmp_path):
    config = resolve("dqn", SMALL)
    again = train(a_run(config, tmp_path / "again", 3), maker(corner, config))
    assert without_wall_times(run / "metrics.csv") == without_wall_times(again / "metrics.csv")
    for stage in ("phase1", "final"):
        one, other = (load_file(folder / "policies" / stage / "weights.safetensors") for folder in (run, again))
        assert one.keys() == other.keys()
        assert all(np.array_equal(one[key], other[key]) for key in one)


def test_the_example_of_stock_learners_trains_saves_and_loads_both(corner, tmp_path):
    small = ("world.warmup_s=0", "cameras.0.width_px=32", "cameras.0.height_px=24", "env.max_steps=12")
    threads = torch.get_num_threads()
    try:
        learn = runpy.run_path(str(EXAMPLES / "stock_sb3.py"))["learn"]
        saved = learn(str(corner), 24, tmp_path, small)
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(threads)
    assert [path.name for path in saved] == ["dqn.zip", "ppo.zip"]
    assert [kind.load(path, device="cpu").num_timesteps for kind, path in zip((DQN, PPO), saved, strict=True)] == [
        24, 24,
    ]  # fmt: skip


def test_a_model_of_sb3_is_a_policy_for_tests(tmp_path, monkeypatch):
    """Under the name that the example which trains one leaves it by."""
    model = DQN("MultiInputPolicy", ToyStreet(CameraConfig(width_px=80, height_px=60)), buffer_size=10, seed=1)
    model.save(tmp_path / "dqn.zip")
    monkeypatch.chdir(tmp_path)
    policy = runpy.run_path(str(EXAMPLES / "sb3_policy.py"))["Sb3Policy"](resolve("quick"))
    policy.begin()
    policy.reset()
    seen = ToyStreet(CameraConfig(width_px=80, height_px=60)).reset(seed=1)[0]
    assert policy.act(seen) == int(model.predict(seen, deterministic=True)[0]) and policy.name == "sb3"


@pytest.mark.parametrize("name", ["own_network.py", "own_reward.py"])
def test_examples_are_short(name):
    assert len((EXAMPLES / name).read_text(encoding="utf-8").splitlines()) <= 15


def test_a_network_and_a_reward_of_ones_own_train_and_are_tested_from_the_command_line(
    corner, tmp_path, monkeypatch, capsys
):
    """As a user does it: beside the two files, each named `module:Class`."""
    monkeypatch.chdir(tmp_path)
    for name in ("own_network.py", "own_reward.py"):
        (tmp_path / name).write_text((EXAMPLES / name).read_text(encoding="utf-8"), encoding="utf-8")
    small = [word for text in (*SMALL, "learn.total_steps=60", "learn.phase1_steps=30") for word in ("--set", text)]
    words = ["--town", str(corner), "--network", "own_network:OwnNet", "--reward", "own_reward:Gentle", "--out", "run"]
    assert main(["train-q", *words, *small]) == 0
    policy = json.loads((tmp_path / "run" / "policies" / "final" / "policy.json").read_text())
    assert policy["net"]["network"] == "own_network:OwnNet"
    test = ["test", "run", "--town", str(corner), "--allow-train-town", "--episodes", "1", "--max-steps", "10"]
    assert main([*test, "--json", "without.json"]) == 2, "whoever tests must name foreign code himself"
    assert "own_network:OwnNet" in capsys.readouterr().err
    assert not Path("without.json").exists()
    with in_this_process():
        assert main([*test, "--network", "own_network:OwnNet", "--json", "with.json"]) == 0
    assert [row["policy"] for row in json.loads(Path("with.json").read_text())["rows"]][:2] == ["follow", "run"]


def test_networks_with_windows_of_their_own_train_and_are_tested_beside_each_other(corner, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small = [word for text in (*SMALL, "learn.total_steps=60", "learn.phase1_steps=30") for word in ("--set", text)]
    for network, window in (("patch", 1), ("fig6", 4)):
        assert main(["train-q", "--town", str(corner), "--network", network, "--out", network, *small]) == 0
        config = json.loads((tmp_path / network / "config.json").read_text())
        policy = json.loads((tmp_path / network / "policies" / "final" / "policy.json").read_text())
        assert (config["env"]["window"], policy["window"]) == (window, window)
    words = ["--town", str(corner), "--allow-train-town", "--episodes", "1", "--max-steps", "10", "--json", "test.json"]
    with in_this_process():
        assert main(["test", "patch", "fig6", *words]) == 0
    rows = json.loads(Path("test.json").read_text())["rows"]
    baselines = ["follow", "random", "zero", "stop", "dwa", "oracle-visible", "oracle"]
    assert [row["policy"] for row in rows] == ["follow", "patch", "fig6", *baselines[1:]]
    assert main(["resume", "fig6"]) == 0
