"""Several chairs in one world for Gymnasium's vector form, observations without pictures, any stick, and copies."""

import copy
import pickle
import runpy
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import wcsim
from tests.agents.conftest import one_thread  # noqa: F401 - several threads wait for each other in small networks
from tests.api.streets import BOTH, LEARNABLE, TINY, Counting, action_at, closed_in_the_end, equal
from wcsim.agents.envs import wheelchair_env
from wcsim.agents.envs.vec_env import StreetVecEnv
from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.agents.learning.build import build_q_learner
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.config import EnvConfig, resolve
from wcsim.errors import BadActionError, ConfigError, PolicyError, ProtocolError, ReplayMismatchError

SHORT = "env.max_steps=20"
STATE, STICK = "env.observation=state", "env.actions=stick"


@pytest.fixture
def made(corner: Path) -> Iterator[Callable[..., Any]]:

    def make(chairs: int = 2, **more: Any) -> Any:
        mode = {"vectorization_mode": "vector_entry_point", "num_envs": chairs}
        return gymnasium.make_vec(wcsim.ENV_ID, town=str(corner), **mode, **more)

    with closed_in_the_end(make) as made, warnings.catch_warnings():
        warnings.simplefilter("error")
        yield made


def test_it_is_what_the_environment_of_sb3_is_to_the_bit(corner, made):
    """Over 200 steps, with ends of episodes and a reset in the middle of one; the second world is a process."""
    env = made("env.max_steps=60", chairs=3)
    vec = StreetVecEnv(str(corner), chairs=3, overrides=(*TINY, "env.max_steps=60"))
    vec.seed(4)
    with closing(vec):
        assert equal(vec.reset(), env.reset(seed=4)[0])
        for step in range(200):
            if step == 100:
                assert equal(vec.reset(), env.reset()[0])
            actions = np.array([action_at(step, seat) for seat in range(3)])
            expected, earned, dones, told = vec.step(actions)
            observations, rewards, terminated, truncated, infos = env.step(actions)
            assert equal([expected, earned, dones], [observations, rewards.astype(np.float32), terminated | truncated])
            last = [info["terminal_observation"] if done else None for info, done in zip(told, dones, strict=True)]
            assert not dones.any() or equal(last, list(infos["final_obs"]))


def test_infos_are_as_gymnasium_wants_them_where_an_episode_ends(made):
    env = made(chairs=2, max_episode_steps=3)
    assert env.metadata["autoreset_mode"] is env.autoreset_mode is AutoresetMode.SAME_STEP
    assert env.action_space == gymnasium.spaces.MultiDiscrete([81, 81])
    _, infos = env.reset(seed=1)
    assert not infos["is_success"].any() and infos["_is_success"].all()
    for step in range(1, 7):
        _, _, _, truncated, infos = env.step(BOTH)
        assert truncated.tolist() == [step % 3 == 0] * 2
        assert ("final_info" in infos) == (step % 3 == 0)
        assert infos["event_step"].tolist() == [step % 3] * 2, "those of the frame that is shown"
    assert infos["_final_info"].all() and infos["final_info"]["is_success"].dtype == np.bool_
    assert infos["final_info"]["reward_base"].shape == (2,)


def test_wrong_actions_and_seeds_are_refused_and_nothing_moves(made):
    env = made()
    for _ in range(2):
        with pytest.raises(ProtocolError, match="call reset"):
            env.step(BOTH)
        env.reset(seed=1)
        env.close()
        assert env._chairs._group is None, "a second close() ends the second world"
    env.reset(seed=1)
    with pytest.raises(BadActionError, match="expected an integer from 0 to 80"):
        env.step(np.array([44, 81]))
    for told, wrong in (("an integer", {"seed": [1, 2]}), ("none", {"options": {"reset_mask": [True, False]}})):
        with pytest.raises(ConfigError, match=f"expected {told}"):
            env.reset(**wrong)
    assert env.step(BOTH)[4]["event_step"].tolist() == [1, 1]


def test_gymnasiums_statistics_and_pictures_work_with_it(made):
    env = RecordEpisodeStatistics(made(STATE, max_episode_steps=2, render_mode="rgb_array"))
    env.reset(seed=1)
    env.step([44, 44])
    assert env.step([44, 44])[4]["episode"]["l"].tolist() == [2, 2]
    assert [picture.shape for picture in env.render()] == [(24, 32, 3)] * 2


def test_the_registered_length_of_an_episode_is_that_of_the_settings():
    assert gymnasium.spec(wcsim.ENV_ID).max_episode_steps == EnvConfig().max_steps
    for given, most in (({}, 10_000), ({"max_episode_steps": 15_000}, 15_000), ({"max_episode_steps": -1}, 20_000)):
        env = gymnasium.make_vec(wcsim.ENV_ID, overrides=("env.max_steps=20000",), **given)
        assert env.config.env.max_steps == most


@pytest.mark.parametrize("checker", [check_env, sb3_check_env], ids=["gymnasium", "sb3"])
def test_checkers_find_nothing_in_numbers_and_any_stick(corner, checker):
    env = gymnasium.make(wcsim.ENV_ID, town=str(corner), overrides=(*TINY, STATE, STICK))
    with closing(env), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        checker(env.unwrapped)
    flat = "We recommend you to flatten the observation"  # SB3 would have a row of numbers, and flattens these itself
    assert [text for text in (str(item.message) for item in caught) if flat not in text] == []


