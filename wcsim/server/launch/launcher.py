"""A world and several clients as processes: started, watched, started again when they die, ended in order.

A tiny process that loads no simulator and no torch. One loop waits for pipes and ends of processes; everything has a
deadline. The children die with it, however it ends.
"""

from __future__ import annotations

import selectors
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from enum import Enum
from pathlib import Path

from wcsim.core.processes import StopSignals
from wcsim.server.launch.awake_clock import AwakeClock
from wcsim.server.launch.event_log import RunLog
from wcsim.server.launch.states import (
    ClientPlan,
    ClientState,
    LaunchOutcome,
    LaunchRules,
    LaunchState,
    WorldPlan,
)
from wcsim.server.launch.supervised import SupervisedClient, SupervisedWorld

LOOK_S = 0.1
SHOW_S = 0.25
WAITED_S = 240.0  # a client that still has not ended may wait for something that does not come ...
IDLE_S = 2.0  # ... as in a world that does not tick

Show = Callable[[LaunchState], None]


class _LaunchStep(Enum):
    """How far a launch has come."""

    RUN = "run"
    CLIENTS_END = "clients end"
    WORLD_ENDS = "world ends"
    OVER = "over"


class Launcher:
    """A launch; `run` does it once."""

    def __init__(
        self,
        world: WorldPlan | None,
        clients: Sequence[ClientPlan],
        folder: Path,
        rules: LaunchRules | None = None,
        show: Show | None = None,
        signals: StopSignals | None = None,
    ) -> None:
        """Prepare a launch.

        Args:
            world: The world; None where somebody else looks after it.
            clients: The clients; none for a world that waits for others.
            folder: For events.jsonl.
            rules: How long to wait for what.
            show: Called a few times a second.
            signals: Those that ask for the end, where the caller hears them already; a second one ends all at once.
        """
        self._rules = rules if rules is not None else LaunchRules()
        self._show = show
        self._selector = selectors.DefaultSelector()
        self._log = log = RunLog(folder)
        self._clients = [
            SupervisedClient(plan, self._rules, self._selector, log) for plan in clients
        ]
        self._world = (
            None if world is None else SupervisedWorld(world, self._rules, self._selector, log)
        )
        self._all: list[SupervisedWorld | SupervisedClient] = [*self._clients]
        if self._world is not None:
            self._all.insert(0, self._world)
        self._step = _LaunchStep.RUN
        self._since_s = 0.0  # of this step
        self._waits_end = self._asked_world = False
        self._ticked = world is None  # or somebody else looks after it
        self._given, self._heard = signals, StopSignals() if signals is None else signals
        self._asked, self._shown_s = 0, 0.0
        self._stopped = False
        self._code, self._message = 0, ""

    def run(self) -> LaunchOutcome:
        """Start everything, and return when nothing of it runs any more."""
        clock = AwakeClock(
            time.monotonic()
        )  # a launcher that was stopped has not waited for anybody
        try:
            with nullcontext() if self._given is not None else self._heard:
                for process in self._all:
                    process.start(clock.now_s)
                while self._step is not _LaunchStep.OVER:
                    self._selector.select(LOOK_S)
                    self._look(clock.look(time.monotonic()))
                    self._show_state(clock.now_s)
        except Exception:
            self._rescue()
            raise
        finally:
            for process in reversed(self._all):
                process.close()
            self._selector.close()
        return LaunchOutcome(
            code=self._code,
            message=self._message,
            stopped=self._stopped,
            clients=self._states(),
            by_signal=self._stopped and self._heard.count > 0,
        )

    def stop(self) -> None:
        """Ask for an orderly end, as SIGTERM does."""
        self._asked += 1

    @property
    def _signals(self) -> int:
        return self._asked + self._heard.count

    @property
    def _ticks(self) -> bool:
        """Whether there is a world of its own that ticks."""
        return self._world is not None and self._world.ticks

    def _look(self, now_s: float) -> None:
        if self._world is not None:
            self._world.look(now_s)
        self._ticked |= self._ticks
        for client in self._clients:
            client.see(
                self._world.status if self._world is not None and self._world.running else None
            )
            client.look(now_s)
        if self._signals > 1:
            for process in self._all:
                process.kill()
        if self._step is _LaunchStep.RUN:
            self._run_on(now_s)
        if self._step is _LaunchStep.CLIENTS_END:
            self._await_clients(now_s)
        if self._step is _LaunchStep.WORLD_ENDS:
            self._await_world(now_s)

    def _run_on(self, now_s: float) -> None:
        """Go on, unless there is a reason to end."""
        # The clients first: their words say more than the world's.
        if faulty := next((each for each in [*self._clients, *self._all] if each.fault), None):
            self._end_clients(now_s, 2 if faulty.refused else 1, faulty.fault)
        elif self._signals:
            self._stopped = True
            self._end_clients(now_s, 0, "stopped")
        elif not self._ticked and any(client.standing == "given up" for client in self._clients):
            self._end_clients(now_s, *self._verdict())  # the first tick would wait for it
        elif self._clients and all(client.settled for client in self._clients):
            self._code, self._message = self._verdict()
            self._go(_LaunchStep.WORLD_ENDS, now_s)

    def _verdict(self) -> tuple[int, str]:
        lost = [client for client in self._clients if client.standing == "given up"]
        told = [f"client {client.plan.name} was dropped: it {client.reason}" for client in lost]
        return (1, f"{'; '.join(told)}; see {lost[0].plan.log}") if lost else (0, "")

    def _end_clients(self, now_s: float, code: int, message: str) -> None:
        self._code, self._message = code, message
        self._log.add("stop", code=code, reason=message)
        for client in self._clients:
            client.ask_to_end()
        self._go(_LaunchStep.CLIENTS_END, now_s)

    def _await_clients(self, now_s: float) -> None:
        if all(client.settled for client in self._clients):
            self._go(_LaunchStep.WORLD_ENDS, now_s)
            return
        waited_s = now_s - self._since_s
        if waited_s > self._rules.saving_s:
            for client in self._clients:
                client.kill()
        elif not self._waits_end and waited_s > (WAITED_S if self._ticks else IDLE_S):
            self._waits_end = True  # who saves its work is not disturbed by that
            for client in self._clients:
                client.wait_no_more()

    def _await_world(self, now_s: float) -> None:
        if self._world is None or not self._world.running:
            self._go(_LaunchStep.OVER, now_s)
            return
        status, waited_s = self._world.status, now_s - self._since_s
        if not self._asked_world and (
            status is None or not status.members or waited_s > self._rules.leaving_s
        ):
            self._asked_world = True
            self._world.ask_to_end()
        elif waited_s > self._rules.ending_s:
            self._world.kill()

    def _go(self, step: _LaunchStep, now_s: float) -> None:
        self._step, self._since_s = step, now_s

    def _rescue(self) -> None:
        """Something failed in here: let the clients save their work before their processes are ended."""
        for client in self._clients:
            client.ask_to_end()
            if not self._ticks:  # nobody starts it again
                client.wait_no_more()
        deadline_s = time.monotonic() + self._rules.saving_s
        while time.monotonic() < deadline_s and not all(client.ended for client in self._clients):
            time.sleep(LOOK_S)

    # --- what it shows ---

    def _show_state(self, now_s: float) -> None:
        if self._show is None or (
            now_s - self._shown_s < SHOW_S and self._step is not _LaunchStep.OVER
        ):
            return
        self._shown_s = now_s
        world = self._world
        self._show(
            LaunchState(
                elapsed_s=now_s,
                world_standing="elsewhere" if world is None else world.standing,
                world_pid=0 if world is None else world.pid,
                world_restarts=0 if world is None else world.restarts,
                world=None if world is None else world.status,
                clients=self._states(),
                stopping=self._step is not _LaunchStep.RUN,
            )
        )

    def _states(self) -> tuple[ClientState, ...]:
        return tuple(client.state for client in self._clients)
