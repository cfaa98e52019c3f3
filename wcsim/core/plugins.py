"""A user's own classes, named `module:Class` on the command line; importing one runs its code.

They are never taken from a run folder, a policy or a town: a file of another person must not decide
which code runs here.
"""

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
from typing import Any, Final

from wcsim.core.reading import escape, is_file
from wcsim.errors import PolicyError, WcsimError

_SUFFIX: Final = ".py"
_PACKAGE: Final = "__init__.py"
_MOST_CHARACTERS: Final = 200  # of an error's message
_NAME: Final = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")


def import_class(name: str, what: str, error: type[WcsimError] = PolicyError) -> type:
    """The class that `module:Class` names, from the Python path or a file in the current folder.

    Args:
        name: As the user wrote it.
        what: Its purpose, for the messages.
        error: What to raise.

    Raises:
        WcsimError: There is no such module or class, or importing it failed; of the kind `error`.
    """
    # A path, absolute or with "..", would reach any file.
    if not _NAME.fullmatch(name):
        raise error(f"{what} {escape(name)!r} is not module:Class, as in own_file:OwnClass")
    module_name, _, class_name = name.partition(":")
    if module_name.endswith(_SUFFIX):
        right = f"{module_name.removesuffix(_SUFFIX)}:{class_name}"
        raise error(
            f"{what} {escape(name)!r} names a file; expected module:Class, without {_SUFFIX}: "
            f"{right}"
        )
    found = getattr(_module(module_name, what, error), class_name, None)
    if not isinstance(found, type):
        raise error(f"{what} {name!r}: {module_name} has no class {class_name!r}; check the name")
    return found


@contextlib.contextmanager
def wrap_user_code_errors(
    what: str, cure: str, error: type[WcsimError] = PolicyError
) -> Iterator[None]:
    """While open, whatever a user's own code raises becomes one line with its place.

    Args:
        what: The code that runs, for the message.
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
        raise error(f"{what}: {describe_user_code_error(fault)}; {cure}") from fault


def describe_user_code_error(fault: Exception) -> str:
    """An error of a user's code, and its place."""
    line = traceback.extract_tb(fault.__traceback__)[-1]
    message = str(fault).strip()[:_MOST_CHARACTERS]
    return f"{type(fault).__name__}: {message} ({line.filename}, line {line.lineno})"


def find_user_class_files(name: str, what: str) -> dict[str, Path]:
    """The files of the module that `module:Class` names, and of all beside it that it imports.

    Imports in functions count, too. Installed packages are known by their version, wcsim by its own
    digest.

    Returns:
        By their names from the folder on in which the module was found.

    Raises:
        PolicyError: There is no such class.
    """
    module = name.partition(":")[0]
    import_class(name, what)
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
    """Import a module; the current folder counts only where it is found nowhere else."""
    try:
        if name in sys.modules or _is_found(name) or _is_found_here(name):
            return importlib.import_module(name)
    except Exception as fault:  # the user's own file may raise anything
        raise error(
            f"{what} module {name!r} failed to import: {type(fault).__name__}: {fault}"
        ) from fault
    file = Path(name.replace(".", "/") + _SUFFIX)
    for folder in file.parents[-2::-1] if is_file(file) else ():
        if not is_file(folder / _PACKAGE):
            raise error(
                f"{what} module {name!r} was not found: {folder} has no {_PACKAGE}; add one, an "
                "empty file is enough"
            )
    raise error(
        f"{what} module {name!r} was not found; expected {file} in {Path.cwd()} or on PYTHONPATH"
    )


def _is_found(name: str) -> bool:
    """Whether Python finds it; the packages above it are imported."""
    head = name.rpartition(".")[0]
    if head and head not in sys.modules and not _is_found(head):
        return False
    return importlib.util.find_spec(name) is not None


def _is_found_here(name: str) -> bool:
    """Whether the current folder has it; then Python searches this folder from now on.

    The module may import its neighbours.
    """
    importlib.invalidate_caches()
    if _CurrentFolder.find_spec(name.partition(".")[0]) is None:
        return False
    if _CurrentFolder not in sys.meta_path:
        sys.meta_path.append(_CurrentFolder)
    return _is_found(name)


class _Beside(ModuleFinder):
    """Finds what a module imports, without running it.

    A folder without `__init__.py` is no package here, and would end the search.
    """

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
        """The place of a module; a folder without `__init__.py` is no package here."""
        found = PathFinder.find_spec(fullname, [str(Path.cwd())], target) if path is None else None
        return found if found is not None and found.loader is not None else None
