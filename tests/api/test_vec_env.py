"""Several chairs in one world for one learner, as Stable-Baselines3's users meet them."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

import wcsim
from tests.agents.conftest import one_thread  # noqa: F401 - several threads wait for each other in small networks
from tests.api.streets import BOTH, LEARNABLE, TINY, action_at, closed_in_the_end, equal
from wcsim.agents.envs.vec_env import StreetVecEnv
from wcsim.agents.learning.build import build_q_learner
from wcsim.config import resolve
from wcsim.errors import ConfigError, ProtocolError

SHORT = "env.max_steps=20"


@pytest.fixture
def made(corner: Path) -> Iterator[Callable[..., StreetVecEnv]]:
    with closed_in_the_end(partial(StreetVecEnv, str(corner), chairs=3)) as make:
        yield make


def drive(vec: Any, steps: int, seed: int | None) -> list[Any]:
    if seed is not None:
        vec.seed(seed)
    seen: list[Any] = [vec.reset()]
    for step in range(steps):
        seen.append(vec.step(np.array([action_at(step, seat) for seat in range(vec.num_envs)])))
    return seen


def plain(seen: list[Any]) -> list[Any]:
    """The same with observations as dictionaries, whatever kind of one they were."""
    return [dict(item) if isinstance(item, dict) else (dict(item[0]), *item[1:]) for item in seen]


def test_one_seed_is_one_rollout_in_a_new_world_and_in_one_that_was_used(made):
    vec = made(SHORT)
    first = drive(vec, 45, seed=3)
    assert equal(first, drive(vec, 45, seed=3))
    assert not equal(first, drive(vec, 45, seed=4))
    vec.close()
    other = made(SHORT, seed=3)
    assert equal(first, drive(other, 45, seed=None))


def test_one_chair_is_what_sb3_makes_of_the_gymnasium_environment(corner, made):
    """To the bit, over ends of episodes and a reset in the middle of one."""
    dummy = DummyVecEnv([lambda: wcsim.WheelchairEnv(str(corner), overrides=(*TINY, SHORT))])
    expected = drive(dummy, 50, seed=5) + drive(dummy, 10, seed=None)
    dummy.close()
    vec = made(SHORT, chairs=1)
    got = drive(vec, 50, seed=5) + drive(vec, 10, seed=None)
    vec.close()
    assert sum(bool(item[2][0]) for item in expected if isinstance(item, tuple)) >= 2
    assert equal(plain(expected), plain(got))


def test_where_an_episode_ends_the_next_one_begins_without_a_tick(made):
    vec = made("env.max_steps=5", chairs=2)
    vec.seed(1)
    vec.reset()
    for step in range(1, 12):
        observations, rewards, dones, infos = vec.step(np.array([44, 40]))
        assert [info["event_step"] for info in infos] == [(step - 1) % 5 + 1] * 2
        assert dones.tolist() == [step % 5 == 0] * 2
        assert rewards.dtype == np.float32
        for seat, info in enumerate(infos):
            last = info.get("terminal_observation")
            assert (last is not None) == info["TimeLimit.truncated"] == bool(dones[seat])
            if last is not None:
                assert vec.observation_space.contains(last)
                assert not np.array_equal(last["depth"], observations["depth"][seat])
                assert vec.reset_infos[seat]["event_step"] == 0
                assert vec.reset_infos[seat]["event_episode"] == step // 5
    assert vec.env_method("waits", indices=0)[0].steps == 11, "no more ticks than steps"


def test_observations_are_the_callers_own(made):
    vec = made(chairs=2)
    seen = drive(vec, 3, seed=1)
    kept = {key: value.copy() for key, value in seen[2][0].items()}
    drive(vec, 3, seed=2)
    assert equal(kept, seen[2][0])


@pytest.mark.parametrize("learner", [DQN, PPO])
def test_stock_learners_learn_from_chairs_that_share_a_street(made, learner):
    special: dict[str, Any] = {"buffer_size": 300, "learning_starts": 20, "batch_size": 8, "train_freq": 20}
    if learner is PPO:
        special = {"n_steps": 50, "batch_size": 50, "n_epochs": 1}
    small = {"net_arch": [16], "features_extractor_kwargs": {"cnn_output_dim": 16}}
    vec = VecMonitor(made(SHORT, chairs=2, sized=LEARNABLE))
    try:
        model = learner("MultiInputPolicy", vec, seed=1, device="cpu", policy_kwargs=small, **special)
        before = [value.clone() for value in model.policy.parameters()]
        model.learn(200)
        assert model.num_timesteps == 200
        assert any((a != b).any() for a, b in zip(before, model.policy.parameters(), strict=True))
        assert model.ep_info_buffer is not None and len(model.ep_info_buffer) == 10
    finally:
        vec.close()


def learned(town: Path, envs: int = 2) -> tuple[Any, list[Any]]:
    """A SeqDQN with everything that it has beside SB3's, and its weights."""
    learn = {
        "learning_starts": 20, "batch_size": 8, "replay_frames": 400, "mirror": "true", "aid": "oracle",
        "total_steps": 120, "phase1_steps": 40,
    }  # fmt: skip
    words = [f"learn.{key}={value}" for key, value in learn.items()]
    config = resolve("dqn", (*LEARNABLE, "env.truth=true", "env.max_steps=15", *words))
    vec = StreetVecEnv(str(town), chairs=envs, config=config)
    try:
        model = build_q_learner(config, vec, seed=2)
        model.learn(120)
        return model, [value.detach().numpy().copy() for value in model.policy.parameters()]
    finally:
        vec.close()


