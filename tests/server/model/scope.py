"""How far a check goes, and which cores it runs."""

from dataclasses import dataclass, fields
from enum import Enum

from wcsim.server.protocol.client_core import ClientCore
from wcsim.server.protocol.server_core import ServerCore


class Violation(Exception):
    """What the protocol promises does not hold; `trace` tells how it came to that."""

    trace: tuple[str, ...] = ()


class Notice(Enum):
    """What tells the server that a client is dead, beside its lease."""

    PROCESS = "process"
    LEASE = "lease alone"
    CONNECTION = "connection"  # whose end is told, also where its client lives: that one comes back through another


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """How often each fault, and each thing that a client may do but need not, can happen in one history."""

    crash: int = 0  # of a client's process
    hang: int = 0
    wake: int = 0  # a hung one goes on
    suspect: int = 0  # a live session is given up
    duplicate: int = 0  # any request arrives again behind those of now
    lose: int = 0  # one message, either way
    cut: int = 0  # all messages on their way from and to a client, or its connection, see `Notice`
    world: int = 0  # the server dies, a new epoch begins
    respawn: int = 0
    leave: int = 0
    rebuild: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scope(Budget):
    """What is explored."""

    clients: int = 2
    capacity: int = 2
    last_tick: int = 1
    starts: int = 2  # joins of each client, by the same process or by the next one
    expected: int = 2  # who comes later than the rest waits for a tick
    notice: Notice = Notice.PROCESS
    ends_at: int | None = None  # the last tick of epoch 0, which ends as planned; another server begins the next one
    any_seat: bool = False  # clients ask for any seat
    split_step: bool = False  # messages arrive while the world is on its way
    server: type[ServerCore] = ServerCore
    client: type[ClientCore] = ClientCore


BUDGETS = tuple(field.name for field in fields(Budget))
