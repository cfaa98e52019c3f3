"""A world with its server in this very process: one thread, no socket; every link's messages go through the same core.

A link that waits pumps for all. Nobody else can act meanwhile, so a wait for another seat is an error at once, not a
deadlock: with several seats, first `send` for all of them, then `receive`.
"""

from __future__ import annotations

import time
from collections import deque

from wcsim.bridge.replay.seat_world import SeatWorld
from wcsim.errors import ProtocolError, TickTimeoutError
from wcsim.server.host.made_world import made_world
from wcsim.server.host.world_host import WorldHost
from wcsim.server.links.base import WorldLink, new_session
from wcsim.server.links.open import SeatGroup
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import Ask, ClientCore, Patience
from wcsim.server.protocol.events import Clock, Peer, Received, Rules
from wcsim.server.protocol.members import Member
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import WorldOrder
from wcsim.types import SeatSpec

_NEVER_S = 1e12


def local_rules(capacity: int, expected: int = 1) -> Rules:
    """Nobody can hang or die alone in a process of its own."""
    return Rules(
        capacity=capacity,
        expected=expected,
        gather_s=_NEVER_S,
        lease_s=_NEVER_S,
        tick_lease_s=_NEVER_S,
        notice_s=_NEVER_S,
        recordings=None,
    )


class LocalServer:
    """A world in this process, for any number of links; raises WorldInUseError while another one lives here."""

    def __init__(self, world: SeatWorld, capacity: int, expected: int = 1) -> None:
        """Host a world with free seats; the first tick waits until `expected` links have joined."""
        self.world = world
        self._links: dict[Peer, _LocalSeat] = {}
        self._made = 0  # links, ever: no two share a name
        self._inbox: deque[tuple[Peer, m.Reply]] = deque()
        self._rules = local_rules(capacity, expected)
        self._hub = self._new_hub()

    def link(self, spec: SeatSpec, seat: int = m.ANY_SEAT, name: str = "") -> _LocalSeat:
        """A link to a seat; it has to join."""
        peer = f"local-{self._made}".encode()
        ask = Ask(claim=peer, name=name or f"client-{self._made}", spec=spec, seat=seat)
        self._made += 1
        self._links[peer] = _LocalSeat(self, peer, ask)
        return self._links[peer]

    def begin_again(self, seed: int) -> None:
        """A new epoch for new links, with nobody in the street: what follows is as in a new world with this seed.

        Raises:
            ProtocolError: Somebody has a seat; expected links that are closed.
        """
        if self.members():
            names = ", ".join(member.name for member in self.members())
            raise ProtocolError(f"{names} would lose their seats; close these links first")
        self.world.rebuild(seed)
        self._hub = self._new_hub()

    def say(self, peer: Peer, message: m.Request) -> None:
        """A link says something."""
        self._hub.feed(Received(peer, message), time.monotonic())

    def pump(self) -> None:
        """Let every link hear what there is for it, until all is quiet."""
        while self._inbox:
            peer, message = self._inbox.popleft()
            link = self._links.get(peer)
            if link is not None:
                link.hear(message)

    def members(self) -> list[Member]:
        """Who is in, in seat order."""
        return self._hub.core.cycle.roll.by_seat()

    def late(self) -> tuple[str, ...]:
        """For whom the barrier waits."""
        return self._hub.core.cycle.late()

    def forget(self, peer: Peer) -> None:
        """A link has been closed."""
        self._links.pop(peer, None)
        self._hub.feed(Clock(), time.monotonic())

    def close(self) -> None:
        """End the world; a second call does nothing."""
        self._links.clear()
        self.world.close()

    def _new_hub(self) -> WorldHost:
        now, inbox = self.world.snapshot, self._inbox  # the inbox alone: a cycle would keep a closed world in memory
        core = ServerCore(self._rules, now.epoch, now.tick)
        return WorldHost(core, self.world, lambda peer, message: inbox.append((peer, message)))


class _LocalSeat(WorldLink):
    """One seat of a `LocalServer`."""

    def __init__(self, server: LocalServer, peer: Peer, ask: Ask) -> None:
        patience = Patience(resend_s=_NEVER_S, reconnect_s=_NEVER_S, tick_s=_NEVER_S)
        super().__init__(ClientCore(ask, patience, new_session))
        self._server, self._peer = server, peer

    def _post(self, message: m.Request) -> None:
        self._server.say(self._peer, message)

    def _pump(self) -> None:
        self._server.pump()
        if self.core.waiting and self._error is None:
            late = ", ".join(self._server.late()) or "more clients to join"
            raise TickTimeoutError(
                f"seat {self.seat} waits for {late}; in one process no other seat can act meanwhile: send for all "
                "seats first"
            )

    def _end(self) -> None:
        self._server.pump()
        self._server.forget(self._peer)


class LocalLink(_LocalSeat):
    """The only seat of a world of its own in this process; raises WorldInUseError while another one lives here."""

    def __init__(self, order: WorldOrder) -> None:
        self._own = LocalServer(made_world(order), order.seats)
        super().__init__(self._own, b"sole", Ask(claim=b"sole", name="sole", spec=order.seat))
        self._own._links[b"sole"] = self

    def _end(self) -> None:
        self._own.close()


class LocalGroup(SeatGroup):
    """A group whose world is in this process; raises WorldInUseError while another one lives here."""

    def __init__(self, order: WorldOrder) -> None:
        super().__init__()
        self._order = order
        self._server = LocalServer(made_world(order), order.seats, expected=order.seats)
        self._connect()

    def close(self) -> None:
        """See `SeatGroup.close`."""
        self._server.close()
        self.links = ()

    def _renew(self, seed: int) -> None:
        self._server.begin_again(seed)
        self._connect()

    def _connect(self) -> None:
        seats = range(self._order.seats)
        self.links = [self._server.link(self._order.seat, seat, f"chair-{seat}") for seat in seats]
