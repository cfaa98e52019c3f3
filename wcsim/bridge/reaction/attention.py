"""How the others watch out: who looks for wheelchairs, and how long it takes them, by class.

A world has habits of its own. Where `[vary]` has ranges for them, the habits towards each chair
differ in each episode.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

from wcsim.config import STREETS, WorldConfig
from wcsim.config.world import EVERYBODY
from wcsim.core import seeding
from wcsim.types import ActorKind, ActorState, Drawn


@dataclass(frozen=True, slots=True)
class Attention:
    """Who looks out for wheelchairs: a property of the actor and of the seed.

    An actor that looks at one share looks at every larger share too.
    """

    share: float
    seed: int

    def looks(self, actor_id: str) -> bool:
        """Whether this actor notices wheelchairs at all."""
        return self.share >= 1.0 or _draw_chance(self.seed, actor_id) < self.share


class AttentionModel:
    """The share of those who look and their reaction time, by class."""

    def __init__(self, config: WorldConfig, seed: int, drawn: Drawn = Drawn()) -> None:  # noqa: B008 - frozen
        """Those of a street, or those towards a chair for which others were drawn.

        Args:
            config: Shares and times; an entry by class goes before those for everybody.
            seed: Of the street; the same one gives the same actors who look.
            drawn: Of an episode; a number by class goes before all, one for everybody before
                `config`'s for everybody.
        """
        self._config, self._seed = config, seed
        share, usual_s = STREETS[config.street] or (config.attention_share, config.reaction_s)
        # Where nobody looks, a careless street changes nothing.
        share = min(share, config.attention_share)
        shares = _by_class(config.attention.items(), drawn.attention, share)
        self._attention = {kind: Attention(value, seed) for kind, value in shares.items()}
        self._reaction_s = _by_class(config.reaction.items(), drawn.reaction_s, usual_s)

    def towards(self, drawn: Drawn) -> AttentionModel | None:
        """Those of this street towards a chair in an episode; None when nothing was drawn."""
        if not (drawn.attention or drawn.reaction_s):
            return None
        return AttentionModel(self._config, self._seed, drawn)

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


@lru_cache(10_000)
def _draw_chance(seed: int, actor_id: str) -> float:
    # A generator for each id: who looks does not depend on who came before.
    return float(seeding.make_rng(seed, "attention", actor_id).random())


def _by_class(
    given: Iterable[tuple[str, float]], drawn: Iterable[tuple[str, float]], usual: float
) -> dict[ActorKind, float]:
    """The number of every kind of actor."""
    set_to, drawn_as = dict(given), dict(drawn)
    rest = drawn_as.get(EVERYBODY, usual)
    return {kind: drawn_as.get(kind.value, set_to.get(kind.value, rest)) for kind in ActorKind}