def test_rows_without_pictures_are_the_same_drive_in_either_kind_of_world(made):
    """One world is in this process, the other one in its own; and no camera takes a picture."""
    one, other, pictured = (made(STICK, SHORT, *more) for more in ((STATE,), (STATE,), ()))
    _, infos = one.reset(seed=3)
    other.reset(seed=3)
    world = one.unwrapped._chairs._group.home.world
    assert [client.sensors.cameras for client in world.snapshot.clients] == [(), ()]
    pictured.reset(seed=3)
    for _ in range(25):
        stick = infos["user_action"]
        *got, infos = one.step(stick)
        assert equal(got, list(other.step(stick)[:4]))
        assert equal(infos["state"], pictured.step(stick)[4]["state"]), "what is seen moves nothing"
        assert equal(infos["asked"], infos["given"]) or (infos["joystick_distance"] < 1e-6).all()
        np.testing.assert_allclose(got[0][:, 0, 1:3], infos["user_action"], atol=1e-7)


def test_a_stick_beyond_its_round_gate_goes_as_far_as_the_gate(made):
    env = made(STICK)
    env.reset(seed=1)
    for wrong in ([[0, 0], [0, 1.01]], [[0, np.nan]] * 2, [["x", None]] * 2, [[0, 0, 0]] * 2, [44, 44], np.eye(2) * 1j):
        with pytest.raises(BadActionError, match="expected x and y from -1 to 1"):
            env.step(wrong)
    given = env.step(np.array([[1.0, 1.0], [-0.3, 0.4]]))[4]["given"]
    assert given.tolist() == [pytest.approx((0.5**0.5, 0.5**0.5)), [-0.3, 0.4]]


def test_what_learns_from_pictures_or_a_list_of_actions_says_so(corner):
    for word, told in ((STATE, "expected a Dict"), (STICK, "what chooses from a list needs one")):
        env = StreetVecEnv(str(corner), preset="dqn", overrides=(*LEARNABLE, word))
        with pytest.raises((PolicyError, ConfigError), match=told):
            build_q_learner(env.config, env, seed=1)
    with pytest.raises(ConfigError, match="what chooses from a list needs one"):
        make_baseline_policy("dwa", resolve("quick", STICK))
    for more in ("env.window=4", "env.truth_visible=true"):
        with pytest.raises(ConfigError, match="observation 'state'"):
            resolve("quick", (STATE, more))


def test_arriving_is_a_success_until_the_episode_ends(corner, monkeypatch):
    with closing(WheelchairEnv(str(corner), overrides=(*TINY, "env.max_steps=2"))) as env:
        env.reset(seed=1)
        user = env._own.home.world.seats[0].user
        with monkeypatch.context() as patch:
            patch.setattr(user, "_move_along", lambda *_: setattr(user, "arrived", True))
            assert env.step(40)[4]["is_success"] is True
        assert (env.step(40)[4]["is_success"], env.reset()[1]["is_success"]) == (True, False)


class Lasting(Counting):
    def reset(self) -> None:
        self.steps += 1


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])  # noqa: S301
def test_a_copy_is_where_the_environment_is_and_goes_on_alone(corner, copied):
    """Also behind an end of an episode, a reset in the middle of one, and a world that was begun again."""
    env = gymnasium.make(wcsim.ENV_ID, town=str(corner), overrides=(*TINY, SHORT), reward_terms=[Lasting()])
    env.reset(seed=3)
    for seed in (None, 4):
        env.step(40)
        env.reset(seed=seed)
    drive(env, 0, 25)
    env.reset()
    drive(env, 25, 5)
    other = copied(env)
    alone = drive(other, 30, 18)
    assert equal(drive(env, 30, 18), alone)
    assert sum(step[3] for step in alone) == 1, "the limit of an episode goes on too"
    other.close()
    env.close()


def drive(env: gymnasium.Env[Any, Any], first: int, steps: int) -> list[Any]:
    seen = []
    for step in range(first, first + steps):
        seen.append(env.step(action_at(step)))
        if seen[-1][2] or seen[-1][3]:
            env.reset()
    return seen


def test_what_cannot_be_copied_says_so(corner, made, monkeypatch):
    monkeypatch.setattr(wheelchair_env, "MOST_REPEATED", 2)
    env = WheelchairEnv(str(corner), overrides=TINY)
    env.reset(seed=1)
    for _ in range(2):
        env.step(40)
    state = copy.deepcopy(env.__getstate__())
    env.step(40)
    with pytest.raises(ProtocolError, match="more than 2 steps again; call reset"):
        copy.deepcopy(env)
    with pytest.raises(ReplayMismatchError, match="not where its original was"):
        WheelchairEnv.__new__(WheelchairEnv).__setstate__(copy.deepcopy({**state, "_root_seed": 2}))
    for shown, told in ((ProtocolError, ReplayMismatchError), (KeyboardInterrupt, KeyboardInterrupt)):
        other = WheelchairEnv.__new__(WheelchairEnv)
        with monkeypatch.context() as patch, pytest.raises(told, match="over"):
            patch.setattr(WheelchairEnv, "step", Mock(side_effect=shown("over")))
            other.__setstate__(copy.deepcopy(state))
        assert other._own is None, "the world is closed"
    env.close()
    copy.deepcopy(env).close()
    several = made()
    several.reset(seed=1)
    with pytest.raises(ProtocolError, match=r"copied.*close\(\)"):
        copy.deepcopy(several)


def test_the_example_in_one_file_makes_an_update(corner, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    train = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "cleanrl_ppo.py"))["train"]
    (row,) = train(str(corner), 160, more=(*TINY, SHORT), chairs=2)
    assert row["steps"] == 160 and np.isfinite(list(row.values())).all()
    assert (tmp_path / "cleanrl_ppo.pt").is_file()
