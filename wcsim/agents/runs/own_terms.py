"""A user's own reward terms, named `module:Class`; see `wcsim.core.plugins`."""

from __future__ import annotations

from wcsim.core.plugins import find_class
from wcsim.errors import ConfigError
from wcsim.supervisor.rewards import RewardTerm, is_reward_term


def find_reward_term(name: str) -> RewardTerm:
    """A new reward term of the class that `module:Class` names. Raises ConfigError when it is not one."""
    kind = find_class(name, "reward term")
    if not is_reward_term(kind):
        raise ConfigError(f"reward term {name!r} needs the methods reset() and reward(before, after); see examples/")
    term: RewardTerm = kind()
    return term
