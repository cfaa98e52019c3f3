"""The life of a server process: hear messages, feed the hub, tell what came of it, look after the living.

One thread. What is said to a client at one time travels as one message of several parts, so that it wakes once.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from wcsim.errors import AccessError, OverloadedError, WcsimError
from wcsim.server.host.epoch_cap import EpochCap
from wcsim.server.host.status import Reporter
from wcsim.server.host.world_host import Keep, WorldHost
from wcsim.server.launch.awake_clock import AwakeClock
from wcsim.server.launch.lifeline import Lifelines
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import Clock, EpochOver, Event, Lost, Peer, Received, Stop
from wcsim.server.protocol.members import Member, Pending
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.seat_world import SeatWorld
from wcsim.server.specs import WorldSpec
from wcsim.server.transport.entry import at_the_door
from wcsim.server.transport.rate_limit import PeerLimits
from wcsim.server.transport.shared_images import RingSink
from wcsim.server.transport.sockets import LOCAL, REMOTE, Heard, ServerSockets

_WAIT_MS = 50
_CLOCK_S = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Hosted:
    """What a server process hosts."""

    order: WorldSpec
    core: ServerCore
    world: SeatWorld
    keep: Keep
    ring: RingSink


class ServerLoop:
    """A hub behind its doors; see the module's text."""

    def __init__(self, hosted: Hosted, doors: ServerSockets, lifelines: Lifelines, reporter: Reporter) -> None:
        """Nothing is said or heard before `run`."""
        self._order, self._core, self._ring = hosted.order, hosted.core, hosted.ring
        self._doors, self._lifelines, self._reporter = doors, lifelines, reporter
        self._hub = WorldHost(hosted.core, hosted.world, self._post, hosted.keep, hosted.ring, reporter.loading)
        self._clock = AwakeClock(time.monotonic())
        self._peers = PeerLimits()
        self._homes: dict[bytes, Peer] = {}  # where each session joined first: whoever repeats its words is another
        self._out: dict[Peer, list[bytes]] = {}
        self._encoded: tuple[m.Reply | None, bytes] = (None, b"")  # the last one said
        self._clock_s = 0.0  # of the last Clock event
        self._alone = False
        self._cap = EpochCap(hosted.order)
        doors.watch(lifelines.fileno())

    def run(self, asked_to_end: Callable[[], str]) -> str:
        """Serve until somebody asks for the end, or whoever started this process is gone; returns why.

        Also until the epoch is over, in a process that is to be replaced then: its clients hear nothing of that, and
        join the next one.

        Raises:
            WcsimError: The world failed or the journal cannot be written; everybody has been told.
        """
        try:
            reason = asked_to_end()
            while not reason:
                self._turn()
                reason = asked_to_end() or ("the process that started it is gone" if self._alone else self._cap.reached)
            # Who has left by the last tick is in the journal as gone, for those who were in are waited for.
            self._feed(EpochOver() if self._cap.reached else Stop(reason))
        except WcsimError as error:
            self._tell_all(error)
            raise
        return reason

    # --- a turn ---

    def _turn(self) -> None:
        woken = self._doors.wait(_WAIT_MS)
        self._clock.look(time.monotonic())
        for heard in self._doors.messages():
            self._hear(heard)
            if self._cap.is_reached(self._core.cycle):
                return
        due = self._clock.now_s - self._clock_s >= _CLOCK_S
        if woken or due:
            lost, self._alone = self._lifelines.news()
            for session in lost:
                self._feed(Lost(session))
        if due:
            self._clock_s = self._clock.now_s
            self._feed(Clock())
            here = {p.session for p in self._present()}
            self._lifelines.keep(here)
            self._homes = {session: home for session, home in self._homes.items() if session in here}
            self._reporter.report(self._core, self._hub, self._clock.now_s)
            self._cap.weigh(self._core.cycle.tick)

    def _hear(self, heard: Heard) -> None:
        peer = heard.peer
        may_speak = self._peers.hears(peer, self._clock.now_s, self._present_peers)
        if not may_speak:
            if may_speak is not None:
                self._refuse(peer, OverloadedError("too many messages per second; wait for the answers"))
                self._shut_out(peer)
            return
        try:
            if heard.key == "":
                raise AccessError("the key of this connection was withdrawn; get a new one")
            message = m.decode_request(heard.data)
            if isinstance(message, m.Join):
                message = at_the_door(message, peer.startswith(REMOTE), heard.key)
        except WcsimError as error:
            self._peers.fault(peer)
            self._refuse(peer, error)
            self._shut_out(peer)
            return
        self._feed(Received(peer, message))
        if isinstance(message, m.Join):
            self._homes.setdefault(message.session, peer)
            if message.pid > 0 and peer.startswith(LOCAL):
                self._watch(message)

    def _shut_out(self, peer: Peer) -> None:
        """Who is not heard any more cannot act: nobody shall wait for it."""
        if self._peers.is_shut_out(peer):
            for session in [session for session, home in self._homes.items() if home == peer]:
                self._feed(Lost(session, "it sent too many messages, or too many that could not be read"))

    def _feed(self, event: Event) -> None:
        ticks = self._hub.ticks
        try:
            self._hub.feed(event, self._clock.now_s)
        finally:
            stepped_s = self._hub.step_s if self._hub.ticks > ticks else 0.0
            self._clock.look(time.monotonic(), stepped_s)
            self._flush()
        self._reporter.saw(self._core, event, self._clock.now_s, stepped_s)

    def _watch(self, join: m.Join) -> None:
        roll = self._core.cycle.roll
        known = roll.member(join.session) is not None or roll.waiting(join.session) is not None
        if known and not self._lifelines.watch(join.pid, join.session):
            self._feed(Lost(join.session))

    def _present(self) -> list[Member | Pending]:
        roll = self._core.cycle.roll
        return [*roll.members, *roll.pending]

    def _present_peers(self) -> set[Peer]:
        return {p.peer for p in self._present()}

    # --- what is said ---

    def _post(self, peer: Peer, message: m.Reply) -> None:
        """Keep a message until a frame is said, or all that follows from an event is known."""
        if isinstance(message, m.Frame):
            if peer.startswith(REMOTE):
                message = msgspec.structs.replace(message, slot=-1)
            # Off at once: while the next frame is packed, this client can begin to think.
            self._doors.send(peer, [*self._out.pop(peer, ()), m.encode(message)])
            return
        if message is not self._encoded[0]:  # the word of a tick is the same for all
            told = self._welcome(peer, message) if isinstance(message, m.Welcome) else message
            self._encoded = message, m.encode(told)
        self._out.setdefault(peer, []).append(self._encoded[1])

    def _welcome(self, peer: Peer, welcome: m.Welcome) -> m.Welcome:
        ring = str(self._ring.path(welcome.seat)) if peer.startswith(LOCAL) else ""
        order = self._order
        return msgspec.structs.replace(welcome, ring=ring, config_json=order.config_json, town=order.town)

    def _refuse(self, peer: Peer, error: WcsimError) -> None:
        self._doors.send(peer, [m.encode(m.failure_of(error))])

    def _flush(self) -> None:
        for peer, parts in self._out.items():
            self._doors.send(peer, parts)
        self._out.clear()

    def _tell_all(self, error: WcsimError) -> None:
        for p in self._present():
            if p.peer:
                self._doors.send(p.peer, [m.encode(m.failure_of(error, p.session))])
