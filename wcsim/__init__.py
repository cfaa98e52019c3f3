"""wcsim trains networks that assist the driver of a power wheelchair, in simulated cities.

Read `types/`, then `bridge/world.py`. Importing this package registers its environment with
Gymnasium, as other environments do, and does nothing else. Gymnasium itself is not loaded: the
environment is registered as soon as Gymnasium is imported. Heavy libraries are loaded when an
environment is first used.
"""

import sys as _sys
from importlib import import_module as _import_module
from types import ModuleType as _ModuleType
from typing import TYPE_CHECKING

from wcsim.core.on_load import call_on_import as _on_load
from wcsim.errors import ConfigError as _ConfigError
from wcsim.errors import check_installed as _check_installed

if TYPE_CHECKING:  # for editors and type checkers; at run time `__getattr__` loads them
    from wcsim.agents.envs.parallel_env import parallel_env
    from wcsim.agents.envs.vec_env import StreetVecEnv
    from wcsim.agents.envs.wheelchair_env import WheelchairEnv

    __version__: str

ENV_ID = "wcsim/Street-v1"

__all__ = ["ENV_ID", "StreetVecEnv", "WheelchairEnv", "__version__", "parallel_env"]


_HOMES = {
    "StreetVecEnv": ("vec_env", "stable_baselines3", "torch"),
    "WheelchairEnv": ("wheelchair_env",),
    "parallel_env": ("parallel_env", "pettingzoo"),
}

# `from wcsim import *` takes what can be loaded.
for _name, (_, *_libraries) in _HOMES.items():
    try:
        _check_installed(_name, "", *_libraries)
    except _ConfigError:
        __all__.remove(_name)


def _name_environment(gymnasium: _ModuleType) -> None:
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(
            id=ENV_ID,
            entry_point="wcsim.agents.envs.wheelchair_env:WheelchairEnv",
            vector_entry_point="wcsim.agents.envs.vector_env:StreetVectorEnv",
            max_episode_steps=10_000,  # as env.max_steps; a literal, for nothing is loaded here
        )


_on_load("gymnasium.envs.registration", _name_environment)


class _Cure:
    """Finds no module, but lets `from wcsim import NAME` raise the error that tells the cure."""

    @staticmethod
    def find_spec(name: str, *_: object) -> None:
        home = name.removeprefix("wcsim.")
        if home in _HOMES and home not in __all__:
            _import_module(f"wcsim.agents.envs.{_HOMES[home][0]}")


_sys.meta_path.append(_Cure)


def __dir__() -> list[str]:
    """The public names, also those that load later: `dir(wcsim)` and editors show them."""
    needed = ("TYPE_CHECKING", "core", "errors")  # by this file
    shown = (
        name for name in globals() if name not in needed and (name[0] != "_" or name[:2] == "__")
    )
    return sorted({*__all__, *shown})


def __getattr__(name: str) -> object:
    """Load the environments and the version on first use, so that `import wcsim` stays fast."""
    if name == "__version__":
        from importlib.metadata import version

        return version("wcsim")  # of pyproject.toml, as it was installed
    if name not in _HOMES:
        raise AttributeError(f"module 'wcsim' has no attribute {name!r}")
    try:
        return getattr(_import_module(f"wcsim.agents.envs.{_HOMES[name][0]}"), name)
    except _ConfigError as error:
        # What lists all names, as `help` does, skips those with this error.
        raise AttributeError(str(error)) from None
