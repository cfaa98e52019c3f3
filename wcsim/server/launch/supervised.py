"""The processes of a launch over all their lives: started, polled, restarted or given up.

What a status or an exit code means is decided here, for a client and for a world. A process that
hangs is killed, and then restarted as one that died.
"""

import re
import selectors
import signal
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Generic, TypeVar

import msgspec

from wcsim.core.processes import CommandProcess
from wcsim.errors import DiskFullError
from wcsim.server.launch import states
from wcsim.server.launch.event_log import EventLogWriter

WORLD: Final = "world"
"""The world's name in events."""
MOST_EXCUSED_DEATHS: Final = 20
"""Deaths of a client in a row, for want of a world, that count as progress."""
_SAVED: Final = (
    states.ClientExitCode.STOPPED,
    states.ClientExitCode.SERVER_GONE,
    states.ClientExitCode.EVICTED,
    states.ClientExitCode.GROWN,
)
# A world that ends before has made no progress.
_PROGRESS_TICKS: Final = 10
_ERROR_NAME: Final = re.compile(r"^[A-Za-z]+Error: ")

Status = TypeVar("Status", states.ClientStatusReport, states.WorldStatusReport)


class _Supervised(ABC, Generic[Status]):
    """One process, restarted while that is of use."""

    def __init__(
        self,
        name: str,
        status_type: type[Status],
        log_file: Path,
        restart: states.ProcessRestartRules,
        selector: selectors.BaseSelector,
        log: EventLogWriter,
    ) -> None:
        """Nothing runs before `start`; `name` is for the `log` of events."""
        self._name = name
        self._status_type: type[Status] = status_type
        self._log_file = log_file
        self._restart = restart
        self._selector = selector
        self._log = log
        # Its life of now.
        self._child: CommandProcess | None = None
        self._ending = False
        self.standing: states.Standing = "down"
        self.status: Status | None = None  # the last one
        # All its lives.
        self._lives = 0
        self._replaced = 0  # lives that ended as planned
        self._deaths = 0
        self._deaths_without_progress = 0  # in a row
        self._died_s: float | None = None  # since when it has not worked
        self._due_s: float | None = None  # when it is restarted
        # Why the whole run has to end, and whether the user has to do something about it.
        self.fault = ""
        self.refused = True

    @property
    def running(self) -> bool:
        """Whether there is a process."""
        return self._child is not None

    @property
    def ended(self) -> bool:
        """Whether there is no process, or one that has ended."""
        return self._child is None or self._child.poll() is not None

    @property
    def pid(self) -> int:
        """Of the process, 0 while there is none."""
        return 0 if self._child is None else self._child.pid

    @property
    def restarts(self) -> int:
        """How often it was restarted after a death."""
        return max(0, self._lives - 1 - self._replaced)

    def start(self, now_s: float) -> None:
        """Start a life."""
        self._child = CommandProcess(self._argv, self._selector, self._log_file)
        self._log.add("restart" if self._lives else "start", who=self._name, pid=self._child.pid)
        self._lives += 1
        self.standing = "starting"
        self._due_s = None

    def poll(self, now_s: float) -> None:
        """Read its status and exit code; restart it when that is due."""
        if self._child is None:
            if self._due_s is not None and now_s >= self._due_s:
                self.start(now_s)
            return
        child = self._child
        code = child.poll()
        for line in child.read_lines():
            try:
                self.status = msgspec.json.decode(line, type=self._status_type)
            except (msgspec.MsgspecError, UnicodeError, RecursionError):
                # A world that fails writes a line of another kind, too.
                continue
            self._on_status(self.status, now_s)
        if code is not None:
            message = child.last_message()
            child.close()
            self._child = None
            self._on_exit(code, message, now_s)
        elif not self._ending:
            self._kill_if_hung(child, now_s)

    def request_end(self) -> None:
        """Have it close its work and leave; it is not restarted."""
        self._ending = True
        self._due_s = None
        if self._child is not None:
            self._child.terminate()

    def kill(self) -> None:
        """End it now."""
        self._ending = True
        self._due_s = None
        if self._child is not None:
            self._child.kill()

    def close(self) -> None:
        """Kill it, and close its pipe."""
        if self._child is not None:
            self._child.close()
            self._child = None

    @abstractmethod
    def _argv(self, status_fd: int) -> Sequence[str]:
        """The command line of the next life."""

    @abstractmethod
    def _on_status(self, status: Status, now_s: float) -> None:
        """It has sent its status."""

    @abstractmethod
    def _kill_if_hung(self, child: CommandProcess, now_s: float) -> None:
        """It runs: does it hang?"""

    @abstractmethod
    def _on_exit(self, code: int, message: str, now_s: float) -> None:
        """It has ended, with this last message."""

    def _kill_hung(self, child: CommandProcess, **values: float) -> None:
        self._log.add("hang", who=self._name, **values)
        child.kill()

    def _log_recovery(self, now_s: float, **values: int) -> None:
        """It works: log it when it had died."""
        if self._died_s is not None:
            after_s = round(now_s - self._died_s, 3)
            self._log.add("recovery", who=self._name, after_s=after_s, **values)
            self._died_s = None

    def _log_death(self, code: int, message: str, now_s: float, **values: int) -> str:
        """Note and log a death; returns it in words."""
        reason = _exit_text(code, message)
        self._died_s = now_s if self._died_s is None else self._died_s
        self._log.add("death", who=self._name, code=code, reason=reason, **values)
        return reason

    def _settle(self, standing: states.Standing, event: str, **values: str | int) -> None:
        """It is not restarted any more."""
        self.standing = standing
        self._log.add(event, who=self._name, **values)

    def _replace(self, message: str, now_s: float, **values: int) -> None:
        """Its life ended as planned: no death, and the next one starts at once."""
        self._log.add("replaced", who=self._name, reason=message, **values)
        self._replaced += 1
        self.standing = "down"
        self._due_s = now_s
        self._died_s = now_s

    def _schedule_restart(self, now_s: float, progressed: bool) -> bool:
        """Have it restarted after a while; False when that is of no use any more."""
        self._deaths += 1
        self._deaths_without_progress = 1 if progressed else self._deaths_without_progress + 1
        wait_s = self._restart.wait_s(self._deaths_without_progress)
        if wait_s is None:
            return False
        self.standing = "down"
        self._due_s = now_s + wait_s
        return True


