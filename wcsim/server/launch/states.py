"""What a launcher runs, and what it knows of its processes while they run.

Plans, rules for restarts and waits, the status that processes send, exit codes, and the outcome.
"""

import signal
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Final, Literal

WAIT_NO_MORE: Final = signal.SIGUSR1
"""Ends a client that would else wait for a world which does not go on.

A second SIGTERM would not do: it may arrive while the first one is handled, and both may arrive as
one.
"""
# Beyond any wait, and still a number.
_MOST_DOUBLINGS: Final = 64

Standing = Literal["starting", "running", "down", "done", "stopped", "given up", "elsewhere"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientBarrierDelay:
    """How long the others have waited for one client while the barrier filled."""

    name: str
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldStatusReport:
    """What a world process reports a few times a second."""

    stage: str  # "loading", or a Stage
    epoch: int = 0
    tick: int = 0
    ticks: int = 0  # done by this process
    ticks_per_s: float = 0.0  # over the last seconds
    step_ms: float = 0.0  # median of the last steps
    members: tuple[str, ...] = ()
    master: str = ""
    late: tuple[str, ...] = ()  # the clients for which the barrier waits
    late_s: float = 0.0  # since when
    rss_mb: float = 0.0
    # Over the life of this process, by seat, without clients that left.
    held: tuple[ClientBarrierDelay, ...] = ()
    # What each of `members` (rows) has waited for each (columns).
    waited_s: tuple[tuple[float, ...], ...] = ()
    listening: str = ""  # the address for clients on other machines


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientStatusReport:
    """What a client process reports."""

    name: str
    step: int = 0
    total_steps: int = 0
    phase: int = 1
    episodes: int = 0
    crashes: int = 0
    kpi1: float | None = None  # of the agent's own choice, mean of the last 2,000 steps
    simulation_s: float = 0.0  # waiting for the world's own work
    barrier_s: float = 0.0  # waiting for other clients, and for messages
    inference_s: float = 0.0
    learning_s: float = 0.0
    # The part of learning_s while it waited; it also counts in one of the first two.
    overlap_s: float = 0.0
    pid: int = 0  # of the life that these times are of


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessRestartRules:
    """When a process that died is restarted, and when it is given up."""

    # Before the first restart; it doubles with each further death without progress.
    first_s: float = 0.5
    longest_s: float = 30.0
    deaths: int = 5  # without progress; then it is given up

    def wait_s(self, deaths_without_progress: int) -> float | None:
        """Seconds until the restart after so many deaths in a row; None to give up.

        >>> [ProcessRestartRules().wait_s(deaths) for deaths in (1, 2, 3, 4, 5)]
        [0.5, 1.0, 2.0, 4.0, None]
        >>> ProcessRestartRules(deaths=10_000).wait_s(2_000)
        30.0
        """
        if deaths_without_progress >= self.deaths:
            return None
        doublings = min(deaths_without_progress - 1, _MOST_DOUBLINGS)
        return min(self.first_s * 2.0**doublings, self.longest_s)


class ClientExitCode(IntEnum):
    """How a client process ends; every other code, and every signal, is a crash.

    After a crash, STOPPED, SERVER_GONE and EVICTED it is restarted.
    """

    DONE = 0
    USER_ERROR = 2  # another try would end in the same way
    STOPPED = 3  # its end was requested, it saved its work, and can go on
    SERVER_GONE = 4
    EVICTED = 5
    DISK_FULL = 6  # not restarted either, but the user's input is not at fault
    GROWN = 7  # as planned: its work is saved, and a new process goes on with it


class WorldExitCode(IntEnum):
    """How a world process ends."""

    DONE = 0
    USER_ERROR = 2  # another try would end in the same way
    FAILED = 3  # a simulator failed
    DISK_FULL = 4
    EPOCH_OVER = 5  # as planned: a new process goes on with the next epoch


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientLaunchPlan:
    """A client process. It is started with `argv --status-fd N`, and `--resume` after a death.

    Its `order` is written to `order_file` before every start: files in shared memory may have been
    removed by then.
    """

    name: str
    seat: int
    argv: tuple[str, ...]
    log: Path
    resume: bool = False  # also at the first start
    order: bytes = b""
    order_file: Path | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldLaunchPlan:
    """A world process."""

    argv: tuple[str, ...]
    # Its order, by the number of its pipe, whether no world was loaded yet, and the address of the
    # one before it ("": none).
    order: Callable[[int, bool, str], bytes]
    order_file: Path  # beside the socket of the world; written before every start
    log: Path
    # The last tick of its last epoch, by the one that it reported.
    last_tick: Callable[[int], int]


@dataclass(frozen=True, slots=True, kw_only=True)
class LauncherTimeouts:
    """How long a launcher waits for what, in seconds."""

    # A world that sends no status for this time hangs. It has longer before its first tick, and
    # less while a signal has stopped it: that does not end by itself.
    world_lease_s: float = 10.0
    loading_lease_s: float = 300.0
    held_s: float = 2.0
    # A client that lives on without the seat that the world took from it, or never takes a seat.
    client_lease_s: float = 120.0
    joining_s: float = 600.0
    # After the request to end: clients have to write their replay, and the world has to receive
    # that all clients have left.
    saving_s: float = 300.0
    leaving_s: float = 2.0
    ending_s: float = 30.0
    client: ProcessRestartRules = ProcessRestartRules()
    world: ProcessRestartRules = ProcessRestartRules()


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientProcessState:
    """A client as the launcher sees it now."""

    name: str
    seat: int
    standing: Standing
    pid: int = 0  # 0 while there is no process
    restarts: int = 0
    status: ClientStatusReport | None = None  # the last one
    reason: str = ""  # of its last death
    unsaved: str = ""  # why its last work is lost, though its end was requested


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchProcessStates:
    """All processes as the launcher sees them now."""

    elapsed_s: float
    world_standing: Standing
    world_pid: int
    world_restarts: int
    world: WorldStatusReport | None
    clients: tuple[ClientProcessState, ...]
    stopping: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchResult:
    """How a launch ended."""

    code: int  # 0: all clients are done or it was stopped; 1: one was given up; 2: a user's mistake
    message: str
    stopped: bool
    clients: tuple[ClientProcessState, ...]
    by_signal: bool = False  # it was stopped by a signal, not by `ProcessLauncher.stop`
