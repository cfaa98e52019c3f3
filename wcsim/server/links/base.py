"""How a client reaches its wheelchair: one interface, wherever the world is.

A link is for one seat. `act` names the tick it is for: an action for another tick than the seat's
own is a ProtocolError. Snapshots are valid until the client's next call.
"""

import secrets
import time
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from wcsim.core.closing import ClosingContextBase
from wcsim.errors import LinkClosedError, ProtocolError, ServerGoneError, WcsimError
from wcsim.log.records import SeenFrame
from wcsim.log.writer import LogWriter
from wcsim.server.launch.awake_clock import SuspendSafeClock
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import ClientCore, ClientPhase, Outcome, ReceivedFrame
from wcsim.server.specs import WorldBuildSpec
from wcsim.types import ClientSnapshot, Joystick

INTERRUPTED: Final = "the previous step was interrupted or has not finished; call reset() first"
# Silence after which a world is given up by a client that need not wait. A living world sends a
# message every second.
LEAVING_S: Final = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkWaitTimes:
    """Where a client's time in its link went, in seconds."""

    steps: int = 0
    simulation_s: float = 0.0  # duration of the world's steps, by its own clock
    link_s: float = 0.0  # all waiting; the rest of it is for the barrier and the transport
    worked_s: float = (
        0.0  # of link_s, in which something else was done: see `SeatLink.while_waiting`
    )


class SeatLink(ClosingContextBase):
    """One seat of a world."""

    @abstractmethod
    def join(self) -> ClientSnapshot:
        """The seat's present frame: the first one of its episode when nothing was done yet."""

    @abstractmethod
    def request_join(self) -> None:
        """The first half of the first `join`; `receive` is the second."""

    @abstractmethod
    def send(self, tick: int, joystick: Joystick) -> None:
        """The first half of `act`: send the action.

        Raises ProtocolError after a step that was interrupted.
        """

    @abstractmethod
    def receive(self) -> ClientSnapshot:
        """The second half of `act`, `respawn` and the first `join`: wait for the frame."""

    @abstractmethod
    def request_respawn(self) -> None:
        """The first half of `respawn`."""

    @abstractmethod
    def rebuild(self, seed: int) -> ClientSnapshot:
        """Start the world again with another seed; for a sole client or the master.

        Raises NotMasterError.
        """

    @property
    @abstractmethod
    def interrupted(self) -> bool:
        """Whether an answer is owed that no call waits for, as after Ctrl-C in a step."""

    @property
    @abstractmethod
    def epoch(self) -> int:
        """The epoch of the last frame; -1 before the first one."""

    @property
    @abstractmethod
    def waits(self) -> LinkWaitTimes:
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
        """Start the seat's next episode now, without a tick."""
        self.request_respawn()
        return self.receive()

    def while_waiting(self, work: Callable[[], object]) -> None:
        """Do something between `send` and `receive`.

        Its time is part of the waiting as long as there is no answer. A link whose world is in
        another process receives meanwhile, and repeats requests that were lost.
        """
        work()

    def beat(self, progress: int) -> None:
        """Show that a long computation goes on, by a counter that rises; see `ServerRules.lease_s`.

        A closed link does nothing.
        """

    def wait_less(self) -> None:
        """From now on give up a world that is silent for `LEAVING_S`.

        For a world that no launcher starts again, or a client that is to end.
        May be called by a signal's handler.
        """

    def wait_no_more(self) -> None:
        """From now on an answer that is not there yet is a ServerGoneError.

        For a client that is to end.
        May be called by a signal's handler.
        """


class SeatLinkGroup(ClosingContextBase):
    """A world of its own with a link to each of its seats, in seat order.

    A link may be closed before the others.
    """

    links: Sequence[SeatLink]

    def join(self) -> tuple[ClientSnapshot, ...]:
        """Take all seats; none is given away before all are requested."""
        for link in self.links:
            link.request_join()
        return tuple(link.receive() for link in self.links)

    def respawn(self) -> tuple[ClientSnapshot, ...]:
        """Start the next episodes of all seats, without a tick."""
        for link in self.links:
            link.request_respawn()
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
        """Start the world again, without chairs, and make new links."""


