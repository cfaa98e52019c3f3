"""Learners on the real environment: Stable-Baselines3's own, ours, and networks and rewards of a user's own."""

import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecMonitor

import wcsim
from tests.agents.toy import ToyStreet
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


@pytest.mark.filterwarnings("ignore:Training and eval env are not of the same type")
@pytest.mark.parametrize("repeat", [True, False])
def test_evaluations_of_one_policy_are_alike_where_the_world_repeats(corner, tmp_path, repeat):
    size = CameraConfig(width_px=40, height_px=36)
    second = VecMonitor(wcsim.StreetVecEnv(str(corner), repeat=repeat, overrides=(*SMALL[:3], "env.max_steps=9")))
    model = DQN("MultiInputPolicy", ToyStreet(size), learning_rate=0.0, buffer_size=50, learning_starts=5, seed=1)
    callback = EvalCallback(second, eval_freq=8, n_eval_episodes=2, verbose=0, log_path=str(tmp_path))
    model.learn(16, callback=callback)
    second.close()
    first, other = np.load(tmp_path / "evaluations.npz")["results"]
    assert np.array_equal(first, other) == repeat


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
    models = [kind.load(path, device="cpu") for kind, path in zip((DQN, PPO), saved, strict=True)]
    assert [model.num_timesteps for model in models] == [24, 24]


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
    assert len((EXAMPLES / name).read_text().splitlines()) <= 15
