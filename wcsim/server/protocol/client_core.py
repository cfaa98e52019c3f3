"""The client without input and output: what it says, what it expects, when it asks again, when it gives up.

The methods that a driver calls (`join`, `act`, `respawn`, `rebuild`, `leave`) and `handle(message, now_s)`,
`clock(now_s)` return what is to be done. A client has seen tick n, acts for n, hears that the simulation is at n + 1
(the paper's tick wait), and gets the frame of n + 1 (its sensors wait); anything else in between is an error or a
message that came twice. A master does nothing else: its action is the tick request.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from wcsim.errors import (
    BadActionError,
    EvictedError,
    NotMasterError,
    ProtocolError,
    SeatTakenError,
    ServerGoneError,
    StaleSessionError,
    StaleTickError,
    TickTimeoutError,
    WcsimError,
    WorldRestartedError,
)
from wcsim.server.protocol import messages as m
from wcsim.types import ClientSnapshot, Joystick, SeatSpec


class ClientPhase(Enum):
    """Where a client is; see docs/protocol.md."""

    OFF = "off"
    JOINING = "joining"
    WAIT_FIRST = "wait first"  # has its seat, waits for the first frame, or for that of a new epoch
    THINK = "think"
    WAIT_TICK = "wait tick"
    WAIT_SENSORS = "wait sensors"
    WAIT_RESPAWN = "wait respawn"
    GONE = "gone"


@dataclass(frozen=True, slots=True, kw_only=True)
class Ask:
    """Who a client is and what it asks for; `claim` stays the same over all its lives."""

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
class FrameSeen:
    """The frame that was waited for is here."""

    epoch: int
    tick: int
    client: ClientSnapshot | None
    slot: int
    stepped: bool  # it came of this client's action, not of a join, a respawn or a new epoch


Outcome = m.Request | FrameSeen | WcsimError | m.Welcome
"""A message to send; a frame; what failed, for the driver; that the client has its seat, with its shared memory."""
_IDLE = (ClientPhase.OFF, ClientPhase.THINK, ClientPhase.GONE)
_WAITS_OF = {
    m.Act: ClientPhase.WAIT_TICK,
    m.Respawn: ClientPhase.WAIT_RESPAWN,
    m.Rebuild: ClientPhase.WAIT_FIRST,
}


class ClientCore:
    """A client; see the module's text. `new_session` draws 16 bytes that nobody else has."""

    def __init__(self, ask: Ask, patience: Patience, new_session: Callable[[], bytes]) -> None:
        self.ask, self.patience = ask, patience
        self._new_session = new_session
        self.phase = ClientPhase.OFF
        self.session = b""
        self.seat = ask.seat
        self.epoch = self.tick = -1
        self.life = 0
        self._master_seat: int | None = None
        self.late: tuple[str, ...] = ()  # for whom the server waits, as far as it told
        self.pending: m.Act | m.Respawn | m.Rebuild | None = None  # what is not answered yet
        self._restarted = ""  # why an epoch began that the driver has not heard of
        self._ahead: int | None = None  # the tick that the simulation has reached
        self._heard_s = self._sent_s = self._asked_s = 0.0

    # --- what a driver does ---

    def join(self, now_s: float) -> list[Outcome]:
        """Ask for the seat. Raises ProtocolError when the client has one, or has left."""
        if self.phase is not ClientPhase.OFF:
            raise ProtocolError(
                f"join() in phase {self.phase.value!r}; expected a client that is off"
            )
        self._asked_s = self._heard_s = now_s
        return self._knock(now_s)

    def act(self, tick: int, joystick: Joystick, now_s: float) -> list[Outcome]:
        """Drive through `tick`. Raises ProtocolError unless that is the tick whose frame the client has.

        An action outside of the joystick's range raises BadActionError.
        """
        self._expect_thinking("act()")
        if tick != self.tick:
            raise ProtocolError(f"an action for tick {tick}; the seat is at tick {self.tick}")
        if not (-1.0 <= joystick.x <= 1.0 and -1.0 <= joystick.y <= 1.0):
            raise BadActionError(f"joystick ({joystick.x}, {joystick.y}); expected both in -1 to 1")
        return self._request(
            m.Act(self.session, self.epoch, tick, self.life, joystick.x, joystick.y), now_s
        )

    def respawn(self, now_s: float) -> list[Outcome]:
        """Begin the next episode without a tick. Raises ProtocolError while something else is waited for."""
        self._expect_thinking("respawn()")
        return self._request(m.Respawn(self.session, self.epoch, self.tick, self.life), now_s)

    def rebuild(self, seed: int, now_s: float) -> list[Outcome]:
        """Begin the world anew. Raises ProtocolError while something else is waited for."""
        self._expect_thinking("rebuild()")
        return self._request(m.Rebuild(self.session, self.epoch, seed), now_s)

    def beat(self, progress: int) -> list[Outcome]:
        """Show that the training goes on, with a counter that rises."""
        return [m.Beat(self.session, progress)] if self.session else []

    def leave(self) -> list[Outcome]:
        """Give the seat back; the client is of no use afterwards."""
        here = self.session and self.phase is not ClientPhase.GONE
        self.phase = ClientPhase.GONE
        return [m.Leave(self.session)] if here else []

    @property
    def waiting(self) -> bool:
        """Whether an answer is owed."""
        return self.phase not in _IDLE

    @property
    def master(self) -> bool:
        """Whether this client's action is the tick request, as last heard."""
        return self._master_seat == self.seat

    def copied(self) -> ClientCore:
        """A core in the same state that goes its own way; it draws its sessions from the same source."""
        twin = type(self).__new__(type(self))
        twin.__dict__.update(self.__dict__)
        return twin

    # --- what comes ---

    def handle(self, message: m.Reply, now_s: float) -> list[Outcome]:
        """Take in one message."""
        if self.phase in (ClientPhase.OFF, ClientPhase.GONE):
            return []
        self._heard_s = now_s
        match message:
            case m.Welcome():
                return self._welcomed(message)
            case m.TickDone():
                return self._tick_done(message)
            case m.Frame():
                return self._frame(message)
            case m.Restarted():
                self._restart(message)
            case m.Waiting():
                self.late = message.late
            case m.Failure():
                return self._failure(message, now_s)
            case m.Bye():
                return self._bye(message)
        return []

    def clock(self, now_s: float) -> list[Outcome]:
        """Time has passed: ask again, or give up."""
        if not self.waiting:
            return []
        silent_s = now_s - self._heard_s
        if silent_s > self.patience.reconnect_s:
            self.phase = ClientPhase.GONE
            return [ServerGoneError(f"the server was silent for {silent_s:.0f} s; is it running?")]
        if now_s - self._asked_s > self.patience.tick_s:
            whom = ", ".join(self.late) or "other clients"
            self.phase = ClientPhase.GONE
            return [
                TickTimeoutError(f"no tick for {now_s - self._asked_s:.0f} s: waiting for {whom}")
            ]
        if min(silent_s, now_s - self._sent_s) < self.patience.resend_s:
            return []
        if self.pending is None or self.phase is ClientPhase.JOINING:
            return self._knock(now_s, again=True)  # the way to a lost first frame, too
        self._sent_s = now_s
        return [self.pending]

    # --- inside ---

    def _expect_thinking(self, call: str) -> None:
        if self.phase is not ClientPhase.THINK:
            raise ProtocolError(f"{call} in phase {self.phase.value!r}; wait for the frame first")

    def _request(self, message: m.Act | m.Respawn | m.Rebuild, now_s: float) -> list[Outcome]:
        self._asked_s = self._heard_s = self._sent_s = now_s
        self.pending, self.phase, self._ahead = message, _WAITS_OF[type(message)], None
        return [message]

    def _knock(self, now_s: float, again: bool = False) -> list[Outcome]:
        if not again:
            self.session = self._new_session()
        self.phase, self._sent_s = ClientPhase.JOINING, now_s
        ask = self.ask
        return [
            m.Join(
                protocol=m.PROTOCOL,
                schema=m.schema_hash(),
                config=ask.config,
                session=self.session,
                claim=ask.claim,
                seat=self.seat,
                name=ask.name,
                spec=ask.spec,
                pid=ask.pid,
            )
        ]

    def _welcomed(self, welcome: m.Welcome) -> list[Outcome]:
        if self.phase is not ClientPhase.JOINING or welcome.session != self.session:
            return []
        self.seat, self._master_seat = welcome.seat, welcome.master
        if self.tick >= 0:
            self._restarted = self._restarted or f"the world is now in epoch {welcome.epoch}"
        self.pending = None
        self.epoch, self.tick, self.life = welcome.epoch, -1, 0
        self.phase = ClientPhase.WAIT_FIRST
        return [welcome]

    def _tick_done(self, done: m.TickDone) -> list[Outcome]:
        early = self.phase in (
            ClientPhase.JOINING,
            ClientPhase.WAIT_FIRST,
        )  # a frame comes next, from wherever it is
        if early or (done.epoch, done.tick) <= (self.epoch, self.tick) or self._ahead == done.tick:
            return []
        if self.phase is not ClientPhase.WAIT_TICK or (done.epoch, done.tick) != (
            self.epoch,
            self.tick + 1,
        ):
            return self._broken(f"the server is at epoch {done.epoch}, tick {done.tick}")
        self.phase, self._ahead, self._master_seat = (
            ClientPhase.WAIT_SENSORS,
            done.tick,
            done.master,
        )
        return []

    def _frame(self, frame: m.Frame) -> list[Outcome]:
        if self.phase is ClientPhase.JOINING or frame.epoch > self.epoch:
            return []  # of a life before, or the word of its epoch was lost: who waits asks again
        if self.phase is ClientPhase.WAIT_FIRST and frame.epoch == self.epoch and self.tick == -1:
            return self._seen(frame)
        got, have = (frame.epoch, frame.tick, frame.life), (self.epoch, self.tick, self.life)
        if got <= have:
            return []
        if got == (self.epoch, self.tick + 1, 0):
            if self.phase is ClientPhase.WAIT_SENSORS:
                return self._seen(frame)
            if self.phase is ClientPhase.WAIT_TICK:
                return []  # the word of its tick was lost: the client asks again, and gets both
        if self.phase is ClientPhase.WAIT_RESPAWN and got == (self.epoch, self.tick, self.life + 1):
            return self._seen(frame)
        return self._broken(f"got a frame of epoch, tick, life {got}")

    def _seen(self, frame: m.Frame) -> list[Outcome]:
        rebuilt, stepped = isinstance(self.pending, m.Rebuild), isinstance(self.pending, m.Act)
        self.epoch, self.tick, self.life = frame.epoch, frame.tick, frame.life
        self.phase, self.pending, self.late = ClientPhase.THINK, None, ()
        out: list[Outcome] = [FrameSeen(frame.epoch, frame.tick, frame.client, frame.slot, stepped)]
        if self._restarted and not rebuilt:
            out.append(WorldRestartedError(f"{self._restarted}; continue with its first frame"))
        self._restarted = ""
        return out

    def _restart(self, restarted: m.Restarted) -> None:
        """A new epoch in the same server: its first frame comes next, whatever was waited for."""
        if restarted.epoch <= self.epoch or self.phase is ClientPhase.JOINING:
            return
        if self.tick >= 0:  # otherwise the driver has yet to see a first frame, whichever that is
            self._restarted = restarted.reason
        self.epoch, self.tick, self.life = restarted.epoch, -1, 0
        if not isinstance(self.pending, m.Rebuild):
            self.pending = None
        self.phase = ClientPhase.WAIT_FIRST

    def _failure(self, failure: m.Failure, now_s: float) -> list[Outcome]:
        if failure.session and failure.session != self.session:
            return []
        if failure.error == StaleSessionError.__name__:
            # Another server than the one that this client joined; a driver that thinks hears of it when it acts.
            return self._knock(now_s) if self.waiting else []
        if failure.error == StaleTickError.__name__:
            return []  # a request that came late once more: who is a member is never two ticks behind
        if failure.error == NotMasterError.__name__ and not isinstance(self.pending, m.Rebuild):
            return []  # this one had its answer before
        error = m.error_of(failure)
        if (
            isinstance(error, SeatTakenError)
            and self.ask.seat == m.ANY_SEAT
            and self.seat != m.ANY_SEAT
        ):
            self.seat = (
                m.ANY_SEAT
            )  # the seat it once had is another's in this world; any other one will do
            return self._knock(now_s)
        if self.phase is ClientPhase.JOINING or isinstance(error, EvictedError):
            self.phase = ClientPhase.OFF
            self.epoch = self.tick = -1
            self.pending, self._restarted = None, ""
        elif self.waiting:
            self.phase, self.pending = ClientPhase.THINK, None
        return [error]

    def _bye(self, bye: m.Bye) -> list[Outcome]:
        if bye.session and bye.session != self.session:
            return []
        self.phase = ClientPhase.GONE
        return [ServerGoneError(f"the server has ended: {bye.reason or 'as requested'}")]

    def _broken(self, what: str) -> list[Outcome]:
        told = f"{what}; the client is at epoch, tick, life {(self.epoch, self.tick, self.life)}, {self.phase.value}"
        self.phase = ClientPhase.GONE
        return [ProtocolError(f"{told}: a step was lost or doubled")]
