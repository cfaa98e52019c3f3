"""A user's own classes, named `module:Class` on their own command line; importing a module runs its code.

They are never taken from a run folder, a policy or a town: what somebody else has written must not decide which code
runs here.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import re
import sys
import sysconfig
import traceback
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec, PathFinder
from modulefinder import ModuleFinder
from pathlib import Path
from types import ModuleType
from typing import Any

from wcsim.core.reading import escaped, is_file
from wcsim.errors import PolicyError, WcsimError

_SUFFIX, _PACKAGE = ".py", "__init__.py"
_MOST_TOLD = 200  # characters of what it said
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
        raise error(f"{what} {escaped(name)!r} is not module:Class, as in own_file:OwnClass")
    module_name, _, class_name = name.partition(":")
    if module_name.endswith(_SUFFIX):
        right = f"{module_name.removesuffix(_SUFFIX)}:{class_name}"
        raise error(
            f"{what} {escaped(name)!r} names a file; expected module:Class, without {_SUFFIX}: {right}"
        )
    found = getattr(_module(module_name, what, error), class_name, None)
    if not isinstance(found, type):
        raise error(f"{what} {name!r}: {module_name} has no class {class_name!r}; check the name")
    return found


@contextlib.contextmanager
def running_own(what: str, cure: str, error: type[WcsimError] = PolicyError) -> Iterator[None]:
    """While open, whatever a user's own code raises becomes one line that says where.

    Args:
        what: Whose code runs, and in what, for the message.
        cure: What to do about it.
        error: What to raise.

    Raises:
        WcsimError: The code raised something; of the kind `error` unless it was one already.
    """
    try:
        yield
    except WcsimError:
        raise
    except Exception as fault:  # the user's own code may raise anything
        raise error(f"{what}: {described(fault)}; {cure}") from fault


def described(fault: Exception) -> str:
    """What somebody's code raised, and where."""
    line = traceback.extract_tb(fault.__traceback__)[-1]
    return f"{type(fault).__name__}: {str(fault).strip()[:_MOST_TOLD]} ({line.filename}, line {line.lineno})"


def sources_of(name: str, what: str) -> dict[str, Path]:
    """The file of the module that `module:Class` names, and all beside it that it imports, at once or later.

    What is installed is left to its version, and wcsim to its own digest.

    Returns:
        By their names from the folder on in which the module was found.

    Raises:
        PolicyError: There is no such class.
    """
    module = name.partition(":")[0]
    find_class(name, what)
    own = Path(sys.modules[module].__file__ or "").absolute()
    folder = own.parents[module.count(".") + (own.name == _PACKAGE)]
    if str(folder) in map(sysconfig.get_path, ("purelib", "platlib", "stdlib")):
        return {own.name: own}
    finder = _Beside(path=[str(folder)], excludes=["wcsim"])
    with contextlib.suppress(ImportError):  # below a folder that is no package
        finder.import_hook(module)
    files = (getattr(each, "__file__", None) for each in finder.modules.values())
    found = {own, *(Path(file) for file in files if file)}
    return {path.relative_to(folder).as_posix(): path for path in sorted(found)}


def _module(name: str, what: str, error: type[WcsimError]) -> ModuleType:
    """Import a module; a file in the current folder wins over nothing else but a missing module."""
    try:
        if name in sys.modules or _is_found(name) or _look_here(name):
            return importlib.import_module(name)
    except Exception as fault:  # the user's own file may raise anything
        raise error(
            f"{what} module {name!r} failed to import: {type(fault).__name__}: {fault}"
        ) from fault
    raise error(
        f"{what} module {name!r} was not found{_cure(Path(name.replace('.', '/') + _SUFFIX))}"
    )


def _cure(file: Path) -> str:
    """What to do about a module that should be in this file."""
    bare = next((folder for folder in file.parents[-2::-1] if not is_file(folder / _PACKAGE)), None)
    if is_file(file) and bare is not None:
        return f": {bare} has no {_PACKAGE}; add one, an empty file is enough"
    return f"; expected {file} in {Path.cwd()} or on PYTHONPATH"


def _is_found(name: str) -> bool:
    """Whether Python finds it; the packages above it are imported."""
    head = name.rpartition(".")[0]
    return (not head or head in sys.modules or _is_found(head)) and importlib.util.find_spec(
        name
    ) is not None


def _look_here(name: str) -> bool:
    """Whether the current folder has it, which is looked through from now on: the module may import its neighbours."""
    importlib.invalidate_caches()
    if _CurrentFolder.find_spec(name.partition(".")[0]) is None:
        return False
    if _CurrentFolder not in sys.meta_path:
        sys.meta_path.append(_CurrentFolder)
    return _is_found(name)


class _Beside(ModuleFinder):
    """Finds what a module imports, without running it; a folder alone is no package here, and would end it."""

    def find_module(self, name: str, path: Any, parent: Any = None) -> Any:
        found = PathFinder.find_spec(name, self.path if path is None else path)
        if found is None or found.loader is None:
            raise ImportError(name)
        return super().find_module(name, path, parent)


class _CurrentFolder:
    """Finds modules and packages in the current folder, after all other places."""

    @classmethod
    def find_spec(
        cls, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Where a module is; a folder alone is no package here."""
        found = PathFinder.find_spec(fullname, [str(Path.cwd())], target) if path is None else None
        return found if found is not None and found.loader is not None else None
