"""A drive by another library's interface: `python other_libraries.py torchrl|minari|supersuit|tensors [TOWN]`."""

import sys
from typing import Any

import gymnasium
import numpy as np

import wcsim

STEPS = 12
SAME_STEP = gymnasium.vector.AutoresetMode.SAME_STEP


def torchrl(town: str, overrides: tuple[str, ...]) -> Any:
    """TorchRL reads all that is in `info`; pip install torchrl."""
    from torchrl.envs import GymWrapper

    env = GymWrapper(gymnasium.make_vec(wcsim.ENV_ID, num_envs=2, town=town, overrides=overrides))
    return env, env.rollout(STEPS, break_when_any_done=False)["next", "state"]


def minari(town: str, overrides: tuple[str, ...]) -> Any:
    """Minari stores it; pip install 'minari[create,hdf5]'."""
    from minari import DataCollector

    env = DataCollector(gymnasium.make(wcsim.ENV_ID, town=town, overrides=overrides), record_infos=True)
    env.reset(seed=1)
    for _ in range(STEPS):
        if any(env.step(env.action_space.sample())[2:4]):
            env.reset()
    return env, env.create_dataset("wcsim/drive-v0")[0].infos["state"]


def supersuit(town: str, overrides: tuple[str, ...]) -> Any:
    """SuperSuit makes a vector environment of PettingZoo's; pip install 'wcsim[pettingzoo]' supersuit."""
    from supersuit import black_death_v3, pettingzoo_env_to_vec_env_v1

    env = wcsim.parallel_env(town, overrides=(*overrides, "env.observation=state"))
    vector = pettingzoo_env_to_vec_env_v1(black_death_v3(env))
    vector.reset(seed=1)
    return env, np.array([vector.step([44, 44])[1] for _ in range(STEPS)])


def tensors(town: str, overrides: tuple[str, ...]) -> Any:
    """Gymnasium turns all into tensors; pip install array-api-compat."""
    from gymnasium.wrappers.vector import NumpyToTorch

    made = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": SAME_STEP}}
    env = NumpyToTorch(gymnasium.make_vec(wcsim.ENV_ID, num_envs=2, town=town, overrides=overrides, **made))
    env.reset(seed=1)
    return env, env.step(env.action_space.sample())[4]["state"]


if __name__ == "__main__":
    name, town = [*sys.argv[1:], "helsinki"][:2]
    env, seen = globals()[name](town, ())
    sys.stdout.write(f"{tuple(seen.shape)}\n")
    env.close()
