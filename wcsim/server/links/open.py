"""Open a world with all its seats: in this process while no world lives here, otherwise in one of its own.

Only who asks for a world loads the simulators: a client that joins a world elsewhere never does. All seats of a world
are driven by one caller in one thread: first `send` on every link, then `receive` on every link. Seats are given away
all at once, in seat order.
"""

from __future__ import annotations

from wcsim.server.links.base import SeatGroup
from wcsim.server.specs import WorldOrder


def open_group(order: WorldOrder) -> SeatGroup:
    """All seats of a new world; two worlds of one order behave the same to the bit, whichever process they are in."""
    from wcsim.bridge.sumo.session import world_in_this_process

    if not world_in_this_process():
        from wcsim.server.links.local import LocalGroup

        return LocalGroup(order)
    from wcsim.server.links.socket import ProcessGroup  # ZeroMQ is loaded only when a second world is asked for

    return ProcessGroup(order)