def test_seqdqn_learns_from_chairs_that_share_a_street_and_equal_seeds_give_equal_weights(corner):
    model, weights = learned(corner)
    buffer = model.replay_buffer
    assert (model.num_timesteps, buffer.n_envs, buffer.total) == (120, 2, 60)
    assert model._n_updates > 0
    assert buffer.advice_known.any(axis=0).all(), "advice for every chair"
    assert buffer.ended[: buffer.total].sum(axis=0).tolist() == [4, 4], "every episode ends, and nothing else does"
    assert equal(weights, learned(corner)[1])


def test_steps_out_of_turn_are_refused_and_nothing_moves(made):
    vec = made(chairs=2)
    with pytest.raises(ProtocolError, match="call reset"):
        vec.step_async(BOTH)
    vec.seed(1)
    vec.reset()
    with pytest.raises(ProtocolError, match="before step_async"):
        vec.step_wait()
    with pytest.raises(ProtocolError, match="expected 2, one for each chair"):
        vec.step_async(np.array([44]))
    for wrong in (np.array([44, 81]), np.array([44.0, 1.5]), np.array([44.0, np.nan]), [44, "x"], [44, None], "ab"):
        with pytest.raises(ProtocolError, match=r"expected (an integer from 0 to 80|2, one for each chair)"):
            vec.step_async(wrong)
    vec.step_async(BOTH)
    with pytest.raises(ProtocolError, match="came twice"):
        vec.step_async(BOTH)
    assert [info["event_step"] for info in vec.step_wait()[3]] == [1, 1]
    for seed in (None, 1):
        vec.step_async(BOTH)
        vec.seed(seed)
        vec.reset()  # SB3 allows it in the middle of a step
        assert [info["event_step"] for info in vec.step(BOTH)[3]] == [1, 1]
    vec.close()
    vec.close()


def test_what_sb3_asks_environments_one_by_one(made):
    vec = made(chairs=3, render_mode="rgb_array")
    assert vec.get_attr("render_mode") == ["rgb_array"] * 3
    assert vec.get_attr("config", indices=[0, 2]) == [vec.config] * 2
    assert not vec.has_attr("no_such_thing")
    assert vec.metadata == {"render_modes": ["human", "rgb_array"], "render_fps": 10}
    assert vec.env_is_wrapped(Monitor) == [False] * 3
    with pytest.raises(ConfigError, match="make another"):
        vec.set_attr("config", None)
    vec.reset()
    assert [waits.steps for waits in vec.env_method("waits")] == [0, 0, 0]
    assert [image.shape for image in vec.get_images()] == [(24, 32, 3)] * 3
    assert vec.render().shape == (48, 64, 3), "tiles, two by two"
