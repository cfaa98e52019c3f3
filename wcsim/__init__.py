"""wcsim: trains networks that assist the driver of a power wheelchair, in real cities.

Read `types/`, then `bridge/world.py`. Importing this package names its environment for Gymnasium, which is
Gymnasium's own convention and the only thing that an import does. Gymnasium itself is not loaded by it (the name is
there as soon as somebody loads it), and nothing heavy before one of the environments is asked for.
"""

from types import ModuleType as _ModuleType
from typing import TYPE_CHECKING

from wcsim.core.on_load import on_load as _on_load

if TYPE_CHECKING:  # for editors and type checkers; at run time `__getattr__` loads them
    from wcsim.agents.envs.parallel_env import parallel_env
    from wcsim.agents.envs.vec_env import StreetVecEnv
    from wcsim.agents.envs.wheelchair_env import WheelchairEnv

ENV_ID = "wcsim/Street-v1"
__version__ = "0.1.0"

__all__ = ["ENV_ID", "StreetVecEnv", "WheelchairEnv", "__version__", "parallel_env"]


def _name_environment(gymnasium: _ModuleType) -> None:
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(id=ENV_ID, entry_point="wcsim.agents.envs.wheelchair_env:WheelchairEnv")


_on_load("gymnasium.envs.registration", _name_environment)


def __dir__() -> list[str]:
    """What `dir(wcsim)` and an editor's completion show: the faces among it, and only what is meant to be used."""
    needed = ("TYPE_CHECKING", "core")  # by this file
    shown = (name for name in globals() if name not in needed and (name[0] != "_" or name[:2] == "__"))
    return sorted({*__all__, *shown})


def __getattr__(name: str) -> object:
    """The environments, loaded when they are asked for: not by an import statement, which a world would inherit."""
    homes = {"StreetVecEnv": "vec_env", "WheelchairEnv": "wheelchair_env", "parallel_env": "parallel_env"}
    if name not in homes:
        raise AttributeError(f"module 'wcsim' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"wcsim.agents.envs.{homes[name]}"), name)
