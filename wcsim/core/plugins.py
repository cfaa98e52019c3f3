"""A user's own classes, named `module:Class` on their own command line; importing a module runs its code.

They are never taken from a run folder, a policy or a town: what somebody else has written must not decide which code
runs here.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

from wcsim.core.reading import shown
from wcsim.errors import PolicyError, WcsimError

_SUFFIX = ".py"
_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")


def find_class(name: str, what: str, error: type[WcsimError] = PolicyError) -> type:
    """The class that `module:Class` names, from the Python path or a file in the current folder.

    Args:
        name: As the user wrote it.
        what: What it is for, in the messages.
        error: What to raise.

    Raises:
        WcsimError: There is no such module or class, or importing it failed; of the kind `error`.
    """
    if not _NAME.fullmatch(name):  # a path, absolute or with "..", would reach any file
        raise error(f"{what} {shown(name)!r} is not module:Class, as in own_file:OwnClass")
    module_name, _, class_name = name.partition(":")
    if module_name.endswith(_SUFFIX):
        right = f"{module_name.removesuffix(_SUFFIX)}:{class_name}"
        raise error(f"{what} {shown(name)!r} names a file; expected module:Class, without {_SUFFIX}: {right}")
    found = getattr(_module(module_name, what, error), class_name, None)
    if not isinstance(found, type):
        raise error(f"{what} {name!r}: {module_name} has no class {class_name!r}; correct the name")
    return found


def _module(name: str, what: str, error: type[WcsimError]) -> ModuleType:
    """Import a module; a file in the current folder wins over nothing else but a missing module."""
    try:
        if name in sys.modules or importlib.util.find_spec(name) is not None:
            return importlib.import_module(name)
        path = Path.cwd() / (name.replace(".", "/") + ".py")
        if path.is_file():
            return _from_file(name, path, error)
    except error:
        raise
    except Exception as fault:  # the user's own file may raise anything
        raise error(f"{what} module {name!r} failed to import: {type(fault).__name__}: {fault}") from fault
    raise error(f"{what} module {name!r} was not found; expected {name}.py in {Path.cwd()} or on PYTHONPATH")


def _from_file(name: str, path: Path, error: type[WcsimError]) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise error(f"{path} cannot be imported; expected a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
