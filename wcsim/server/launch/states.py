"""What a launcher is asked to run, and what it knows of its processes while they run.

When a process that died is started again, and when it is given up.
"""

from __future__ import annotations

import signal
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Literal

from wcsim.server.specs import ClientStatus, WorldStatus

_MOST_DOUBLINGS = 64  # beyond any wait, and still a number


@dataclass(frozen=True, slots=True, kw_only=True)
class RestartRules:
    """How patient a launcher is with a process."""

    first_s: float = 0.5  # before the first restart; twice as long before each further one without progress
    longest_s: float = 30.0
    deaths: int = 5  # without progress; then it is given up


class Restarts:
    """Counts the deaths of one process.

    >>> restarts = Restarts(RestartRules())
    >>> [restarts.died(progressed=False) for _ in range(5)]
    [0.5, 1.0, 2.0, 4.0, None]
    >>> restarts.died(progressed=True)
    0.5
    >>> patient = Restarts(RestartRules(deaths=10_000))
    >>> [patient.died(progressed=False) for _ in range(2_000)][-1]
    30.0
    """

    def __init__(self, rules: RestartRules) -> None:
        self.rules = rules
        self.deaths = 0  # in all
        self.in_vain = 0  # without progress, in a row

    def died(self, progressed: bool) -> float | None:
        """The process has died: seconds until it is to be started again, None when that is of no use any more."""
        self.deaths += 1
        self.in_vain = 1 if progressed else self.in_vain + 1
        if self.in_vain >= self.rules.deaths:
            return None
        return min(self.rules.first_s * 2.0 ** min(self.in_vain - 1, _MOST_DOUBLINGS), self.rules.longest_s)


WAIT_NO_MORE = signal.SIGUSR1
"""Asks a client to end that would else wait for a world which does not go on.

A second SIGTERM would not do: it may come while the first one is being obeyed, and both may come as one.
"""


class ClientExit(IntEnum):
    """How a client process ends; every other code, and every signal, is a crash.

    Those are tried again, and so are STOPPED, SERVER_GONE and EVICTED.
    """

    DONE = 0
    USER_ERROR = 2  # another try would end in the same way
    STOPPED = 3  # it was asked to, saved its work, and can go on
    SERVER_GONE = 4
    EVICTED = 5
    DISK_FULL = 6  # not tried again either, but that is no fault of what was asked for
    GROWN = 7  # as planned: its work is saved, and a new process goes on with it


class WorldExit(IntEnum):
    """How a world process ends."""

    DONE = 0
    USER_ERROR = 2  # another try would end in the same way
    FAILED = 3  # a simulator failed
    DISK_FULL = 4
    EPOCH_OVER = 5  # as planned: a new process goes on with the next epoch


Standing = Literal["starting", "running", "down", "done", "stopped", "given up"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientPlan:
    """A client process. It is started with `argv --status-fd N`, and `--resume` after a death.

    Its `order` is written to `order_file` before every start: what lies in shared memory may be gone by then.
    """

    name: str
    seat: int
    argv: tuple[str, ...]
    log: Path
    folder: Path  # where its work is
    resume: bool = False  # also at the first start
    order: bytes = b""
    order_file: Path | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchRules:
    """How long a launcher waits for what, in seconds."""

    world_lease_s: float = 10.0  # a world that says nothing for so long hangs ...
    loading_lease_s: float = 300.0  # ... unless it has not done a tick yet
    client_lease_s: float = 120.0  # a client that the world gave up, and that lives on without its seat
    joining_s: float = 600.0  # a client that never took its seat
    saving_s: float = 300.0  # clients that were asked to end, with all their replay to write
    leaving_s: float = 2.0  # for the world to hear that all clients have left
    ending_s: float = 30.0  # a world that was asked to end
    client: RestartRules = RestartRules()
    world: RestartRules = RestartRules()


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientState:
    """A client as the launcher sees it now."""

    name: str
    seat: int
    standing: Standing
    pid: int = 0  # 0 while it is not there
    restarts: int = 0
    status: ClientStatus | None = None  # the last one
    reason: str = ""  # of its last death
    unsaved: str = ""  # why what it did last is lost, though it was asked to save it


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchState:
    """All processes as the launcher sees them now."""

    elapsed_s: float
    world_standing: Standing
    world_pid: int
    world_restarts: int
    world: WorldStatus | None
    clients: tuple[ClientState, ...]
    stopping: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchOutcome:
    """How it ended: code 0 when all clients are done or it was stopped, 1 when one was given up, 2 for a mistake."""

    code: int
    message: str
    stopped: bool
    clients: tuple[ClientState, ...]
    elapsed_s: float
    by_signal: bool = False  # it was stopped by a signal, not by `Launcher.stop`
