"""What other libraries do with the environments; those that are not installed are skipped."""

import runpy
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo
from pettingzoo.test import api_test
from pettingzoo.test.state_test import state_test
from pettingzoo.utils import parallel_to_aec

import wcsim
from tests.api.streets import TINY
from tests.api.test_env import EXAMPLES, FACES
from tests.support.typed import python_says
from wcsim.agents.envs.vector_env import StreetVectorEnv
from wcsim.errors import ConfigError, ProtocolError

SHORT = (*TINY, "env.max_steps=6", "env.truth=true", "sensors.odometry=typical")
NUMBERS = (*TINY, "env.max_steps=6", "env.observation=state")


def needs(module: str) -> Any:
    return pytest.importorskip(module, reason=f"{module} is not installed", exc_type=ImportError)


def plain(value: Any) -> bool:
    """Whether there are only numbers and arrays of them in it."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.dtype.kind == "O"):
        return all(map(plain, value))
    return np.asarray(value).dtype.kind in "biuf"


def test_info_holds_numbers_and_arrays_alone_in_every_face(corner):
    for face, step in FACES:
        with closing(face(str(corner), overrides=SHORT)) as env:
            assert plain([env.reset(), *(step(env) for _ in range(6)), getattr(env, "reset_infos", [])])


def test_no_key_of_info_is_one_of_the_observation(corner):
    with closing(wcsim.WheelchairEnv(str(corner), overrides=SHORT)) as env:
        observation, info = env.reset()
    assert observation.keys().isdisjoint(info) and info.keys() >= {"reading_odometry", "truth_first_s", "warning"}


@pytest.mark.filterwarnings("ignore::UserWarning")  # of what a dataset should say of itself
@pytest.mark.parametrize(
    ("name", "needed"),
    [("torchrl", "torchrl"), ("minari", "jax"), ("supersuit", "supersuit"), ("tensors", "array_api_compat")],
)
def test_the_example_of_a_library_drives(corner, name, needed, tmp_path, monkeypatch):
    needs(needed)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env, seen = runpy.run_path(str(EXAMPLES / "other_libraries.py"))[name](str(corner), SHORT)
    env.close()
    assert tuple(seen.shape) == {"torchrl": (2, 12, 15), "minari": (7, 15), "supersuit": (12, 2)}.get(name, (2, 15))


@pytest.mark.filterwarnings("ignore")
def test_rllib_learns(corner):
    needs("ray.rllib")
    learn = runpy.run_path(str(EXAMPLES / "rllib_ppo.py"))["learn"]
    (means,) = learn(str(corner), 1, NUMBERS, batch=40)
    assert np.isfinite(means["episode_return_mean"])


def test_gymnasium_films_an_episode(corner, tmp_path):
    needs("moviepy")
    own = wcsim.WheelchairEnv(str(corner), overrides=SHORT, render_mode="rgb_array")
    with closing(RecordVideo(own, str(tmp_path / "films"))) as env:
        env.reset()
        while not any(env.step(40)[2:4]):
            pass
    assert (tmp_path / "films" / "rl-video-episode-0.mp4").is_file()


@pytest.mark.filterwarnings("ignore:The observation contains negative numbers")
def test_pettingzoos_tests_of_agents_in_turn_and_of_states_find_nothing(corner):
    several = wcsim.parallel_env(str(corner), overrides=NUMBERS)
    assert several.metadata["is_parallelizable"]
    with pytest.raises(ProtocolError, match="call reset"):
        several.state()
    with closing(parallel_to_aec(several)) as env:
        api_test(env, num_cycles=20)
        state_test(env, several, num_cycles=5)


def test_evaluators_find_the_task_and_the_length_of_an_episode():
    for face in (wcsim.WheelchairEnv, StreetVectorEnv):
        env = face(overrides=SHORT)
        assert (env._max_episode_steps, env.task) == (6, "drive") and "wheelchair" in env.task_description


BARE = """
import inspect, pydoc, sys
class Hiding:
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in ("pettingzoo", "stable_baselines3", "torch"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hiding())
import wcsim
found = {}
exec("from wcsim import *", found)
assert "WheelchairEnv" in found and "parallel_env" not in found
assert "WheelchairEnv" in dict(inspect.getmembers(wcsim))
assert "class WheelchairEnv" in pydoc.plain(pydoc.render_doc(wcsim))
for name in ("parallel_env", "StreetVecEnv"):
    assert not hasattr(wcsim, name)
    for line in (f"wcsim.{name}", f"from wcsim import {name}"):
        try:
            exec(line)
        except Exception as error:
            print(type(error).__name__, str(error).split()[-1])
"""


def test_help_and_the_star_leave_out_what_is_not_installed_and_its_own_name_tells_the_cure():
    assert python_says(BARE).split() == [
        *("AttributeError", "'wcsim[pettingzoo]'", "ConfigError", "'wcsim[pettingzoo]'"),
        *("AttributeError", "'wcsim[train]'", "ConfigError", "'wcsim[train]'"),
    ]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_reward_that_is_no_number_is_refused_with_its_term_and_reset_goes_on(corner, value):
    class Broken:
        def reset(self) -> None: ...

        def reward(self, *frames: Any) -> Any:
            return value

    for face, step in FACES:
        with closing(face(str(corner), overrides=TINY, reward_terms=[Broken()])) as env:
            for _ in range(2):
                env.reset()
                with pytest.raises(
                    ConfigError, match=f"^reward term Broken returned {value} in step 1 .*finite number.*$"
                ):
                    step(env)


@pytest.mark.parametrize(("name", "told"), [("reset_mask", "expected none"), ("overides", "did you mean 'overrides'")])
def test_options_of_a_reset_are_refused_before_a_world_is_made(corner, name, told):
    for face, _ in FACES:
        env = face(str(corner))
        with pytest.raises(ConfigError, match=f"reset.. got the option '{name}'.*{told}"):
            if isinstance(env, wcsim.StreetVecEnv):
                env.set_options({name: 1})
                env.reset()
            env.reset(options={name: 1})
