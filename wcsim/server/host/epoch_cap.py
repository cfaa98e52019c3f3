"""When an epoch of a shared world is over, so that journal and memory do not grow with the run."""

from __future__ import annotations

from wcsim.server.protocol.barrier import Barrier
from wcsim.server.protocol.events import BarrierState
from wcsim.server.specs import WorldSpec, rss_mb

EPOCH_OVER = "the world generation is over"
"""How the reason begins by which a world's process ends for another one to go on with the next epoch."""
_GROWTH_MB = 1_000.0  # what a world's process may grow by in an epoch
SETTLED_TICKS = 100  # after which a world's memory is what it begins an epoch with


class EpochCap:
    """The end of an epoch: at a full barrier, when everybody has seen the last tick and nobody the next one.

    So it depends on the tick alone, unless memory has grown, and two runs with equal seeds end their epochs alike.
    """

    def __init__(self, order: WorldSpec, cycle: Barrier) -> None:
        """Have the barrier end its epoch as the order says; never, where nobody would go on."""
        self._cycle = cycle
        cycle.last_tick = order.epoch_ticks or None
        self._begun_mb: float | None = None
        self._why = ""

    def weigh(self) -> None:
        """Look at how much memory this process has, and end the epoch if it is too much; to be called now and then."""
        cycle = self._cycle
        if cycle.last_tick is None or cycle.tick < SETTLED_TICKS:
            return
        now_mb = rss_mb()
        self._begun_mb = now_mb if self._begun_mb is None else self._begun_mb
        if now_mb - self._begun_mb > _GROWTH_MB:
            self._why = f"{EPOCH_OVER}: its process has grown from {self._begun_mb:.0f} to {now_mb:.0f} MB"
            cycle.last_tick = 0  # the next full barrier, also of a world that is begun anew meanwhile

    @property
    def reached(self) -> str:
        """Why the epoch is over, "" as long as it is not."""
        if self._cycle.stage is not BarrierState.EPOCH_OVER:
            return ""
        return self._why or f"{EPOCH_OVER}: tick {self._cycle.tick}"
