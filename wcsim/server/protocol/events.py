"""What happens to a server core and what it wants done: plain values, no input or output.

`ServerCore.handle(event, now_s)` returns effects, which its host carries out in their order. The host is a world
process behind ZeroMQ, a process with the world inside, a model checker or a simulator of faults.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from wcsim.server.protocol.messages import Reply, Request
from wcsim.types import Command, SeatSpec

Peer = bytes
"""Where a message came from, and where an answer goes: known to the host alone."""


class BarrierState(Enum):
    """Where a server is in its cycle; see docs/protocol.md."""

    EMPTY = "empty"  # nobody is here, or not yet all of those who are expected
    COLLECT = "collect"  # waits for everybody's action of this tick
    STEPPING = "stepping"  # the barrier is full, the world is on its way to the next tick
    EPOCH_OVER = "epoch over"  # the barrier of the last tick is full; another server goes on with the next epoch
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """What a server allows; seconds are of the host's clock."""

    capacity: int  # seats
    config: str = (
        ""  # hash of the world's configuration; a client that states another one is refused
    )
    expected: int = 1  # clients without whom the first tick is not begun ...
    gather_s: float = 120.0  # ... unless so much time is over
    lease_s: float = (
        120.0  # a client that owes an action and shows no progress for so long is given up
    )
    notice_s: float = 1.0  # how often those who wait are told for whom
    max_think_s: float | None = (
        None  # a client that takes longer for an action is given up, alive or not
    )
    recordings: tuple[str, ...] | None = ()  # "recorded:FILE" that clients may ask for; None: any


# --- what happens ---


@dataclass(frozen=True, slots=True)
class Received:
    """A message has come."""

    peer: Peer
    message: Request


@dataclass(frozen=True, slots=True)
class Lost:
    """The host knows that the client of this session is dead, or only cut off: then it may join again."""

    session: bytes
    reason: str = "its process ended"
    may_return: bool = False


@dataclass(frozen=True, slots=True)
class Clock:
    """Time has passed."""


@dataclass(frozen=True, slots=True)
class Stepped:
    """The world has reached this tick, as `Step` asked for."""

    tick: int
    step_s: float = 0.0  # what it took


@dataclass(frozen=True, slots=True)
class Stop:
    """The server shall end."""

    reason: str = ""


Event = Received | Lost | Clock | Stepped | Stop


# --- what is to be done, in this order ---


@dataclass(frozen=True, slots=True)
class Send:
    """Send a message."""

    peer: Peer
    message: Reply


@dataclass(frozen=True, slots=True)
class SendFrame:
    """Send what the seat sees now."""

    peer: Peer
    seat: int
    epoch: int
    tick: int
    life: int


@dataclass(frozen=True, slots=True)
class Admit:
    """Put a chair for this seat into the world."""

    seat: int
    spec: SeatSpec
    name: str


@dataclass(frozen=True, slots=True)
class Dismiss:
    """Take the seat's chair out of the world."""

    seat: int
    reason: str


@dataclass(frozen=True, slots=True)
class RespawnSeats:
    """Begin the next episodes of these seats, in this order."""

    seats: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class RebuildWorld:
    """Begin a new epoch with this seed."""

    epoch: int
    seed: int


@dataclass(frozen=True, slots=True)
class Step:
    """Carry the world through tick `tick`, then report `Stepped(tick + 1)`."""

    tick: int
    commands: tuple[Command, ...]


Effect = Send | SendFrame | Admit | Dismiss | RespawnSeats | RebuildWorld | Step
