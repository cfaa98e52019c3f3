"""A world and several clients as processes: started, watched, restarted, ended in order.

The launcher is a tiny process that loads no simulator and no torch. One loop waits for pipes and
ends of processes, and everything has a deadline. The children die with it, however it ends.
"""

import selectors
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from enum import Enum
from pathlib import Path
from typing import Final

from wcsim.core.processes import StopSignalCounter
from wcsim.server.launch.awake_clock import SuspendSafeClock
from wcsim.server.launch.event_log import EventLogWriter
from wcsim.server.launch.states import (
    ClientLaunchPlan,
    ClientProcessState,
    LauncherTimeouts,
    LaunchProcessStates,
    LaunchResult,
    WorldLaunchPlan,
)
from wcsim.server.launch.supervised import WatchedClientProcess, WatchedWorldProcess

_POLL_S: Final = 0.1
_SHOW_S: Final = 0.25
# A client that has not ended after this time may wait for a world that does not go on.
_CLIENT_WAITS_S: Final = 240.0
# The same where the world does not tick.
_CLIENT_WAITS_IDLE_S: Final = 2.0

Show = Callable[[LaunchProcessStates], None]


class _LaunchStep(Enum):
    RUN = "run"
    CLIENTS_END = "clients end"
    WORLD_ENDS = "world ends"
    OVER = "over"


