"""Events of a server core and the effects that it requests: plain values, no input or output.

`ServerCore.handle(event, now_s)` returns effects, which its host carries out in their order. The
host is a world process behind ZeroMQ, a process with the world inside, a model checker or a
simulator of faults.
"""

from dataclasses import dataclass
from enum import Enum

from wcsim.server.protocol.messages import Reply, Request
from wcsim.types import Command, SeatSpec

Peer = bytes
"""The connection of a message and of its answer; only the host knows what it means."""


class BarrierState(Enum):
    """Where a server is in its cycle; see docs/protocol.md."""

    EMPTY = "empty"  # no client is in, or not yet all that are expected
    COLLECT = "collect"  # waits for all actions of this tick
    STEPPING = "stepping"  # the barrier is full, the world is on its way to the next tick
    # The barrier of the last tick is full; another server goes on with the next epoch.
    EPOCH_OVER = "epoch over"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerRules:
    """What a server allows; seconds are of the host's clock."""

    capacity: int  # seats
    config: str = ""  # hash of the world's configuration; clients that state another are refused
    expected: int = 1  # the first tick waits for so many clients ...
    gather_s: float = 120.0  # ... but not longer than this
    # A client that owes an action and shows no progress for so long is evicted ...
    lease_s: float = 120.0
    notice_s: float = 1.0  # how often those who wait get to know for whom
    # ... and one that takes longer than this for an action, alive or not.
    max_think_s: float | None = None
    recordings: tuple[str, ...] | None = ()  # "recorded:FILE" that clients may request; None: any


# --- events ---


@dataclass(frozen=True, slots=True)
class MessageReceivedEvent:
    """A message has arrived."""

    peer: Peer
    message: Request


@dataclass(frozen=True, slots=True)
class ClientLostEvent:
    """The client of this session is dead, or only cut off: then it may join again."""

    session: bytes
    reason: str = "its process ended"
    may_return: bool = False


@dataclass(frozen=True, slots=True)
class TimePassedEvent:
    """Time has passed."""


@dataclass(frozen=True, slots=True)
class WorldSteppedEvent:
    """The world has reached this tick, as `StepWorldEffect` requested."""

    tick: int
    step_s: float = 0.0  # duration


@dataclass(frozen=True, slots=True)
class StopServerEvent:
    """The server shall end."""

    reason: str = ""


Event = (
    MessageReceivedEvent | ClientLostEvent | TimePassedEvent | WorldSteppedEvent | StopServerEvent
)


# --- effects ---


@dataclass(frozen=True, slots=True)
class SendMessageEffect:
    """Send a message."""

    peer: Peer
    message: Reply


@dataclass(frozen=True, slots=True)
class SendSensorFrameEffect:
    """Send the present frame of a seat."""

    peer: Peer
    seat: int
    epoch: int
    tick: int
    life: int


@dataclass(frozen=True, slots=True)
class AdmitSeatEffect:
    """Put a chair for this seat into the world."""

    seat: int
    spec: SeatSpec
    name: str


@dataclass(frozen=True, slots=True)
class DismissSeatEffect:
    """Take the seat's chair out of the world."""

    seat: int
    reason: str


@dataclass(frozen=True, slots=True)
class RespawnSeatsEffect:
    """Start the next episodes of these seats, in this order."""

    seats: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class RebuildWorldEffect:
    """Start a new epoch with this seed."""

    epoch: int
    seed: int


@dataclass(frozen=True, slots=True)
class StepWorldEffect:
    """Carry the world through tick `tick`, then report `WorldSteppedEvent(tick + 1)`."""

    tick: int
    commands: tuple[Command, ...]


Effect = (
    SendMessageEffect
    | SendSensorFrameEffect
    | AdmitSeatEffect
    | DismissSeatEffect
    | RespawnSeatsEffect
    | RebuildWorldEffect
    | StepWorldEffect
)
