"""A user's own step hook: a class that runs its own logic around every step of SUMO.

It gets the libsumo module. SUMO has no wheelchairs, so the hook gets them beside it: those of tick
n, around the step that leads to n + 1. It is named `module:Class` on the user's own command line,
and nowhere else: a town that somebody else made cannot bring code along.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from wcsim.core.plugins import import_class, wrap_user_code_errors
from wcsim.errors import HookError

_METHODS = ("before_step", "after_step")
_MARK = "wcsim.step-hook"  # a parameter of the net, which a net that is loaded later does not have


@dataclass(frozen=True, slots=True, kw_only=True)
class HookChair:
    """A wheelchair as a step hook sees it, in the coordinates of SUMO's net."""

    seat: int
    p_net_m: tuple[float, float, float]  # on the ground, below the middle of the drive axle
    angle_deg: float  # as SUMO's: clockwise from north
    speed_mps: float  # ahead
    way_net_m: tuple[tuple[float, float], ...]  # from where it is to its destination
    # Of that way, in SUMO's ids: pavements, walking areas, crossings; first where it is.
    edges: tuple[str, ...]
    button_tls_id: str  # the traffic light whose button it has pressed and that is red; "" for none


class StepHook:
    """One object of the user's class; it lives until the world starts again."""

    def __init__(self, name: str, libsumo: ModuleType) -> None:
        """Make it. Raises HookError as `find_hook` does, or when making it failed."""
        self.name, self._libsumo = name, libsumo
        libsumo.simulation.setParameter("", _MARK, name)
        self._own = self._run("__init__", find_hook(name), libsumo)

    def before_step(self, time_s: float, chairs: Sequence[HookChair]) -> None:
        """Call the user's `before_step`, if there is one. Raises HookError when it fails."""
        self._call("before_step", time_s, chairs)

    def after_step(self, time_s: float, chairs: Sequence[HookChair]) -> None:
        """Call the user's `after_step`, if there is one. Raises HookError when it fails."""
        self._call("after_step", time_s, chairs)

    def _call(self, method: str, time_s: float, chairs: Sequence[HookChair]) -> None:
        own = getattr(self._own, method, None)
        if own is not None:
            self._run(method, own, time_s, chairs)

    def _run(self, what: str, call: Callable[..., Any], *arguments: object) -> Any:
        hook, before = f"step hook {self.name!r}", self._moment()
        failed, cure = f"{hook} failed in {what}", "correct it, or run without --hook"
        with wrap_user_code_errors(failed, cure, HookError):
            returned = call(*arguments)
        if self._moment() != before:
            raise HookError(
                f"{hook} stepped, loaded or closed the simulation in {what}; "
                "expected wcsim alone to do so: remove that"
            )
        return returned

    def _moment(self) -> object:
        """What no hook may change: SUMO's time, and the net's mark; False without a simulation."""
        sumo = self._libsumo
        if not sumo.isLoaded():
            return False
        return sumo.simulation.getTime(), sumo.simulation.getParameter("", _MARK)


def find_hook(name: str) -> type:
    """The class that `module:Class` names; HookError without one, or without a method to call."""
    kind = import_class(name, "step hook", HookError)
    if not any(callable(getattr(kind, method, None)) for method in _METHODS):
        raise HookError(
            f"step hook {name!r} has neither {' nor '.join(_METHODS)}; "
            "expected a method (self, time_s, chairs)"
        )
    return kind
