"""How a client reaches its wheelchair: one interface, whether the world is in this process or in another one.

A link is for one seat. `act` names the tick it is for, so nothing is ever "the next": an action for another tick than
the seat's own is a ProtocolError. Snapshots are valid until the client's next call.
"""

from __future__ import annotations

import secrets
import time
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from wcsim.core.closing import Closing
from wcsim.errors import LinkClosedError, ProtocolError, ServerGoneError, WcsimError
from wcsim.log.records import SeenFrame
from wcsim.log.writer import LogWriter
from wcsim.server.launch.awake_clock import AwakeClock
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import ClientCore, FrameSeen, Outcome
from wcsim.server.specs import WorldOrder
from wcsim.types import ClientSnapshot, Joystick

INTERRUPTED = "the previous step was interrupted or has not finished; call reset() first"
LEAVING_S = 10.0  # who need not wait gives up a world that is silent for so long; one that lives speaks every second


@dataclass(frozen=True, slots=True, kw_only=True)
class Waits:
    """Where a client's time in its link went, in seconds."""

    steps: int = 0
    simulation_s: float = 0.0  # what the world took for the steps, as it said itself
    link_s: float = 0.0  # all waiting; the rest of it is for the barrier and the transport
    worked_s: float = 0.0  # of link_s, in which something else was done: see `Seat.while_waiting`


class Seat(Closing):
    """One seat of a world."""

    @abstractmethod
    def join(self) -> ClientSnapshot:
        """The frame the seat has now: the first one of its episode when nothing was done yet."""

    @abstractmethod
    def ask_join(self) -> None:
        """The first half of the first `join`; `receive` is the second."""

    @abstractmethod
    def send(self, tick: int, joystick: Joystick) -> None:
        """The first half of `act`: say what to do. Raises ProtocolError after a step that was interrupted."""

    @abstractmethod
    def receive(self) -> ClientSnapshot:
        """The second half of `act`, of `respawn` too: wait for the frame."""

    @abstractmethod
    def ask_respawn(self) -> None:
        """The first half of `respawn`."""

    @abstractmethod
    def rebuild(self, seed: int) -> ClientSnapshot:
        """Begin the world again with another seed; for a sole client or the master. Raises NotMasterError."""

    @property
    @abstractmethod
    def interrupted(self) -> bool:
        """Whether an answer is owed while nobody waits for it, as after Ctrl-C in a step."""

    @property
    @abstractmethod
    def epoch(self) -> int:
        """The epoch of the last frame; -1 before the first one."""

    @property
    @abstractmethod
    def waits(self) -> Waits:
        """Where the time went so far."""

    def act(self, tick: int, joystick: Joystick) -> ClientSnapshot:
        """Drive through tick `tick` with this joystick; returns the frame of tick + 1.

        Raises:
            WorldRestartedError: A new epoch began; `join()` has its first frame.
            LinkError: See `wcsim.errors` for what else a client can see.
        """
        self.send(tick, joystick)
        return self.receive()

    def respawn(self) -> ClientSnapshot:
        """Begin the seat's next episode now, without a tick."""
        self.ask_respawn()
        return self.receive()

    def while_waiting(self, work: Callable[[], object]) -> None:
        """Do something between `send` and `receive`; its time is part of the waiting as long as there is no answer.

        A link whose world is elsewhere hears it meanwhile: it asks again for what was lost.
        """
        work()

    def beat(self, progress: int) -> None:
        """Show that a long computation goes on, by a counter that rises; see `Rules.lease_s`. Nothing once closed."""

    def wait_less(self) -> None:
        """From now on a world that is silent for `LEAVING_S` is gone: nobody starts it again, or the client is to end.

        May be called by a signal's handler.
        """

    def wait_no_more(self) -> None:
        """From now on an answer that is not there yet is a ServerGoneError; for a client that is to end.

        May be called by a signal's handler.
        """


class SeatGroup(Closing):
    """A world of its own with a link to each of its seats, in seat order; a link may be closed before the others."""

    links: Sequence[Seat]

    def join(self) -> tuple[ClientSnapshot, ...]:
        """Take all seats; nobody gets one before all have asked."""
        for link in self.links:
            link.ask_join()
        return tuple(link.receive() for link in self.links)

    def respawn(self) -> tuple[ClientSnapshot, ...]:
        """Begin the next episodes of all seats, without a tick."""
        for link in self.links:
            link.ask_respawn()
        return tuple(link.receive() for link in self.links)

    def begin_again(self, seed: int) -> tuple[ClientSnapshot, ...]:
        """A new epoch with all seats, as in a new world with this seed; the links are new ones."""
        self.leave()
        self._renew(seed)
        return self.join()

    def leave(self) -> None:
        """Give all seats back."""
        for link in self.links:
            link.close()

    @abstractmethod
    def _renew(self, seed: int) -> None:
        """Begin the world again, nobody is in it, and make new links."""


