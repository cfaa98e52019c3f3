"""Open a world for one seat or for all: in this process while no world lives here, otherwise in one of its own.

Only who asks for a world loads the simulators: a client that joins a world elsewhere never does. All seats of a world
are driven by one caller in one thread: first `send` on every link, then `receive` on every link. Seats are given away
all at once, in seat order, so a group of one is a `LocalLink` to the bit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from wcsim.server.links.base import WorldLink
from wcsim.server.specs import WorldOrder
from wcsim.types import ClientSnapshot

Frames = tuple[ClientSnapshot, ...]


class SeatGroup(ABC):
    """A world of its own with a link to each of its seats, in seat order; a link may be closed before the others."""

    def __init__(self) -> None:
        self.links: Sequence[WorldLink] = ()

    def join(self) -> Frames:
        """Take all seats; nobody gets one before all have asked."""
        for link in self.links:
            link.ask_join()
        return tuple(link.receive() for link in self.links)

    def respawn(self) -> Frames:
        """Begin the next episodes of all seats, without a tick."""
        for link in self.links:
            link.ask_respawn()
        return tuple(link.receive() for link in self.links)

    def begin_again(self, seed: int) -> Frames:
        """A new epoch with all seats, as in a new world with this seed; the links are new ones."""
        self.leave()
        self._renew(seed)
        return self.join()

    def leave(self) -> None:
        """Give all seats back."""
        for link in self.links:
            link.close()

    @abstractmethod
    def close(self) -> None:
        """End the world; a second call does nothing."""

    @abstractmethod
    def _renew(self, seed: int) -> None:
        """Begin the world again, nobody is in it, and make new links."""


def open_link(order: WorldOrder) -> WorldLink:
    """A link to a new world; two worlds of one order behave the same to the bit, whichever link they got."""
    from wcsim.bridge.sumo.session import world_in_this_process

    if not world_in_this_process():
        from wcsim.server.links.local import LocalLink

        return LocalLink(order)
    from wcsim.server.links.child_world import ProcessLink  # ZeroMQ is loaded only when a second world is asked for

    return ProcessLink(order)


def open_group(order: WorldOrder) -> SeatGroup:
    """All seats of a new world, as `open_link` opens one."""
    from wcsim.bridge.sumo.session import world_in_this_process

    if not world_in_this_process():
        from wcsim.server.links.local import LocalGroup

        return LocalGroup(order)
    from wcsim.server.links.child_world import ProcessGroup

    return ProcessGroup(order)
