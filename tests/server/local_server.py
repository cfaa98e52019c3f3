"""A world with its server core and its clients' cores in this very process: one thread, no socket.

Clients of a shared world are tested on it: a link that waits pumps for all.
"""

from __future__ import annotations

import time
from collections import deque

from wcsim.bridge.replay.player import SeatWorld
from wcsim.errors import TickTimeoutError
from wcsim.server.host.world_host import WorldEffectExecutor
from wcsim.server.links.base import ProcessSeatLink, make_session_id
from wcsim.server.links.socket import _private_rules
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import ClientCore, JoinSettings, Patience
from wcsim.server.protocol.events import MessageReceivedEvent, Peer, TimePassedEvent
from wcsim.server.protocol.server_core import ServerCore
from wcsim.types import SeatSpec

NEVER_S = 1e12


class LocalServer:
    """A world in this process, for any number of links."""

    def __init__(self, world: SeatWorld, capacity: int, expected: int = 1) -> None:
        """Host a world with free seats; the first tick waits until `expected` links have joined."""
        self.world = world
        self._links: dict[Peer, PumpedSeat] = {}
        self._inbox: deque[tuple[Peer, m.Reply]] = deque()
        now, inbox = world.snapshot, self._inbox
        core = ServerCore(_private_rules(capacity, expected), now.epoch)
        self.hub = WorldEffectExecutor(core, world, lambda peer, message: inbox.append((peer, message)))

    def link(self, spec: SeatSpec, seat: int = m.ANY_SEAT, name: str = "") -> PumpedSeat:
        """A link to a seat; it has to join."""
        peer = f"local-{len(self._links)}".encode()
        ask = JoinSettings(claim=peer, name=name, spec=spec, seat=seat)
        self._links[peer] = PumpedSeat(self, peer, ask)
        return self._links[peer]

    def say(self, peer: Peer, message: m.Request) -> None:
        """A link says something."""
        self.hub.feed(MessageReceivedEvent(peer, message), time.monotonic())

    def pump(self) -> None:
        """Let every link hear what there is for it, until all is quiet."""
        while self._inbox:
            peer, message = self._inbox.popleft()
            self._links[peer].handle(message)


class PumpedSeat(ProcessSeatLink):
    """One seat of a `LocalServer`."""

    def __init__(self, server: LocalServer, peer: Peer, ask: JoinSettings) -> None:
        patience = Patience(resend_s=NEVER_S, reconnect_s=NEVER_S, tick_s=NEVER_S)
        super().__init__(ClientCore(ask, patience, make_session_id))
        self._server, self._peer = server, peer

    def _post(self, message: m.Request) -> None:
        self._server.say(self._peer, message)

    def _pump(self) -> None:
        self._server.pump()
        if self.core.waiting and self._error is None:
            raise TickTimeoutError(f"seat {self.seat} waits for {self._server.hub.core.late()}")

    def _end(self) -> None:
        self._server.pump()
        self._server.hub.feed(TimePassedEvent(), time.monotonic())
