"""How the others watch out: who looks for wheelchairs, and how long it takes those who do, by class and by world."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from wcsim.bridge.reaction.commands import Attention
from wcsim.config import STREETS, WorldConfig
from wcsim.config.randomization import EVERYBODY, VaryConfig
from wcsim.core import seeding
from wcsim.types import ActorKind, ActorState

Name = TypeVar("Name", bound=str)
Value = TypeVar("Value")


class AttentionModel:
    """The share of those who look and their reaction time, for one world from its beginning to its end."""

    def __init__(self, config: WorldConfig, seed: int, vary: VaryConfig = VaryConfig()) -> None:  # noqa: B008 - frozen
        """Draw what `vary` has ranges for.

        Args:
            config: Shares and times; an entry by class goes before those for everybody.
            seed: Of the street. The same one gives the same draws, and one more range changes none of the others.
            vary: Ranges; one by class goes before all, one for everybody before `config`'s numbers for everybody.
        """
        usual = STREETS[config.street] or (config.attention_share, config.reaction_s)
        shares = _by_class(_plain(config.attention), _plain(vary.attention), usual[0], seed, "attention")
        self._reaction_s = _by_class(_plain(config.reaction), _plain(vary.reaction), usual[1], seed, "reaction")
        self._attention = {kind: Attention(share, seed) for kind, share in shares.items()}

    @property
    def people(self) -> Attention:
        """Who of the people on foot looks."""
        return self._attention[ActorKind.PEDESTRIAN]

    def looks(self, actor: ActorState) -> bool:
        """Whether this one notices wheelchairs at all."""
        return self._attention[actor.kind].looks(actor.id)

    def reaction_s(self, actor: ActorState) -> float:
        """Seconds from when a wheelchair can be seen to when it brakes for it."""
        return self._reaction_s[actor.kind]


def _plain(by_class: Mapping[Name, Value]) -> dict[str, Value]:
    return {str(name): value for name, value in by_class.items()}


def _by_class(
    given: Mapping[str, float], ranges: Mapping[str, tuple[float, float]], usual: float, seed: int, name: str
) -> dict[ActorKind, float]:
    """The number of every kind of actor."""

    def drawn(key: str) -> float:
        return float(seeding.generator(seed, "vary", name, key).uniform(*ranges[key]))

    rest = drawn(EVERYBODY) if EVERYBODY in ranges else usual
    found = {}
    for kind in ActorKind:
        key = kind.value
        found[kind] = drawn(key) if key in ranges else given.get(key, rest)
    return found
