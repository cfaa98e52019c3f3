"""A user's own step hook: a class that gets the libsumo module and may run its own logic around every step of SUMO.

It is named `module:Class` on the user's own command line, and nowhere else: a town that somebody else made cannot
bring code along.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

from wcsim.core.plugins import find_class, running_own
from wcsim.errors import HookError

_METHODS = ("before_step", "after_step")


def find_hook(name: str) -> type:
    """The class that `module:Class` names. Raises HookError when there is none, or it has no method to call."""
    kind = find_class(name, "step hook", HookError)
    if not any(callable(getattr(kind, method, None)) for method in _METHODS):
        raise HookError(f"step hook {name!r} has neither {' nor '.join(_METHODS)}; expected a method (self, time_s)")
    return kind


class StepHook:
    """One object of the user's class; it lives as long as the traffic of one epoch."""

    def __init__(self, name: str, libsumo: ModuleType) -> None:
        """Make it. Raises HookError when there is no such class, it has no method to call, or making it failed."""
        self.name = name
        self._own = self._run("__init__", find_hook(name), libsumo)

    def before_step(self, time_s: float) -> None:
        """Call the user's `before_step`, if there is one. Raises HookError when it fails."""
        self._call("before_step", time_s)

    def after_step(self, time_s: float) -> None:
        """Call the user's `after_step`, if there is one. Raises HookError when it fails."""
        self._call("after_step", time_s)

    def _call(self, method: str, time_s: float) -> None:
        own = getattr(self._own, method, None)
        if own is not None:
            self._run(method, own, time_s)

    def _run(self, what: str, call: Callable[..., Any], argument: object) -> Any:
        what = f"step hook {self.name!r} failed in {what}"
        with running_own(what, "correct it, or run without --hook", HookError):
            return call(argument)


def open_hook(name: str, libsumo: ModuleType) -> StepHook | None:
    """The hook of that name; None for an empty name."""
    return StepHook(name, libsumo) if name else None
