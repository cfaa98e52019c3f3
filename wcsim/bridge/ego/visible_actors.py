"""Which of the others a wheelchair's cameras have shown lately: what may be known to who sees nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from wcsim.config import WorldConfig
from wcsim.types import ActorState


class ShownActors:
    """The actors that the cameras of one seat have shown, each with the tick in which they last did so."""

    def __init__(self, world: WorldConfig) -> None:
        """`world` says how many pixels make an actor visible, and for how long it is remembered."""
        self._least_px = world.visible_px
        self._ticks = round(world.visible_s / world.tick_s)
        self._last: dict[str, int] = {}

    def forget(self) -> None:
        """Forget everybody: another episode begins."""
        self._last.clear()

    def see(self, tick: int, shown_px: Mapping[str, float]) -> None:
        """Take what the cameras show in this tick: pixels by actor, as in a picture of 320x240."""
        seen = {name: tick for name, pixels in shown_px.items() if pixels >= self._least_px}
        kept = {name: last for name, last in self._last.items() if tick - last <= self._ticks}
        self._last = {**kept, **seen}

    def known(self, actors: Sequence[ActorState]) -> tuple[ActorState, ...]:
        """Those of the actors that were shown no longer ago than they are remembered, where they are now."""
        return tuple(actor for actor in actors if actor.whole_id in self._last)
