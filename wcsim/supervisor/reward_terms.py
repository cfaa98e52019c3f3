"""The user's own reward term: a class with two methods, named `module:Class` on the command line."""

from __future__ import annotations

from typing import Protocol

from wcsim.core.plugins import find_class
from wcsim.errors import ConfigError
from wcsim.types import ClientSnapshot


class RewardTerm(Protocol):
    """An additional reward term, computed from the snapshots before and after a tick."""

    def reset(self) -> None:
        """An episode starts."""

    def reward(self, before: ClientSnapshot, after: ClientSnapshot) -> float:
        """What this tick adds to the reward."""


def is_reward_term(value: object) -> bool:
    """Whether an object, or the objects of a class, have these methods."""
    return all(callable(getattr(value, method, None)) for method in ("reset", "reward"))


def find_reward_term(name: str) -> RewardTerm:
    """A new reward term of the class that `module:Class` names. Raises ConfigError when it is not one."""
    kind = find_class(name, "reward term")
    if not is_reward_term(kind):
        raise ConfigError(f"reward term {name!r} needs the methods reset() and reward(before, after); see examples/")
    term: RewardTerm = kind()
    return term
