"""A user's own classes, named `module:Class` on their own command line; importing a module runs its code.

They are never taken from a run folder or a policy: what somebody else has written must not decide which code runs here.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from wcsim.errors import ConfigError, PolicyError
from wcsim.supervisor.reward_terms import RewardTerm


def find_class(name: str, what: str) -> type:
    """The class that `module:Class` names, from the Python path or a file in the current folder.

    Args:
        name: As the user wrote it.
        what: What it is for, in the messages.

    Raises:
        PolicyError: There is no such module or class, or importing it failed.
    """
    module_name, colon, class_name = name.partition(":")
    if not colon or not module_name or not class_name:
        raise PolicyError(f"{what} {name!r} is not module:Class, as in own_file:OwnClass")
    found = getattr(_module(module_name, what), class_name, None)
    if not isinstance(found, type):
        raise PolicyError(f"{what} {name!r}: {module_name} has no class {class_name!r}; correct the name")
    return found


def find_reward_term(name: str) -> RewardTerm:
    """A new reward term of the class that `module:Class` names. Raises ConfigError when it is not one."""
    kind = find_class(name, "reward term")
    if not all(callable(getattr(kind, method, None)) for method in ("reset", "reward")):
        raise ConfigError(f"reward term {name!r} needs the methods reset() and reward(before, after); see examples/")
    term: RewardTerm = kind()
    return term


def _module(name: str, what: str) -> ModuleType:
    """Import a module; a file in the current folder wins over nothing else but a missing module."""
    try:
        if name in sys.modules or importlib.util.find_spec(name) is not None:
            return importlib.import_module(name)
        path = Path.cwd() / (name.replace(".", "/") + ".py")
        if path.is_file():
            return _from_file(name, path)
    except PolicyError:
        raise
    except Exception as error:  # the user's own file may raise anything
        raise PolicyError(f"{what} module {name!r} failed to import: {type(error).__name__}: {error}") from error
    raise PolicyError(f"{what} module {name!r} was not found; expected {name}.py in {Path.cwd()} or on PYTHONPATH")


def _from_file(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise PolicyError(f"{path} cannot be imported; expected a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
