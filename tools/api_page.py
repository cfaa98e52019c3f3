"""`docs/api.md`: the public API, from the code."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterable, Iterator
from itertools import pairwise
from types import ModuleType
from typing import get_args, get_origin

import numpy as np

import wcsim
import wcsim.config
import wcsim.errors
import wcsim.types
from tools.pages import table
from wcsim.agents import policy_api
from wcsim.agents.envs.env_spec import EnvOptions
from wcsim.agents.networks import registry
from wcsim.bridge.sumo.step_hook import HookChair, StepHook
from wcsim.server.specs import Patience, SeatRequest
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.supervisor.observation import decode_depth
from wcsim.supervisor.rewards import RewardTerm
from wcsim.towns.making.maker import Wishes, make_town

LONGEST_VALUE = 60
HEAD = """# Public API

These names are stable: the changelog lists every change. All other names are internal and may change at any time.
`python -m tools.pages` generates this page from the code.
"""


def page() -> str:
    """The page, in Markdown."""
    parts = (
        ("`wcsim`: the environments", "See `docs/faces.md`.", _door(wcsim, wcsim.__all__)),
        ("Options of an environment", "The town, and the fields of `EnvOptions`.", _options()),
        (
            "`wcsim.types`: observations, events and commands",
            "",
            _door(wcsim.types, sorted(wcsim.types.__all__, key=str.lower)),
        ),
        (
            "`wcsim.config`: settings",
            "See `docs/settings.md`.",
            _door(wcsim.config, sorted(wcsim.config.__all__, key=str.lower)),
        ),
        ("`wcsim.agents.policy_api`: policies", "See `examples/own_policy.py`, `docs/suites.md`.", _policies()),
        ("A network", "See `examples/own_network.py` and the module's docstring.", _named(registry.register)),
        ("A reward term", "See `examples/own_reward.py`.", _with_methods(RewardTerm)),
        ("A step hook", "See `examples/own_signals.py`. Either method may be missing.", _hook()),
        ("Generated towns", "See `docs/authoring.md`.", _named(make_town, Wishes)),
        ("A seat in a running world", "See `docs/clients.md`.", _named(SeatRequest, Patience)),
        ("`wcsim.errors`: exceptions", "The top of `wcsim/errors.py` shows their hierarchy.", _errors()),
    )
    return "\n".join([HEAD, *(_section(title, said, rows) for title, said, rows in parts)])


def _section(title: str, said: str, rows: Iterable[tuple[str, str]]) -> str:
    lines = table(("name", "what"), ((f"`{name}`", what) for name, what in rows))
    return "\n".join([f"## {title}", *([said] if said else []), "", *lines, ""])


def _door(module: ModuleType, names: Iterable[str]) -> Iterator[tuple[str, str]]:
    for name in names:
        what = "the version of wcsim" if name == "__version__" else _first_line(getattr(module, name))
        if what:
            yield name, what


def _own(module: ModuleType) -> Iterator[tuple[str, str]]:
    """Classes of a module with their methods, in the order of the file."""
    for kind in vars(module).values():
        if inspect.isclass(kind) and kind.__module__ == module.__name__:
            yield from _with_methods(kind)


def _policies() -> Iterator[tuple[str, str]]:
    """Interfaces of policies, and what your own policy needs to read an observation and choose an action."""
    yield from _own(policy_api)
    yield from _with_methods(ActionSet)
    yield from _named(action_set, decode_depth)


def _with_methods(kind: type) -> Iterator[tuple[str, str]]:
    yield f"{kind.__module__}.{kind.__name__}", _first_line(kind)
    for name, member in vars(kind).items():
        if not name.startswith("_") and (inspect.isfunction(member) or isinstance(member, property)):
            yield f".{name}", _first_line(member)


def _hook() -> Iterator[tuple[str, str]]:
    yield from _with_methods(StepHook)
    yield from _named(HookChair)


def _named(*things: type | object) -> Iterator[tuple[str, str]]:
    for thing in things:
        yield f"{thing.__module__}.{thing.__name__}", _first_line(thing)  # type: ignore[attr-defined]


def _options() -> Iterator[tuple[str, str]]:
    """Name and text of the fields of `EnvOptions`, then those of `WheelchairEnv` alone."""
    (told,) = ast.parse(inspect.getsource(EnvOptions)).body
    for field, said in pairwise(getattr(told, "body", [])):
        if isinstance(field, ast.AnnAssign) and isinstance(said, ast.Expr):
            yield ast.unparse(field.target), " ".join(str(ast.literal_eval(said.value)).split())
    block = (inspect.getdoc(wcsim.WheelchairEnv.__init__) or "").partition("Args:\n")[2].partition("\n\n")[0]
    for item in re.split(r"\n {4}(?=[\w*])", "\n" + block)[1:]:
        name, _, text = item.partition(": ")
        if name.isidentifier():
            yield name, " ".join(text.split())


def _errors() -> Iterator[tuple[str, str]]:
    for name, kind in vars(wcsim.errors).items():
        if inspect.isclass(kind):
            yield name, _first_line(kind)


def _first_line(thing: object) -> str:
    """First line of a docstring; a short plain value as it is, "" for a long one."""
    if inspect.isclass(thing) or inspect.isfunction(thing) or isinstance(thing, property):
        return (inspect.getdoc(thing) or "").partition("\n")[0]
    if get_origin(thing) is np.ndarray:
        return f"NumPy array of {get_args(get_args(thing)[1])[0].__name__}"
    return f"`{thing}`" if len(str(thing)) < LONGEST_VALUE else ""