class WatchedClientProcess(_Supervised[states.ClientStatusReport]):
    """Also kills a client that hangs, and excuses one that died for want of a world."""

    def __init__(
        self,
        plan: states.ClientLaunchPlan,
        rules: states.LauncherTimeouts,
        selector: selectors.BaseSelector,
        log: EventLogWriter,
    ) -> None:
        super().__init__(
            plan.name, states.ClientStatusReport, plan.log, rules.client, selector, log
        )
        self.plan = plan
        self._rules = rules
        self._world: states.WorldStatusReport | None = None
        # How it ended.
        self.reason = ""
        self.unsaved = ""
        self._crash = ""  # how its last life ended, until the next one sends its status
        self._best_step = 0  # of the lives before this one
        self._excused_deaths = 0  # in a row
        # Its seat. A world gathers while it waits for all its clients.
        self._seat_epoch: int | None = None  # of the world in which this life last had its seat
        self._gathering = False
        self._unseated_s: float | None = None  # since when the world has ticked or gathered

    @property
    def settled(self) -> bool:
        """Whether it has ended and is not restarted."""
        return self.standing in ("done", "stopped", "given up")

    @property
    def state(self) -> states.ClientProcessState:
        """As the launcher shows it."""
        return states.ClientProcessState(
            name=self.plan.name,
            seat=self.plan.seat,
            standing=self.standing,
            pid=self.pid,
            restarts=self.restarts,
            status=self.status,
            reason=self.reason,
            unsaved=self.unsaved,
        )

    def start(self, now_s: float) -> None:
        """Start a life, in which it has no seat yet."""
        super().start(now_s)
        self._seat_epoch = None
        self._unseated_s = None

    def set_world(self, world: states.WorldStatusReport | None) -> None:
        """Set the status of its world; None while there is none."""
        self._world = world

    def request_end(self) -> None:
        """Have it save its work and leave; it is not restarted."""
        super().request_end()
        if not (self.running or self.settled):
            self.standing = "stopped"
            self.unsaved = self._crash

    def wait_no_more(self) -> None:
        """Have one whose end was requested end without its world, which does not go on."""
        if self._child is not None:
            self._child.send_signal(states.WAIT_NO_MORE)

    def _argv(self, status_fd: int) -> tuple[str, ...]:
        if self.plan.order_file is not None:
            _write_order(self.plan.order_file, self.plan.order)
        resume = ("--resume",) if self._lives or self.plan.resume else ()
        return (*self.plan.argv, *resume, "--status-fd", str(status_fd))

    def _on_status(self, status: states.ClientStatusReport, now_s: float) -> None:
        self.standing = "running"
        self._crash = ""
        self._log_recovery(now_s, step=status.step)

    def _on_exit(self, code: int, message: str, now_s: float) -> None:
        step = 0 if self.status is None else self.status.step
        # 1. It is not restarted: its work is done, its end was requested, or no try would help.
        if code == states.ClientExitCode.DONE:
            self._settle("done", "done", step=step)
            return
        if self._ending:
            if code not in _SAVED and step > 0:
                self.unsaved = _exit_text(code, message)
            self._settle("stopped", "stopped", code=code, step=step)
            return
        if code == states.ClientExitCode.USER_ERROR:
            self.reason = message
            self.fault = (
                message or f"client {self.plan.name} {_exit_text(code)}; see {self.plan.log}"
            )
            self._settle("given up", "refused", reason=message)
            return
        if code == states.ClientExitCode.DISK_FULL:
            self.reason = f"has no disk space to save: {message}"
            self._settle("given up", "given up", reason=self.reason)
            return
        # 2. It ended as planned, and a new process goes on.
        if code == states.ClientExitCode.GROWN:
            self._crash = ""
            self._replace(message, now_s, step=step)
            return
        # 3. It died.
        self._restart_after_crash(code, message, now_s, step)

    def _restart_after_crash(self, code: int, message: str, now_s: float, step: int) -> None:
        # Without a world it could not make progress, which is excused for a while.
        no_world = self._world is None or self._world.stage == "loading"
        if code == states.ClientExitCode.SERVER_GONE and no_world:
            self._excused_deaths += 1
        else:
            self._excused_deaths = 0
        excused = 0 < self._excused_deaths <= MOST_EXCUSED_DEATHS
        progressed = step > self._best_step or excused
        self._best_step = max(self._best_step, step)
        self.reason = self._log_death(code, message, now_s, step=step)
        self._crash = self.reason if step > 0 else ""
        if not self._schedule_restart(now_s, progressed):
            self._settle("given up", "given up", deaths=self._deaths)

    def _kill_if_hung(self, child: CommandProcess, now_s: float) -> None:
        """Kill a client that lost its seat, or never gets one, and does not detect that itself."""
        world = self._world
        was_gathering = self._gathering
        self._gathering = (
            world is not None and world.stage == "empty" and world.epoch != self._seat_epoch
        )
        # A client that never had a seat may wait as long as its world gathers.
        had_seat = self._seat_epoch is not None
        if (
            world is None
            or world.stage == "loading"
            or self._gathering != was_gathering
            or (self._gathering and not had_seat)
        ):
            self._unseated_s = None
        elif self.plan.name in world.members:
            self._seat_epoch = world.epoch
            self._unseated_s = None
        elif self._unseated_s is None:
            self._unseated_s = now_s
        else:
            # While the world gathers it may just wait as well, so it has longer than one that lost
            # its seat.
            lost_seat = had_seat and not self._gathering
            limit_s = self._rules.client_lease_s if lost_seat else self._rules.joining_s
            unseated_s = now_s - self._unseated_s
            if unseated_s > limit_s:
                self._kill_hung(child, without_seat_s=round(unseated_s, 3))
                self._unseated_s = now_s


