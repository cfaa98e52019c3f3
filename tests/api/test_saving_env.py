"""Moments of an environment that are gone back to: to the bit, as often as one likes."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from wcsim.agents.envs.env_spec import EnvOptions
from wcsim.agents.envs.saving_env import SavingEnv
from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.errors import BadActionError, ProtocolError

OPTIONS = EnvOptions(overrides=("world.warmup_s=2", "env.observation=state"))


@pytest.fixture
def env(corner: Path) -> Iterator[SavingEnv]:
    made = SavingEnv(str(corner), **OPTIONS)
    yield made
    made.close()


def driven(env: SavingEnv | WheelchairEnv, actions: Sequence[int]) -> list[tuple[bytes, float]]:
    """What an agent sees and gets for these actions."""
    steps = (env.step(action) for action in actions)
    return [(np.asarray(seen).tobytes(), float(reward)) for seen, reward, *_ in steps]


def test_a_moment_goes_on_as_it_did_and_as_without_moments(env: SavingEnv, corner: Path) -> None:
    env.reset(seed=4)
    plain = WheelchairEnv(str(corner), **OPTIONS)
    plain.reset(seed=4)
    before, after = driven(plain, [1] * 5), driven(plain, [1, 2] * 10)
    plain.close()
    assert driven(env, [1] * 5) == before
    moment = env.save()
    other = driven(env, [3] * 20)
    assert other != after
    for _ in range(2):
        env.restore(moment)
        assert driven(env, [1, 2] * 10) == after
    env.restore(moment)
    assert driven(env, [3] * 20) == other
    moment.close()


def test_moments_of_moments(env: SavingEnv) -> None:
    env.reset(seed=4)
    first = env.save()
    driven(env, [1] * 4)
    second = env.save()
    ahead = driven(env, [1] * 4)
    env.restore(first)
    assert driven(env, [1] * 8)[4:] == ahead
    env.restore(second)
    assert driven(env, [1] * 4) == ahead
    first.close()
    with pytest.raises(ProtocolError, match="ended"):
        env.restore(first)
    second.close()


def test_another_seed_after_a_moment_is_a_world_as_any(env: SavingEnv) -> None:
    seen, _ = env.reset(seed=4)
    moment = env.save()
    env.reset(seed=5)
    env.restore(moment)
    driven(env, [1] * 3)
    again, _ = env.reset(seed=4)
    assert np.asarray(again).tobytes() == np.asarray(seen).tobytes()
    env.close()
    env.restore(moment)  # it outlives its environment
    driven(env, [1] * 3)
    moment.close()


def test_it_is_an_environment_as_any_and_tells_faults(env: SavingEnv) -> None:
    with pytest.raises(ProtocolError, match="reset"):
        env.save()
    check_env(env, skip_render_check=True)
    with pytest.raises(BadActionError):
        env.step(10_000)
    driven(env, [1])