class ProcessLauncher:
    """A launch; `run` does it once."""

    def __init__(
        self,
        world: WorldLaunchPlan | None,
        clients: Sequence[ClientLaunchPlan],
        folder: Path,
        rules: LauncherTimeouts | None = None,
        show: Show | None = None,
        signals: StopSignalCounter | None = None,
    ) -> None:
        """Prepare a launch.

        Args:
            world: The world; None where another process runs it.
            clients: The clients; none for a world that waits for others.
            folder: For events.jsonl.
            rules: How long to wait for what.
            show: Called a few times a second.
            signals: Those that request the end, where the caller has opened them. A second signal
                kills all processes.
        """
        self._rules = rules if rules is not None else LauncherTimeouts()
        self._show = show
        self._selector = selectors.DefaultSelector()
        self._log = log = EventLogWriter(folder)
        self._clients = [
            WatchedClientProcess(plan, self._rules, self._selector, log) for plan in clients
        ]
        self._world: WatchedWorldProcess | None = None
        self._processes: list[WatchedWorldProcess | WatchedClientProcess] = [*self._clients]
        if world is not None:
            self._world = WatchedWorldProcess(world, self._rules, self._selector, log)
            self._processes.insert(0, self._world)
        self._opens_signals = signals is None
        self._stop_signals = StopSignalCounter() if signals is None else signals
        self._stop_calls = 0
        self._step = _LaunchStep.RUN
        self._step_s = 0.0  # when it started
        self._sent_wait_no_more = False
        self._requested_world_end = False
        self._ticked = world is None  # another process's world counts as one that ticks
        self._shown_s = 0.0
        # The outcome.
        self._stopped = False
        self._code = 0
        self._message = ""

    def run(self) -> LaunchResult:
        """Start all processes, and return when none of them runs any more."""
        # The time that a launcher was stopped does not count as waited.
        clock = SuspendSafeClock(time.monotonic())
        try:
            with self._stop_signals if self._opens_signals else nullcontext():
                for process in self._processes:
                    process.start(clock.now_s)
                while self._step is not _LaunchStep.OVER:
                    self._selector.select(_POLL_S)
                    self._poll(clock.look(time.monotonic()))
                    self._show_state(clock.now_s)
        except Exception:
            self._save_clients()
            raise
        finally:
            for process in reversed(self._processes):
                process.close()
            self._selector.close()
        return LaunchResult(
            code=self._code,
            message=self._message,
            stopped=self._stopped,
            clients=self._client_states(),
            by_signal=self._stopped and self._stop_signals.count > 0,
        )

    def stop(self) -> None:
        """Request an orderly end, as SIGTERM does."""
        self._stop_calls += 1

    @property
    def _stop_requests(self) -> int:
        return self._stop_calls + self._stop_signals.count

    @property
    def _world_ticks(self) -> bool:
        """Whether there is a world of its own that ticks."""
        return self._world is not None and self._world.ticks

    def _poll(self, now_s: float) -> None:
        # 1. What has happened to the processes.
        world = self._world
        if world is not None:
            world.poll(now_s)
        self._ticked |= self._world_ticks
        for client in self._clients:
            client.set_world(world.status if world is not None and world.running else None)
            client.poll(now_s)
        # 2. A second request ends them at once.
        if self._stop_requests > 1:
            for process in self._processes:
                process.kill()
        # 3. A step that is over goes into the next one at once.
        if self._step is _LaunchStep.RUN:
            self._end_if_needed(now_s)
        if self._step is _LaunchStep.CLIENTS_END:
            self._wait_for_clients(now_s)
        if self._step is _LaunchStep.WORLD_ENDS:
            self._wait_for_world(now_s)

    def _end_if_needed(self, now_s: float) -> None:
        # The clients first: their messages are more precise than the world's.
        faulty = [process for process in [*self._clients, *self._processes] if process.fault]
        if faulty:
            self._end_clients(now_s, 2 if faulty[0].refused else 1, faulty[0].fault)
        elif self._stop_requests:
            self._stopped = True
            self._end_clients(now_s, 0, "stopped")
        elif not self._ticked and any(client.standing == "given up" for client in self._clients):
            # The world would wait for this client before its first tick.
            self._end_clients(now_s, *self._verdict())
        elif self._clients and all(client.settled for client in self._clients):
            self._code, self._message = self._verdict()
            self._go_to(_LaunchStep.WORLD_ENDS, now_s)

    def _verdict(self) -> tuple[int, str]:
        """The exit code, and a message on the clients that were given up."""
        lost = [client for client in self._clients if client.standing == "given up"]
        if not lost:
            return 0, ""
        texts = [f"client {client.plan.name} was dropped: it {client.reason}" for client in lost]
        return 1, f"{'; '.join(texts)}; see {lost[0].plan.log}"

    def _end_clients(self, now_s: float, code: int, message: str) -> None:
        self._code = code
        self._message = message
        self._log.add("stop", code=code, reason=message)
        for client in self._clients:
            client.request_end()
        self._go_to(_LaunchStep.CLIENTS_END, now_s)

    def _wait_for_clients(self, now_s: float) -> None:
        if all(client.settled for client in self._clients):
            self._go_to(_LaunchStep.WORLD_ENDS, now_s)
            return
        waited_s = now_s - self._step_s
        if waited_s > self._rules.saving_s:
            for client in self._clients:
                client.kill()
            return
        limit_s = _CLIENT_WAITS_S if self._world_ticks else _CLIENT_WAITS_IDLE_S
        if waited_s > limit_s and not self._sent_wait_no_more:
            # A client that saves its work is not disturbed by that.
            self._sent_wait_no_more = True
            for client in self._clients:
                client.wait_no_more()

    def _wait_for_world(self, now_s: float) -> None:
        if self._world is None or not self._world.running:
            self._go_to(_LaunchStep.OVER, now_s)
            return
        status = self._world.status
        waited_s = now_s - self._step_s
        is_empty = status is None or not status.members
        if not self._requested_world_end and (is_empty or waited_s > self._rules.leaving_s):
            self._requested_world_end = True
            self._world.request_end()
        elif waited_s > self._rules.ending_s:
            self._world.kill()

    def _go_to(self, step: _LaunchStep, now_s: float) -> None:
        self._step = step
        self._step_s = now_s

    def _save_clients(self) -> None:
        """After a failure of the launcher, give the clients time to save their work."""
        for client in self._clients:
            client.request_end()
            if not self._world_ticks:
                # Nothing restarts it.
                client.wait_no_more()
        deadline_s = time.monotonic() + self._rules.saving_s
        while time.monotonic() < deadline_s and not all(client.ended for client in self._clients):
            time.sleep(_POLL_S)

    def _show_state(self, now_s: float) -> None:
        is_over = self._step is _LaunchStep.OVER
        if self._show is None or (now_s - self._shown_s < _SHOW_S and not is_over):
            return
        self._shown_s = now_s
        world = self._world
        self._show(
            LaunchProcessStates(
                elapsed_s=now_s,
                world_standing="elsewhere" if world is None else world.standing,
                world_pid=0 if world is None else world.pid,
                world_restarts=0 if world is None else world.restarts,
                world=None if world is None else world.status,
                clients=self._client_states(),
                stopping=self._step is not _LaunchStep.RUN,
            )
        )

    def _client_states(self) -> tuple[ClientProcessState, ...]:
        return tuple(client.state for client in self._clients)
