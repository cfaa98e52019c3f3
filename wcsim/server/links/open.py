"""Choose the link: in this process while no world lives here, otherwise a process of its own.

Only who asks for a world loads the simulators: a client that joins a world elsewhere never does.
"""

from __future__ import annotations

from wcsim.server.links.base import WorldLink
from wcsim.server.specs import WorldOrder


def open_link(order: WorldOrder) -> WorldLink:
    """A link to a new world; two worlds of one order behave the same to the bit, whichever link they got."""
    from wcsim.bridge.sumo.session import world_in_this_process

    if not world_in_this_process():
        from wcsim.server.links.local import LocalLink

        return LocalLink(order)
    from wcsim.server.links.child_world import ProcessLink  # ZeroMQ is loaded only when a second world is asked for

    return ProcessLink(order)