class ProcessSeatLink(SeatLink):
    """One seat of a world in another process: a client core, whose messages a transport carries.

    A transport defines `_post`, `_pump` and `_end`.
    """

    def __init__(self, core: ClientCore, ledger: LogWriter | None = None) -> None:
        self.core = core
        self._ledger = ledger
        self._frame: ClientSnapshot | None = None
        self._error: WcsimError | None = None
        self._closed = False
        self._waits_no_more = False
        # Time in which this process itself was stopped does not count as waiting.
        self._clock = SuspendSafeClock(time.monotonic())
        self._steps = 0
        self._simulation_s = 0.0
        self._link_s = 0.0
        self._worked_s = 0.0

    # --- what a transport does ---

    @abstractmethod
    def _post(self, message: m.Request) -> None:
        """Send a message; must not block for long."""

    @abstractmethod
    def _pump(self) -> None:
        """Wait a little for messages and handle them; raises when there is no use in waiting."""

    @abstractmethod
    def _end(self) -> None:
        """Release everything."""

    def _check_pictures(self, seen: ReceivedFrame) -> None:
        """Refuse a frame with pictures that this link cannot read. Raises ProtocolError."""

    def _welcomed(self, welcome: m.Welcome) -> None:
        """The client has its seat."""

    # --- what a client calls ---

    def join(self) -> ClientSnapshot:
        """See `SeatLink`."""
        if self.core.phase is ClientPhase.OFF:
            self.request_join()
        elif self._frame is not None:
            return self._frame
        return self._await_frame()

    def request_join(self) -> None:
        """See `SeatLink`."""
        self._require_open()
        self._frame = None
        self.perform(self.core.join(self._now_s()))

    def send(self, tick: int, joystick: Joystick) -> None:
        """See `SeatLink`."""
        self._require_open()
        self._raise_error()
        if self.interrupted:
            raise ProtocolError(INTERRUPTED)
        self.perform(self.core.act(tick, joystick, self._now_s()))

    def receive(self) -> ClientSnapshot:
        """See `SeatLink`."""
        self._require_open()
        return self._await_frame()

    def request_respawn(self) -> None:
        """See `SeatLink`."""
        self._require_open()
        self._raise_error()
        self.perform(self.core.respawn(self._now_s()))

    def rebuild(self, seed: int) -> ClientSnapshot:
        """See `SeatLink`."""
        self._require_open()
        self._raise_error()
        self.perform(self.core.rebuild(seed, self._now_s()))
        return self._await_frame()

    def beat(self, progress: int) -> None:
        """See `SeatLink`."""
        if not self._closed:
            self.perform(self.core.beat(progress))

    @property
    def interrupted(self) -> bool:
        """See `SeatLink`."""
        return self.core.waiting

    @property
    def seat(self) -> int:
        """The number of the seat; -1 before the first `join`."""
        return self.core.seat

    @property
    def epoch(self) -> int:
        """See `SeatLink`."""
        return self.core.epoch

    @property
    def master(self) -> bool:
        """Whether this client's action is the tick request."""
        return self.core.master

    @property
    def waits(self) -> LinkWaitTimes:
        """See `SeatLink`."""
        return LinkWaitTimes(
            steps=self._steps,
            simulation_s=self._simulation_s,
            link_s=self._link_s,
            worked_s=self._worked_s,
        )

    def wait_less(self) -> None:
        """See `SeatLink`."""
        patience = self.core.patience
        self.core.patience = replace(patience, reconnect_s=min(patience.reconnect_s, LEAVING_S))

    def wait_no_more(self) -> None:
        """See `SeatLink`."""
        self._waits_no_more = True

    def close(self) -> None:
        """Leave; a second call does nothing."""
        if self._closed:
            return
        try:
            self.perform(self.core.leave())
        finally:
            self._closed = True
            if self._ledger is not None:
                self._ledger.close()
            self._end()

    # --- what a transport calls ---

    def handle(self, message: m.Reply) -> None:
        """Handle one message of the server."""
        if isinstance(message, m.TickDone):
            self._simulation_s += message.step_s
        self.perform(self.core.handle(message, self._now_s()))

    def perform(self, outcomes: list[Outcome]) -> None:
        """Do what the client core requests."""
        for outcome in outcomes:
            match outcome:
                case ReceivedFrame(epoch=epoch, tick=tick, stepped=stepped):
                    if self._ledger is not None:
                        self._ledger.append(SeenFrame(epoch=epoch, tick=tick, stepped=stepped))
                    self._steps += stepped
                    self._check_pictures(outcome)
                    self._frame = outcome.client
                case WcsimError():
                    self._error = outcome
                case m.Welcome():
                    self._welcomed(outcome)
                case _:
                    self._post(outcome)

    # --- inside ---

    def _await_frame(self) -> ClientSnapshot:
        start_s = time.perf_counter()
        while self.core.waiting and self._error is None:
            self._pump()
            if self._waits_no_more and self.core.waiting and self._error is None:
                self._error = ServerGoneError(
                    "the world does not answer, and this client was requested to stop"
                )
        self._link_s += time.perf_counter() - start_s
        self._raise_error()
        if self._frame is None:
            raise ProtocolError(
                "there is no pending request; call join(), act() or respawn() first"
            )
        return self._frame

    def _require_open(self) -> None:
        if self._closed:
            raise LinkClosedError("this link is closed; create a new one")

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _now_s(self) -> float:
        return self._clock.look(time.monotonic())


def make_session_id() -> bytes:
    """Draw a name for a connection that no other client can guess."""
    return secrets.token_bytes(m.SESSION_BYTES)


def open_seat_links(order: WorldBuildSpec) -> SeatLinkGroup:
    """All seats of a new world, which is in this process unless another world lives here.

    Two worlds of one order behave the same to the bit, whichever process they are in. One caller in
    one thread drives all seats: first `send` on every link, then `receive` on every link. Seats are
    given away all at once, in seat order.
    """
    # A client that joins a world of another process never loads the simulators.
    from wcsim.bridge.sumo.session import world_in_this_process

    if not world_in_this_process():
        from wcsim.server.links.local import LocalSeatLinkGroup

        return LocalSeatLinkGroup(order)
    # ZeroMQ is loaded only for a second world.
    from wcsim.server.links.socket import ProcessSeatLinkGroup

    return ProcessSeatLinkGroup(order)