class WatchedWorldProcess(_Supervised[states.WorldStatusReport]):
    """Also kills a world that hangs, and gives up one that dies repeatedly at the same tick."""

    def __init__(
        self,
        plan: states.WorldLaunchPlan,
        rules: states.LauncherTimeouts,
        selector: selectors.BaseSelector,
        log: EventLogWriter,
    ) -> None:
        super().__init__(WORLD, states.WorldStatusReport, plan.log, rules.world, selector, log)
        self._plan = plan
        self._rules = rules
        self._status_s = 0.0  # when it last sent its status
        self._stopped_s: float | None = None  # since when a signal has stopped it
        self._loaded = False  # in any life
        self._listening = ""  # the address of the first life
        self._death_tick = -1

    @property
    def ticks(self) -> bool:
        """Whether it runs and has done a tick."""
        return self.running and self.status is not None and self.status.ticks > 0

    def start(self, now_s: float) -> None:
        """Start a life, which has sent no status yet."""
        super().start(now_s)
        self.status = None
        self._status_s = now_s
        self._stopped_s = None

    def close(self) -> None:
        """Kill it, close its pipe, and remove its order."""
        super().close()
        self._plan.order_file.unlink(missing_ok=True)

    def _argv(self, status_fd: int) -> tuple[str, ...]:
        order = self._plan.order(status_fd, not self._loaded, self._listening)
        _write_order(self._plan.order_file, order)
        return self._plan.argv

    def _on_status(self, status: states.WorldStatusReport, now_s: float) -> None:
        self._status_s = now_s
        if status.stage != "loading":
            self.standing = "running"
            self._loaded = True
            # Its clients know no other port than the one that was found first.
            self._listening = status.listening or self._listening
        if status.ticks > 0:
            self._log_recovery(now_s, epoch=status.epoch, tick=status.tick)

    def _kill_if_hung(self, child: CommandProcess, now_s: float) -> None:
        file = self._plan.order_file
        if not file.parent.is_dir():
            # Its socket was in that folder, so no client could come back to this world.
            self._log.add("place lost", who=WORLD, place=str(file.parent))
            _write_order(file, b"")
            child.kill()
            return
        # One that loads sends no status for long. So the time that it was stopped counts apart.
        if not child.stopped:
            self._stopped_s = None
        elif self._stopped_s is None:
            self._stopped_s = now_s
        lease_s = self._rules.world_lease_s if self.ticks else self._rules.loading_lease_s
        silent_s = now_s - self._status_s
        stopped_s = 0.0 if self._stopped_s is None else now_s - self._stopped_s
        if silent_s > lease_s or stopped_s > self._rules.held_s:
            self._kill_hung(child, silent_s=round(silent_s, 3))
            self._status_s = now_s

    def _on_exit(self, code: int, message: str, now_s: float) -> None:
        message = _ERROR_NAME.sub("", message)
        # 1. Its end was requested, or planned.
        if self._ending:
            self._settle("stopped", "end", code=code)
            return
        if code == states.WorldExitCode.EPOCH_OVER:
            self._death_tick = -1
            self._replace(message, now_s)
            return
        # 2. It died in a way that would repeat.
        status = self.status
        tick = self._plan.last_tick(0 if status is None else status.tick)
        reason = self._log_death(code, message, now_s, tick=tick)
        if code == states.WorldExitCode.DISK_FULL:
            # Where its log has no room either, there is no message.
            message = message or "the world has no disk space; make room"
            self._give_up(f"{message}; then continue (a training: wcsim resume RUN)", refused=False)
            return
        if code == states.WorldExitCode.USER_ERROR or (
            code == states.WorldExitCode.FAILED and not self._loaded
        ):
            self._give_up(message or f"the world {reason}; see {self._log_file}", refused=True)
            return
        # 3. It died in another way.
        ticks = 0 if status is None else status.ticks
        progressed = tick != self._death_tick and ticks >= _PROGRESS_TICKS
        self._death_tick = tick
        if not self._schedule_restart(now_s, progressed):
            self._give_up(
                f"the world died {self._deaths_without_progress} times at tick {tick} ({reason}); "
                f"see {self._log_file}",
                refused=False,
            )

    def _give_up(self, fault: str, refused: bool) -> None:
        self.fault = fault
        self.refused = refused
        self._settle("given up", "given up", reason=fault)


def _exit_text(code: int, message: str = "") -> str:
    """An exit code in words, with the last message of a process that ended by itself.

    >>> _exit_text(-9, "no more"), _exit_text(3), _exit_text(3, "no more")
    ('was killed by SIGKILL', 'ended with code 3', 'ended with code 3: no more')
    """
    if code >= 0:
        return f"ended with code {code}{f': {message}' if message and code else ''}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"was killed by signal {-code}"


def _write_order(path: Path, order: bytes) -> None:
    """Write an order where its process reads it, and make its folder if it was removed.

    Raises:
        DiskFullError: It could not be written.
    """
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.write_bytes(order)
    except OSError as error:
        raise DiskFullError(
            f"{path}: an order could not be written ({error.strerror}); make room"
        ) from None
