"""Calls a function with a library as soon as that is loaded, without loading it for that."""

import sys
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

Action = Callable[[ModuleType], None]


def call_on_import(module: str, act: Action) -> None:
    """Call `act` with a module: now if it is loaded, else right after its first load."""
    loaded = sys.modules.get(module)
    if loaded is not None:
        act(loaded)
    else:
        sys.meta_path.insert(0, _Watch(module, act))


class _Watch(MetaPathFinder):
    """Finds nothing of its own: it only lets `act` follow the module that the others find."""

    def __init__(self, module: str, act: Action) -> None:
        self._module = module
        self._act = act

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != self._module:
            return None
        # Once: it stays in the list, as other threads may be walking through that just now.
        self._module = ""
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            spec.loader = _Followed(spec.loader, self._act)
        return spec


class _Followed(Loader):
    """A module's own loader, and then `act`."""

    def __init__(self, own: Loader, act: Action) -> None:
        self._own = own
        self._act = act

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._own.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        # The module's source is read through its own loader.
        if module.__spec__ is not None:
            module.__spec__.loader = module.__loader__ = self._own
        self._own.exec_module(module)
        self._act(module)
