"""Several chairs in one world as PettingZoo's users meet them."""

import itertools
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import wcsim
from tests.api.streets import TINY, Counting, action_at, closed_in_the_end, equal
from wcsim.agents.envs.parallel_env import StreetParallelEnv
from wcsim.errors import BadActionError, ConfigError, ProtocolError
from wcsim.types import SeatSpec


@pytest.fixture
def made(corner: Path) -> Iterator[Callable[..., StreetParallelEnv]]:
    with closed_in_the_end(partial(wcsim.parallel_env, str(corner), chairs=3)) as make:
        yield make


def drive(env: StreetParallelEnv, steps: int, seed: int | None) -> list[Any]:
    """All that is returned of an episode, to its end or for so many steps."""
    seen: list[Any] = [env.reset(seed=seed)]
    for step in range(steps):
        if not env.agents:
            break
        seen.append(env.step({agent: action_at(step, int(agent[-1])) for agent in env.agents}))
    return seen


def test_pettingzoos_own_test_of_the_interface_finds_nothing(made):
    env = made("env.max_steps=12")
    parallel_api_test(env, num_cycles=30)


def test_pettingzoos_own_test_of_seeds_finds_nothing(made):
    """It makes two environments at once, so one of the worlds is in a process of its own."""
    parallel_seed_test(lambda: made(chairs=2), num_cycles=5)


def test_one_seed_is_one_episode_in_a_new_world_and_in_one_that_was_used(made):
    env = made("env.max_steps=20")
    first = drive(env, 15, seed=3)
    assert equal(first, drive(env, 30, seed=3)[:16]), "everybody was still there"
    assert env.agents == []
    assert equal(first, drive(env, 15, seed=3)), "everybody was gone"
    assert not equal(first, drive(env, 15, seed=4))
    env.close()
    assert equal(first, drive(env, 15, seed=3)), "the world was ended"
    env.close()
    fresh = made("env.max_steps=20", seed=3)
    assert equal(first, drive(fresh, 15, seed=None))


def test_resets_without_a_seed_follow_from_the_first_one(made):
    runs = []
    for _ in range(2):
        env = made("env.max_steps=20", chairs=2, seed=8)
        runs.append([drive(env, 4, seed=None) for _ in range(3)])
        env.close()
    assert equal(runs[0], runs[1])
    assert not any(equal(a, b) for a, b in itertools.combinations(runs[0], 2))


def test_one_chair_is_what_the_gymnasium_environment_is(corner, made):
    alone, env = wcsim.WheelchairEnv(str(corner), overrides=TINY), made(chairs=1)
    seen: list[Any] = [alone.reset(seed=6)]
    seen += [tuple(alone.step(action_at(step))) for step in range(25)]
    alone.close()
    got = drive(env, 25, seed=6)
    env.close()
    assert equal(seen, [tuple(part["chair_0"] for part in item) for item in got])


@pytest.mark.parametrize("gone", [0, 1])
def test_who_has_ended_leaves_the_street_and_the_others_go_on(made, gone):
    """Also when it is the first one, which had the right to tick."""
    env = made(chairs=3)
    env.reset(seed=2)
    env.step(dict.fromkeys(env.agents, 44))
    world = env._chairs._group.home.world
    world.seats[gone].spec = SeatSpec(max_steps=2)
    parts = env.step(dict.fromkeys(env.agents, 44))
    assert all(list(part) == ["chair_0", "chair_1", "chair_2"] for part in parts)
    _, _, terminated, truncated, infos = parts
    assert [agent for agent, over in truncated.items() if over] == [f"chair_{gone}"]
    assert not any(terminated.values())
    assert infos[f"chair_{gone}"]["event_step"] == 2
    left = [seat for seat in range(3) if seat != gone]
    names = [f"chair_{seat}" for seat in left]
    assert (env.agents, env.num_agents) == (names, 2)
    for step in range(3, 6):
        parts = env.step(dict.fromkeys(names, 44))
        assert all(list(part) == names for part in parts)
        assert [info["event_step"] for info in parts[4].values()] == [step, step]
        assert [seat.index for seat in world.seats] == [client.seat for client in world.snapshot.clients] == left


def test_in_a_process_of_its_own_too_the_others_go_on_when_one_leaves(made):
    first, second = made(chairs=1), made(chairs=3)
    first.reset(seed=1)
    second.reset(seed=1)
    for gone in ("chair_0", "chair_1"):
        second.step(dict.fromkeys(second.agents, 44))
        second.agents.remove(gone)
        second._chairs.link(int(gone[-1])).close()
    infos = second.step({"chair_2": 44})[4]
    assert infos["chair_2"]["event_step"] == 3


def test_a_step_without_everybody_is_refused_and_nothing_moves(made):
    env = made(chairs=2)
    with pytest.raises(ProtocolError, match="expected one of each of"):
        env.step({"chair_0": 44})
    env.reset(seed=1)
    for wrong in ({}, {"chair_0": 44}, {"chair_0": 44, "chair_1": 44, "chair_2": 44}):
        with pytest.raises(ProtocolError, match=r"expected one of each of \['chair_0', 'chair_1'\]"):
            env.step(wrong)
    with pytest.raises(ProtocolError, match="a list; expected one of each of"):
        env.step([44, 44])
    for wrong in (81, -1, 1.5, float("nan"), "x", None):
        with pytest.raises(BadActionError, match="expected an integer from 0 to 80"):
            env.step({"chair_0": 44, "chair_1": wrong})
    infos = env.step({"chair_0": 44, "chair_1": 44})[4]
    assert [info["event_step"] for info in infos.values()] == [1, 1]
    env.close()
    env.close()
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_spaces_and_names_are_each_agents_own(made):
    env = made(chairs=2)
    assert env.possible_agents == ["chair_0", "chair_1"]
    assert env.max_num_agents == 2
    assert env.metadata["render_modes"] == ["rgb_array"]
    assert env.action_space("chair_0") is env.action_space("chair_0")
    assert env.action_space("chair_0") is not env.action_space("chair_1")
    observations, infos = env.reset(seed=1)
    assert all(env.observation_space(agent).contains(observations[agent]) for agent in env.agents)
    assert not np.array_equal(infos["chair_0"]["objects"].state.p_WB_m, infos["chair_1"]["objects"].state.p_WB_m)


def test_the_first_agents_picture_is_shown(made):
    env = made(chairs=2, render_mode="rgb_array")
    assert env.render() is None
    env.reset(seed=1)
    picture = env.render()
    assert picture.shape == (24, 32, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3
    env.close()
    plain = made(chairs=1)
    plain.reset(seed=1)
    assert plain.render() is None


def test_each_agent_has_reward_terms_of_its_own(made):
    env = made(chairs=3, reward_terms=(Counting(),))
    env.reset(seed=1)
    for step in range(1, 4):
        infos = env.step(dict.fromkeys(env.agents, 44))[4]
        assert [info["reward_extra"] for info in infos.values()] == [step] * 3


@pytest.mark.parametrize("chairs", [0, 65])
def test_a_number_of_chairs_that_cannot_be_is_refused(chairs):
    with pytest.raises(ConfigError, match="1 to 64"):
        wcsim.parallel_env(chairs=chairs)


def test_where_pettingzoo_is_missing_it_is_told_what_to_type(monkeypatch):
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    monkeypatch.delitem(sys.modules, "wcsim.agents.envs.parallel_env")
    with pytest.raises(AttributeError, match=r"pip install 'wcsim\[pettingzoo\]'"):
        _ = wcsim.parallel_env
