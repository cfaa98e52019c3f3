"""The client without input and output: what it sends and expects, and when it repeats or gives up.

The methods that a driver calls (`join`, `act`, `respawn`, `rebuild`, `leave`), `handle(message,
now_s)` and `clock(now_s)` return what is to be done. A client has seen tick n, acts for n, gets
word that the simulation is at n + 1 (the paper's tick wait), and gets the frame of n + 1 (its
sensors wait). Anything else in between is an error, or a message that came twice. A master does
nothing else: its action is the tick request.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from enum import Enum
from typing import Final, Self

from wcsim import errors
from wcsim.server.protocol import messages as m
from wcsim.types import ClientSnapshot, Joystick, SeatSpec


class ClientPhase(Enum):
    """Where a client is in its cycle; see docs/protocol.md."""

    OFF = "off"
    JOINING = "joining"
    WAIT_FIRST = "wait first"  # has its seat, waits for the first frame, or for that of a new epoch
    THINK = "think"
    WAIT_TICK = "wait tick"
    WAIT_SENSORS = "wait sensors"
    WAIT_RESPAWN = "wait respawn"
    GONE = "gone"


@dataclass(frozen=True, slots=True, kw_only=True)
class JoinSettings:
    """A client and the seat that it requests; `claim` stays when its process is restarted."""

    claim: bytes
    name: str
    spec: SeatSpec
    seat: int = m.ANY_SEAT
    config: str = ""
    pid: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """How long a client waits, in seconds of its own clock."""

    resend_s: float = 2.0  # silence after which a request is sent again
    reconnect_s: float = 90.0  # silence after which the server is given up
    tick_s: float = 3600.0  # the longest wait for others


@dataclass(frozen=True, slots=True)
class ReceivedFrame:
    """The requested frame is here."""

    epoch: int
    tick: int
    client: ClientSnapshot | None
    slot: int
    stepped: bool  # it follows this client's action, not a join, a respawn or a new epoch


Outcome = m.Request | ReceivedFrame | errors.WcsimError | m.Welcome
"""A message to send; a frame; an error for the driver; or the seat, with its shared memory."""
_IDLE: Final = (ClientPhase.OFF, ClientPhase.THINK, ClientPhase.GONE)
_PHASE_AFTER: Final = {
    m.Act: ClientPhase.WAIT_TICK,
    m.Respawn: ClientPhase.WAIT_RESPAWN,
    m.Rebuild: ClientPhase.WAIT_FIRST,
}


class ClientCore:
    """A client; see the module's text. `new_session` draws 16 bytes that no other client has."""

    def __init__(
        self, request: JoinSettings, patience: Patience, new_session: Callable[[], bytes]
    ) -> None:
        self.request = request
        self.patience = patience
        self._new_session = new_session
        self.phase = ClientPhase.OFF
        self.session = b""
        self.seat = request.seat
        self.epoch = -1
        self.tick = -1
        self.life = 0
        self._master_seat: int | None = None
        self.late: tuple[str, ...] = ()  # for whom the server waits, by its last `Waiting`
        self.pending: m.Act | m.Respawn | m.Rebuild | None = None  # the unanswered request
        self._restart_reason = ""  # why an epoch began, until the driver gets it as an error
        self._done_tick: int | None = None  # the tick that the simulation has reached
        self._reply_s = 0.0  # when the server last sent a message
        self._sent_s = 0.0
        self._request_s = 0.0  # since when an answer is awaited, repeated requests included

    # --- what a driver calls ---

    def join(self, now_s: float) -> list[Outcome]:
        """Request the seat. Raises ProtocolError when the client has one, or has left."""
        if self.phase is not ClientPhase.OFF:
            raise errors.ProtocolError(
                f"join() in phase {self.phase.value!r}; expected a client that is off"
            )
        self._request_s = now_s
        self._reply_s = now_s
        return self._join_anew(now_s)

    def act(self, tick: int, joystick: Joystick, now_s: float) -> list[Outcome]:
        """Drive through `tick`. Raises ProtocolError unless the client has the frame of that tick.

        An action outside of the joystick's range raises BadActionError.
        """
        self._require_thinking("act()")
        if tick != self.tick:
            raise errors.ProtocolError(
                f"an action for tick {tick}; the seat is at tick {self.tick}"
            )
        if not (-1.0 <= joystick.x <= 1.0 and -1.0 <= joystick.y <= 1.0):
            raise errors.BadActionError(
                f"joystick ({joystick.x}, {joystick.y}); expected both in -1 to 1"
            )
        return self._send_request(
            m.Act(self.session, self.epoch, tick, self.life, joystick.x, joystick.y), now_s
        )

    def respawn(self, now_s: float) -> list[Outcome]:
        """Start the next episode without a tick. Raises ProtocolError while waiting for a frame."""
        self._require_thinking("respawn()")
        return self._send_request(m.Respawn(self.session, self.epoch, self.tick, self.life), now_s)

    def rebuild(self, seed: int, now_s: float) -> list[Outcome]:
        """Start the world again. Raises ProtocolError while waiting for a frame."""
        self._require_thinking("rebuild()")
        return self._send_request(m.Rebuild(self.session, self.epoch, seed), now_s)

    def beat(self, progress: int) -> list[Outcome]:
        """Show that the training goes on, with a counter that rises."""
        return [m.Beat(self.session, progress)] if self.session else []

    def leave(self) -> list[Outcome]:
        """Give the seat back; the client is unusable afterwards."""
        is_here = self.session and self.phase is not ClientPhase.GONE
        self.phase = ClientPhase.GONE
        return [m.Leave(self.session)] if is_here else []

    @property
    def waiting(self) -> bool:
        """Whether an answer is owed."""
        return self.phase not in _IDLE

    @property
    def master(self) -> bool:
        """Whether this client's action is the tick request, by the server's last word."""
        return self._master_seat == self.seat

    def copied(self) -> Self:
        """A core in the same state that changes by itself; sessions come from the same source."""
        return copy(self)

    # --- what comes in ---

    def handle(self, message: m.Reply, now_s: float) -> list[Outcome]:
        """Handle one message."""
        if self.phase in (ClientPhase.OFF, ClientPhase.GONE):
            return []
        self._reply_s = now_s
        match message:
            case m.Welcome():
                return self._receive_welcome(message)
            case m.TickDone():
                return self._receive_tick(message)
            case m.Frame():
                return self._receive_frame(message)
            case m.Restarted():
                self._receive_restart(message)
            case m.Waiting():
                self.late = message.late
            case m.Failure():
                return self._receive_failure(message, now_s)
            case m.Bye():
                if message.session in (b"", self.session):
                    self.phase = ClientPhase.GONE
                    reason = message.reason or "as requested"
                    return [errors.ServerGoneError(f"the server has ended: {reason}")]
        return []

    def clock(self, now_s: float) -> list[Outcome]:
        """Time has passed: repeat the request, or give up."""
        if not self.waiting:
            return []
        silent_s = now_s - self._reply_s
        if silent_s > self.patience.reconnect_s:
            self.phase = ClientPhase.GONE
            return [
                errors.ServerGoneError(
                    f"the server was silent for {silent_s:.0f} s; is it running?"
                )
            ]
        waited_s = now_s - self._request_s
        if waited_s > self.patience.tick_s:
            late = ", ".join(self.late) or "other clients"
            self.phase = ClientPhase.GONE
            return [errors.TickTimeoutError(f"no tick for {waited_s:.0f} s: waiting for {late}")]
        if min(silent_s, now_s - self._sent_s) < self.patience.resend_s:
            return []
        # A repeated join also brings a first frame that was lost.
        if self.pending is None or self.phase is ClientPhase.JOINING:
            return self._send_join(now_s)
        self._sent_s = now_s
        return [self.pending]

    def _receive_welcome(self, welcome: m.Welcome) -> list[Outcome]:
        if self.phase is not ClientPhase.JOINING or welcome.session != self.session:
            return []
        self.seat = welcome.seat
        self._master_seat = welcome.master
        if self.tick >= 0 and not self._restart_reason:
            self._restart_reason = f"the world is now in epoch {welcome.epoch}"
        self.pending = None
        self._await_first_frame(welcome.epoch)
        return [welcome]

    def _receive_tick(self, done: m.TickDone) -> list[Outcome]:
        # Before the first frame any tick may be reported: that frame sets the tick.
        if self.phase in (ClientPhase.JOINING, ClientPhase.WAIT_FIRST):
            return []
        reported = (done.epoch, done.tick)
        if reported <= (self.epoch, self.tick) or self._done_tick == done.tick:
            return []
        is_next = reported == (self.epoch, self.tick + 1)
        if self.phase is not ClientPhase.WAIT_TICK or not is_next:
            return self._break_off(f"the server is at epoch {done.epoch}, tick {done.tick}")
        self.phase = ClientPhase.WAIT_SENSORS
        self._done_tick = done.tick
        self._master_seat = done.master
        return []

    def _receive_frame(self, frame: m.Frame) -> list[Outcome]:
        # A frame of an earlier session, or the message of its epoch was lost: the client waits,
        # and repeats its request.
        if self.phase is ClientPhase.JOINING or frame.epoch > self.epoch:
            return []
        if self.phase is ClientPhase.WAIT_FIRST and frame.epoch == self.epoch and self.tick == -1:
            return self._show(frame)
        received = (frame.epoch, frame.tick, frame.life)
        if received <= (self.epoch, self.tick, self.life):
            return []
        if received == (self.epoch, self.tick + 1, 0):
            if self.phase is ClientPhase.WAIT_SENSORS:
                return self._show(frame)
            # The message of its tick was lost: the client repeats its request, and gets both.
            if self.phase is ClientPhase.WAIT_TICK:
                return []
        is_respawn = received == (self.epoch, self.tick, self.life + 1)
        if self.phase is ClientPhase.WAIT_RESPAWN and is_respawn:
            return self._show(frame)
        return self._break_off(f"got a frame of epoch, tick, life {received}")

    def _receive_restart(self, restarted: m.Restarted) -> None:
        """A new epoch in the same server: whatever was awaited, its first frame is next."""
        if restarted.epoch <= self.epoch or self.phase is ClientPhase.JOINING:
            return
        # Without a frame so far, the driver gets a first one anyway, and need not know.
        if self.tick >= 0:
            self._restart_reason = restarted.reason
        if not isinstance(self.pending, m.Rebuild):
            self.pending = None
        self._await_first_frame(restarted.epoch)

    def _receive_failure(self, failure: m.Failure, now_s: float) -> list[Outcome]:
        if failure.session and failure.session != self.session:
            return []
        if failure.error == errors.StaleSessionError.__name__:
            # Another server than the one that this client joined. A driver that thinks gets to
            # know when it acts.
            return self._join_anew(now_s) if self.waiting else []
        if failure.error == errors.StaleTickError.__name__:
            return []  # a late copy of a request: no member is ever two ticks behind
        if failure.error == errors.NotMasterError.__name__ and not isinstance(
            self.pending, m.Rebuild
        ):
            return []  # a late copy of an answer
        error = m.error_from_failure(failure)
        # The seat that this client had belongs to another one in this world; any other will do.
        takes_any = self.request.seat == m.ANY_SEAT and self.seat != m.ANY_SEAT
        if isinstance(error, errors.SeatTakenError) and takes_any:
            self.seat = m.ANY_SEAT
            return self._join_anew(now_s)
        if self.phase is ClientPhase.JOINING or isinstance(error, errors.EvictedError):
            self.phase = ClientPhase.OFF
            self.epoch = -1
            self.tick = -1
            self.pending = None
            self._restart_reason = ""
        elif self.waiting:
            self.phase = ClientPhase.THINK
            self.pending = None
        return [error]

    # --- inside ---

    def _require_thinking(self, call: str) -> None:
        if self.phase is not ClientPhase.THINK:
            raise errors.ProtocolError(
                f"{call} in phase {self.phase.value!r}; wait for the frame first"
            )

    def _send_request(self, message: m.Act | m.Respawn | m.Rebuild, now_s: float) -> list[Outcome]:
        self._request_s = now_s
        self._reply_s = now_s
        self._sent_s = now_s
        self.pending = message
        self.phase = _PHASE_AFTER[type(message)]
        self._done_tick = None
        return [message]

    def _join_anew(self, now_s: float) -> list[Outcome]:
        self.session = self._new_session()
        return self._send_join(now_s)

    def _send_join(self, now_s: float) -> list[Outcome]:
        self.phase = ClientPhase.JOINING
        self._sent_s = now_s
        request = self.request
        return [
            m.Join(
                protocol=m.PROTOCOL,
                schema=m.hash_message_schema(),
                config=request.config,
                session=self.session,
                claim=request.claim,
                seat=self.seat,
                name=request.name,
                spec=request.spec,
                pid=request.pid,
            )
        ]

    def _await_first_frame(self, epoch: int) -> None:
        self.epoch = epoch
        self.tick = -1
        self.life = 0
        self.phase = ClientPhase.WAIT_FIRST

    def _show(self, frame: m.Frame) -> list[Outcome]:
        """Set the client's place to that of a frame; returns it for the driver."""
        is_rebuilt = isinstance(self.pending, m.Rebuild)
        is_step = isinstance(self.pending, m.Act)
        self.epoch = frame.epoch
        self.tick = frame.tick
        self.life = frame.life
        self.phase = ClientPhase.THINK
        self.pending = None
        self.late = ()
        out: list[Outcome] = [
            ReceivedFrame(frame.epoch, frame.tick, frame.client, frame.slot, is_step)
        ]
        # A driver that requested the new epoch itself gets no error.
        if self._restart_reason and not is_rebuilt:
            out.append(
                errors.WorldRestartedError(f"{self._restart_reason}; continue with its first frame")
            )
        self._restart_reason = ""
        return out

    def _break_off(self, fault: str) -> list[Outcome]:
        """End the client, with the error for its driver."""
        place = (self.epoch, self.tick, self.life)
        message = f"{fault}; the client is at epoch, tick, life {place}, {self.phase.value}"
        self.phase = ClientPhase.GONE
        return [errors.ProtocolError(f"{message}: a step was lost or doubled")]
