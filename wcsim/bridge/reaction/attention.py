"""How the others watch out: who looks for wheelchairs, and how long it takes those who do, by class.

A world has habits of its own; where `[vary]` has ranges for them, they are others towards each chair in each episode.
"""

from __future__ import annotations

from collections.abc import Iterable

from wcsim.config import STREETS, WorldConfig
from wcsim.config.world import EVERYBODY
from wcsim.core import seeding
from wcsim.types import ActorKind, ActorState, Drawn

MOST_KNOWN = 10_000


class Attention:
    """Who looks out for wheelchairs: a property of the actor and of the seed."""

    def __init__(self, share: float, seed: int) -> None:
        self._share = share
        self._seed = seed
        self._chances: dict[str, float] = {}

    def at(self, share: float) -> Attention:
        """The same actors at another share: who looks at one looks at every larger one."""
        other = Attention(share, self._seed)
        other._chances = self._chances
        return other

    def looks(self, actor_id: str) -> bool:
        """Whether this actor notices wheelchairs at all."""
        return self._share >= 1.0 or self._chance(actor_id) < self._share

    def _chance(self, actor_id: str) -> float:
        known = self._chances.get(actor_id)
        if known is None:
            if len(self._chances) > MOST_KNOWN:  # of those who have left long ago; the draw can be made again
                self._chances.clear()
            # A generator for each id: who looks does not depend on who came before.
            known = self._chances[actor_id] = float(seeding.generator(self._seed, "attention", actor_id).random())
        return known


class AttentionModel:
    """The share of those who look and their reaction time, by class."""

    def __init__(self, config: WorldConfig, everybody: Attention, drawn: Drawn = Drawn()) -> None:  # noqa: B008 - frozen
        """Those of a street, or those towards a chair for which others were drawn.

        Args:
            config: Shares and times; an entry by class goes before those for everybody.
            everybody: The street's; its share does not matter.
            drawn: Of an episode; a number by class goes before all, one for everybody before `config`'s for everybody.
        """
        self._config, self._everybody = config, everybody
        share, usual_s = STREETS[config.street] or (config.attention_share, config.reaction_s)
        shares = _by_class(config.attention.items(), drawn.attention, share)
        self._attention = {kind: everybody.at(value) for kind, value in shares.items()}
        self._reaction_s = _by_class(config.reaction.items(), drawn.reaction_s, usual_s)

    def towards(self, drawn: Drawn) -> AttentionModel | None:
        """Those of the same street towards a chair in an episode; None when nothing was drawn for them."""
        if not (drawn.attention or drawn.reaction_s):
            return None
        return AttentionModel(self._config, self._everybody, drawn)

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


def street_habits(config: WorldConfig, seed: int) -> AttentionModel:
    """The habits of a street. The same seed gives the same actors who look."""
    return AttentionModel(config, Attention(1.0, seed))


def _by_class(
    given: Iterable[tuple[str, float]], drawn: Iterable[tuple[str, float]], usual: float
) -> dict[ActorKind, float]:
    """The number of every kind of actor."""
    set_to, drawn_as = dict(given), dict(drawn)
    rest = drawn_as.get(EVERYBODY, usual)
    return {kind: drawn_as.get(kind.value, set_to.get(kind.value, rest)) for kind in ActorKind}
