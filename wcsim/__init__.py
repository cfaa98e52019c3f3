"""wcsim: trains networks that assist the driver of a power wheelchair, in real cities.

Read `types.py`, then `bridge/world.py`. Importing this package names its environment for Gymnasium, which is
Gymnasium's own convention and the only thing that an import does; nothing heavy is loaded before one of the
environments is asked for.
"""

from importlib import import_module
from typing import Any

from gymnasium.envs.registration import register, registry

ENV_ID = "wcsim/Street-v1"
__version__ = "0.1.0"

__all__ = ["ENV_ID", "StreetVecEnv", "WheelchairEnv", "__version__", "parallel_env"]

if ENV_ID not in registry:
    register(id=ENV_ID, entry_point="wcsim.agents.env:WheelchairEnv")


def __getattr__(name: str) -> Any:
    """The environments, loaded when they are asked for: not by an import statement, which a world would inherit."""
    homes = {"StreetVecEnv": "vec_env", "WheelchairEnv": "env", "parallel_env": "parallel_env"}
    if name not in homes:
        raise AttributeError(f"module 'wcsim' has no attribute {name!r}")
    return getattr(import_module(f"wcsim.agents.{homes[name]}"), name)
