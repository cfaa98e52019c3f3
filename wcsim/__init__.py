"""wcsim: trains networks that assist the driver of a power wheelchair, in real cities.

Read `types/`, then `bridge/world.py`. Importing this package names its environment for Gymnasium, which is
Gymnasium's own convention and the only thing that an import does; nothing heavy is loaded before one of the
environments is asked for.
"""

from typing import TYPE_CHECKING

from gymnasium.envs import registration as _gymnasium

if TYPE_CHECKING:  # for editors and type checkers; at run time `__getattr__` loads them
    from wcsim.agents.envs.parallel_env import parallel_env
    from wcsim.agents.envs.vec_env import StreetVecEnv
    from wcsim.agents.envs.wheelchair_env import WheelchairEnv

ENV_ID = "wcsim/Street-v1"
__version__ = "0.1.0"

__all__ = ["ENV_ID", "StreetVecEnv", "WheelchairEnv", "__version__", "parallel_env"]

if ENV_ID not in _gymnasium.registry:
    _gymnasium.register(id=ENV_ID, entry_point="wcsim.agents.envs.wheelchair_env:WheelchairEnv")


def __dir__() -> list[str]:
    """What `dir(wcsim)` and an editor's completion show: the faces among it, and only what is meant to be used."""
    shown = (name for name in globals() if name != "TYPE_CHECKING" and (name[0] != "_" or name[:2] == "__"))
    return sorted({*__all__, *shown})


def __getattr__(name: str) -> object:
    """The environments, loaded when they are asked for: not by an import statement, which a world would inherit."""
    homes = {"StreetVecEnv": "vec_env", "WheelchairEnv": "wheelchair_env", "parallel_env": "parallel_env"}
    if name not in homes:
        raise AttributeError(f"module 'wcsim' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"wcsim.agents.envs.{homes[name]}"), name)