class WorldLink(Seat):
    """One seat of a world elsewhere: a client core, driven by calls that wait; a transport carries its messages."""

    def __init__(self, core: ClientCore, ledger: LogWriter | None = None) -> None:
        self.core = core
        self._ledger = ledger
        self._frame: ClientSnapshot | None = None
        self._error: WcsimError | None = None
        self._closed = self._waits_no_more = False
        self._clock = AwakeClock(time.monotonic())  # who was stopped has not waited for anybody
        self._steps, self._simulation_s, self._link_s, self._worked_s = 0, 0.0, 0.0, 0.0

    # --- what a transport does ---

    @abstractmethod
    def _post(self, message: m.Request) -> None:
        """Send a message; must not block for long."""

    @abstractmethod
    def _pump(self) -> None:
        """Wait a little for messages and take them in; raises when there is no use in waiting."""

    @abstractmethod
    def _end(self) -> None:
        """Let go of everything."""

    def _open_frame(self, seen: FrameSeen) -> ClientSnapshot | None:
        """The frame with its pictures."""
        return seen.client

    def _welcomed(self, welcome: m.Welcome) -> None:
        """The client has its seat."""
        del welcome

    # --- what a client calls ---

    def join(self) -> ClientSnapshot:
        """See `Seat`."""
        if self.core.phase.value == "off":
            self.ask_join()
            return self._await()
        return self._await() if self._frame is None else self._frame

    def ask_join(self) -> None:
        """See `Seat`."""
        self._refuse_closed()
        self._frame = None
        self.take(self.core.join(self._now_s()))

    def send(self, tick: int, joystick: Joystick) -> None:
        """See `Seat`."""
        self._refuse_closed()
        self._raise_error()
        if self.interrupted:
            raise ProtocolError(INTERRUPTED)
        self._ask(partial(self.core.act, tick, joystick))

    def receive(self) -> ClientSnapshot:
        """See `Seat`."""
        self._refuse_closed()
        return self._await()

    def ask_respawn(self) -> None:
        """See `Seat`."""
        self._ask(self.core.respawn)

    def rebuild(self, seed: int) -> ClientSnapshot:
        """See `Seat`."""
        self._ask(partial(self.core.rebuild, seed))
        return self._await()

    def beat(self, progress: int) -> None:
        """See `Seat`."""
        if not self._closed:
            self.take(self.core.beat(progress))

    @property
    def interrupted(self) -> bool:
        """See `Seat`."""
        return self.core.waiting

    @property
    def seat(self) -> int:
        """The number of the seat; -1 before the first `join`."""
        return self.core.seat

    @property
    def epoch(self) -> int:
        """See `Seat`."""
        return self.core.epoch

    @property
    def master(self) -> bool:
        """Whether this client's action is the tick request."""
        return self.core.master

    @property
    def waits(self) -> Waits:
        """See `Seat`."""
        return Waits(
            steps=self._steps,
            simulation_s=self._simulation_s,
            link_s=self._link_s,
            worked_s=self._worked_s,
        )

    def wait_less(self) -> None:
        """See `Seat`."""
        patience = self.core.patience
        self.core.patience = replace(patience, reconnect_s=min(patience.reconnect_s, LEAVING_S))

    def wait_no_more(self) -> None:
        """See `Seat`."""
        self._waits_no_more = True

    def close(self) -> None:
        """Leave; a second call does nothing."""
        if self._closed:
            return
        try:
            self.take(self.core.leave())
        finally:
            self._closed = True
            if self._ledger is not None:
                self._ledger.close()
            self._end()

    # --- inside ---

    def _ask(self, ask: Callable[[float], list[Outcome]]) -> None:
        """Have the core ask for something, unless the link is closed or has failed meanwhile."""
        self._refuse_closed()
        self._raise_error()
        self.take(ask(self._now_s()))

    def take(self, outcomes: list[Outcome]) -> None:
        """Do what the client core wants done."""
        for outcome in outcomes:
            match outcome:
                case FrameSeen():
                    self._see(outcome)
                case WcsimError():
                    self._error = outcome
                case m.Welcome():
                    self._welcomed(outcome)
                case _:
                    self._post(outcome)

    def hear(self, message: m.Reply) -> None:
        """Take in one message of the server."""
        if isinstance(message, m.TickDone):
            self._simulation_s += message.step_s
        self.take(self.core.handle(message, self._now_s()))

    def _see(self, seen: FrameSeen) -> None:
        if self._ledger is not None:
            self._ledger.append(SeenFrame(epoch=seen.epoch, tick=seen.tick, stepped=seen.stepped))
        self._steps += seen.stepped
        self._frame = self._open_frame(seen)

    def _await(self) -> ClientSnapshot:
        begun_s = time.perf_counter()
        while self.core.waiting and self._error is None:
            self._pump()
            if self._waits_no_more and self.core.waiting and self._error is None:
                self._error = ServerGoneError(
                    "the world does not answer, and this client was requested to stop"
                )
        self._link_s += time.perf_counter() - begun_s
        self._raise_error()
        if self._frame is None:
            raise ProtocolError(
                "there is no pending request; call join(), act() or respawn() first"
            )
        return self._frame

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _refuse_closed(self) -> None:
        if self._closed:
            raise LinkClosedError("this link is closed; create a new one")

    def _now_s(self) -> float:
        return self._clock.look(time.monotonic())


def new_session() -> bytes:
    """A name for a connection that nobody can guess."""
    return secrets.token_bytes(m.SESSION_BYTES)


def open_group(order: WorldOrder) -> SeatGroup:
    """All seats of a new world; two worlds of one order behave the same to the bit, whichever process they are in.

    It is in this process while no world lives here, else in one of its own. One caller in one thread drives all seats:
    first `send` on every link, then `receive` on every link. Seats are given away all at once, in seat order.
    """
    # Only who asks for a world loads the simulators: a client that joins a world elsewhere never does.
    from wcsim.bridge.sumo.session import world_in_this_process

    if not world_in_this_process():
        from wcsim.server.links.local import LocalGroup

        return LocalGroup(order)
    from wcsim.server.links.socket import (
        ProcessGroup,
    )  # ZeroMQ is loaded only when a second world is asked for

    return ProcessGroup(order)
