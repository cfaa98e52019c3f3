"""A group of seats whose world is in a child process; used when a world already lives in this process."""

from __future__ import annotations

from dataclasses import replace

from wcsim.server.links.child_world import ChildSeat, WorldChild
from wcsim.server.links.group import SeatGroup
from wcsim.server.specs import WorldOrder


class ProcessGroup(SeatGroup):
    """A world process with all its seats; an epoch that begins again is a new process."""

    def __init__(self, order: WorldOrder) -> None:
        """Start the world; raises what opening it in this process would raise."""
        super().__init__()
        self._order = order
        self._connect(order.seed)

    def close(self) -> None:
        """See `SeatGroup.close`."""
        self.leave()
        self._child.close()
        self.links = ()

    def _renew(self, seed: int) -> None:
        self._child.close()
        self._connect(seed)

    def _connect(self, seed: int) -> None:
        order = self._order
        self._child = WorldChild(replace(order, seed=seed), expected=order.seats)
        self.links = [ChildSeat(self._child, order.seat, seat, f"chair-{seat}") for seat in range(order.seats)]
