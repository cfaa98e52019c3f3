"""What a launcher is asked to run, and what it knows of its processes while they run.

When a process that died is started again, and when it is given up. What processes say of themselves.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Literal

_MOST_DOUBLINGS = 64  # beyond any wait, and still a number


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """How long the others have waited for one client while the barrier filled."""

    name: str
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldStatus:
    """What a world process says of itself a few times a second."""

    stage: str  # "loading", or a Stage
    epoch: int = 0
    tick: int = 0
    ticks: int = 0  # done by this process
    ticks_per_s: float = 0.0  # over the last seconds
    step_ms: float = 0.0  # median of the last steps
    members: tuple[str, ...] = ()
    master: str = ""
    late: tuple[str, ...] = ()  # for whom the barrier waits
    late_s: float = 0.0  # since when
    rss_mb: float = 0.0
    held: tuple[
        Held, ...
    ] = ()  # over the life of this process, by seat; those who left are not in it
    waited_s: tuple[
        tuple[float, ...], ...
    ] = ()  # what each of `members` (rows) has waited for each (columns)
    listening: str = ""  # the address for clients on other machines


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientStatus:
    """What a client process says of itself."""

    name: str
    step: int = 0
    total_steps: int = 0
    phase: int = 1
    episodes: int = 0
    crashes: int = 0
    kpi1: float | None = None  # of the agent's own choice, mean of the last 2,000 steps
    simulation_s: float = 0.0  # waiting for the world's own work
    barrier_s: float = 0.0  # waiting for others, and for messages
    inference_s: float = 0.0
    learning_s: float = 0.0
    overlap_s: float = 0.0  # of learning_s, done while it waited: in one of the first two as well
    pid: int = 0  # of the life that these times are of


@dataclass(frozen=True, slots=True, kw_only=True)
class RestartRules:
    """How patient a launcher is with a process."""

    first_s: float = (
        0.5  # before the first restart; twice as long before each further one without progress
    )
    longest_s: float = 30.0
    deaths: int = 5  # without progress; then it is given up

    def wait_s(self, in_vain: int) -> float | None:
        """Seconds until a process is started again that has died so often without progress; None: of no use any more.

        >>> [RestartRules().wait_s(deaths) for deaths in (1, 2, 3, 4, 5)]
        [0.5, 1.0, 2.0, 4.0, None]
        >>> RestartRules(deaths=10_000).wait_s(2_000)
        30.0
        """
        if in_vain >= self.deaths:
            return None
        return min(self.first_s * 2.0 ** min(in_vain - 1, _MOST_DOUBLINGS), self.longest_s)


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


Standing = Literal["starting", "running", "down", "done", "stopped", "given up", "elsewhere"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientPlan:
    """A client process. It is started with `argv --status-fd N`, and `--resume` after a death.

    Its `order` is written to `order_file` before every start: what lies in shared memory may be gone by then.
    """

    name: str
    seat: int
    argv: tuple[str, ...]
    log: Path
    resume: bool = False  # also at the first start
    order: bytes = b""
    order_file: Path | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldPlan:
    """A world process; its order is written to `order_file` before every start, beside the socket of the world."""

    argv: tuple[str, ...]
    # The number of its pipe, whether none was there yet, and where the one before it listened ("": nowhere).
    order: Callable[[int, bool, str], bytes]
    order_file: Path
    log: Path
    last_tick: Callable[[int], int]  # that it has done in its last epoch, by what it told


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchRules:
    """How long a launcher waits for what, in seconds."""

    world_lease_s: float = 10.0  # a world that says nothing for so long hangs ...
    loading_lease_s: float = 300.0  # ... unless it has not done a tick yet
    held_s: float = 2.0  # ... or a signal holds it, which nothing ends by itself
    client_lease_s: float = (
        120.0  # a client that the world gave up, and that lives on without its seat
    )
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
    by_signal: bool = False  # it was stopped by a signal, not by `Launcher.stop`
