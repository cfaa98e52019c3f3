"""The processes of a launch over all their lives: started, heard, found to hang, started again or given up.

A child as its launcher holds it has its output in a log file, status lines in a pipe, and its end from its handle.
"""

from __future__ import annotations

import os
import re
import selectors
import signal
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Generic, TypeVar

import msgspec

from wcsim.errors import DiskFullError
from wcsim.server.launch.event_log import RunLog
from wcsim.server.launch.states import (
    WAIT_NO_MORE,
    ClientExit,
    ClientPlan,
    ClientState,
    ClientStatus,
    LaunchRules,
    RestartRules,
    Standing,
    WorldExit,
    WorldPlan,
    WorldStatus,
)

_READ_BYTES = 1 << 16
_MOST_BYTES = 1 << 20  # of a line that does not end


class Child(subprocess.Popen[bytes]):
    """A running process, in a session of its own, so that Ctrl-C at the terminal reaches whoever started it alone."""

    def __init__(
        self,
        argv_of: Callable[[int], Sequence[str]],
        selector: selectors.BaseSelector,
        log: Path | None = None,
    ) -> None:
        """Start it.

        Args:
            argv_of: The command line, given the number of the pipe's end that status lines go to.
            selector: Wakes when there is something to read, or the process has ended.
            log: Where its output is appended; None: it goes where that of this process goes.

        Raises OSError when there is no such program.
        """
        self._log = log
        self._selector = selector
        self._pipe, theirs = os.pipe()
        os.set_blocking(self._pipe, False)
        try:
            if log is not None:
                log.parent.mkdir(parents=True, exist_ok=True)
            with nullcontext() if log is None else log.open("ab") as out:
                self._log_begin = 0 if out is None else out.tell()
                super().__init__(
                    argv_of(theirs),
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=out,
                    pass_fds=(theirs,),
                    start_new_session=True,
                )
            self._end_fd = os.pidfd_open(self.pid)
        except BaseException:
            os.close(self._pipe)
            raise
        finally:
            os.close(theirs)
        self._rest = b""
        self._reads = True
        selector.register(self._pipe, selectors.EVENT_READ)
        selector.register(self._end_fd, selectors.EVENT_READ)

    def lines(self) -> list[bytes]:
        """The whole status lines that have come since the last call; does not wait."""
        while self._reads:
            try:
                data = os.read(self._pipe, _READ_BYTES)
            except BlockingIOError:
                break
            if not data or len(self._rest) > _MOST_BYTES:
                self._stop_reading()
            self._rest += data
        *whole, self._rest = self._rest.split(b"\n")
        return whole

    @property
    def held(self) -> bool:
        """Whether a signal holds it, as SIGSTOP does."""
        try:
            return os.waitid(os.P_PID, self.pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT) is not None
        except ChildProcessError:  # it has ended meanwhile
            return False

    def close(self, grace_s: float = 0.0) -> None:
        """Kill it if it still runs, and let go of its pipe; where there is a grace, it is asked to end before."""
        if grace_s > 0.0:
            self.terminate()
            with suppress(subprocess.TimeoutExpired):
                self.wait(grace_s)
        self.kill()
        self._selector.unregister(self._end_fd)
        os.close(self._end_fd)
        self.wait()
        self._stop_reading()

    def last_words(self) -> str:
        """What it said of itself in the end: the last `wcsim: ...` line of its log, or the last line of all."""
        if self._log is None:
            return ""
        with self._log.open("rb") as file:
            file.seek(max(self._log_begin, self._log.stat().st_size - _READ_BYTES))
            lines = file.read().decode(errors="replace").splitlines()
        told = [line for line in lines if line.startswith("wcsim: ")] or [
            line for line in lines if line.strip()
        ]
        return told[-1].removeprefix("wcsim: ") if told else ""

    def _stop_reading(self) -> None:
        if self._reads:
            self._reads = False
            self._selector.unregister(self._pipe)
            os.close(self._pipe)


def _how_it_ended(code: int, words: str = "") -> str:
    """An exit code in words, with the last words of the process where it ended by itself.

    >>> _how_it_ended(-9, "no more"), _how_it_ended(3), _how_it_ended(3, "no more")
    ('was killed by SIGKILL', 'ended with code 3', 'ended with code 3: no more')
    """
    if code >= 0:
        return f"ended with code {code}{f': {words}' if words and code else ''}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"was killed by signal {-code}"


def _write_order(path: Path, line: bytes) -> None:
    """Write an order where its process looks for it; its folder is made again when somebody has removed it.

    Raises:
        DiskFullError: It could not be written.
    """
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.write_bytes(line)
    except OSError as error:
        raise DiskFullError(
            f"{path}: an order could not be written ({error.strerror}); make room"
        ) from None


Status = TypeVar("Status", ClientStatus, WorldStatus)


class _Supervised(ABC, Generic[Status]):
    """One process, restarted while that is of use; what its status and its end mean is said by a world or a client."""

    def __init__(
        self,
        name: str,
        says: type[Status],
        log_file: Path,
        rules: RestartRules,
        selector: selectors.BaseSelector,
        log: RunLog,
    ) -> None:
        """Nothing runs before `start`; `name` is for the `log` of events, what it `says` are its status lines."""
        self._name, self._log_file, self._log = name, log_file, log
        self._says: type[Status] = says
        self._selector = selector
        self._restart = rules
        self._deaths = self._in_vain = 0  # in all, and without progress in a row
        self._child: Child | None = None
        self.standing: Standing = "down"
        self.status: Status | None = None  # the last one
        self.fault = ""  # why there is no use in going on with the whole run
        self.refused = True  # the fault is one for which the user has to do something
        self._lives = self._replaced = 0  # all of them, and those that ended as planned
        self._due_s: float | None = None  # when it is started again
        self._ending = False
        self._died_s: float | None = None  # since when it has not been back

    @property
    def running(self) -> bool:
        """Whether there is a process, or one whose end has not been seen."""
        return self._child is not None

    @property
    def ended(self) -> bool:
        """Whether there is no process of it any more."""
        return self._child is None or self._child.poll() is not None

    @property
    def pid(self) -> int:
        """Of the process, 0 while there is none."""
        return 0 if self._child is None else self._child.pid

    @property
    def restarts(self) -> int:
        """How often it was started again after a death."""
        return max(0, self._lives - 1 - self._replaced)

    def start(self, now_s: float) -> None:
        """Begin a life."""
        self._child = Child(self._command, self._selector, self._log_file)
        self._log.add("restart" if self._lives else "start", who=self._name, pid=self._child.pid)
        self._lives += 1
        self.standing, self._due_s = "starting", None
        self._begun(now_s)

    def look(self, now_s: float) -> None:
        """Take in what has happened to it."""
        if self._child is None:
            if self._due_s is not None and now_s >= self._due_s:
                self.start(now_s)
            return
        child, code = self._child, self._child.poll()
        for line in child.lines():
            try:
                self.status = msgspec.json.decode(line, type=self._says)
            except (msgspec.MsgspecError, UnicodeError, RecursionError):
                continue  # a world that fails says so in a line of another kind, too
            self._heard(self.status, now_s)
        if code is not None:
            words = child.last_words()
            child.close()
            self._child = None
            self._ended(code, words, now_s)
        elif not self._ending:
            self._watch(child, now_s)

    def ask_to_end(self) -> None:
        """Ask it to close its work and leave; it is not started again."""
        self._ending, self._due_s = True, None
        if self._child is not None:
            self._child.terminate()

    def kill(self) -> None:
        """End it now."""
        self._ending, self._due_s = True, None
        if self._child is not None:
            self._child.kill()

    def close(self) -> None:
        """Let go of everything."""
        if self._child is not None:
            self._child.close()
            self._child = None

    @abstractmethod
    def _command(self, status_fd: int) -> Sequence[str]:
        """The command line of the life to come."""

    @abstractmethod
    def _begun(self, now_s: float) -> None:
        """A life has begun."""

    @abstractmethod
    def _heard(self, status: Status, now_s: float) -> None:
        """It has said something."""

    @abstractmethod
    def _watch(self, child: Child, now_s: float) -> None:
        """It lives: does it hang?"""

    @abstractmethod
    def _ended(self, code: int, words: str, now_s: float) -> None:
        """It has ended, with these last words."""

    def _hangs(self, child: Child, **told: float) -> None:
        self._log.add("hang", who=self._name, **told)
        child.kill()

    def _recovered(self, now_s: float, **told: int) -> None:
        """It works: say so when it had died."""
        if self._died_s is not None:
            self._log.add(
                "recovery", who=self._name, after_s=round(now_s - self._died_s, 3), **told
            )
            self._died_s = None

    def _died(self, code: int, words: str, now_s: float, **told: int) -> str:
        """Take note of a death; returns it in words."""
        reason = _how_it_ended(code, words)
        self._died_s = now_s if self._died_s is None else self._died_s
        self._log.add("death", who=self._name, code=code, reason=reason, **told)
        return reason

    def _settle(self, standing: Standing, event: str, **told: str | int) -> None:
        """It is not there and will not come back."""
        self.standing = standing
        self._log.add(event, who=self._name, **told)

    def _replace(self, words: str, now_s: float, **told: int) -> None:
        """Its life ended as planned: no death, and no reason to wait for the next one."""
        self._log.add("replaced", who=self._name, reason=words, **told)
        self._replaced += 1
        self.standing, self._due_s, self._died_s = "down", now_s, now_s

    def _start_later(self, now_s: float, progressed: bool) -> bool:
        """Have it started again after a while; False when that is of no use any more."""
        self._deaths += 1
        self._in_vain = 1 if progressed else self._in_vain + 1
        wait_s = self._restart.wait_s(self._in_vain)
        if wait_s is None:
            return False
        self.standing, self._due_s = "down", now_s + wait_s
        return True


_SAVED = (ClientExit.STOPPED, ClientExit.SERVER_GONE, ClientExit.EVICTED, ClientExit.GROWN)
MOST_LEFT_ALONE = 20  # deaths for want of a world that a client is forgiven


class SupervisedClient(_Supervised[ClientStatus]):
    """Also ends a client that hangs, and forgives one that died for want of a world."""

    def __init__(
        self, plan: ClientPlan, rules: LaunchRules, selector: selectors.BaseSelector, log: RunLog
    ) -> None:
        super().__init__(plan.name, ClientStatus, plan.log, rules.client, selector, log)
        self.plan, self._rules = plan, rules
        self.reason = self.unsaved = ""
        self._crash = ""  # how its last life ended, until the next one is heard
        self._world: WorldStatus | None = None  # as last seen
        self._best_step = 0  # of the lives before this one
        self._left_alone = 0  # deaths in a row that were the world's fault
        self._seat_epoch: int | None = (
            None  # of the world in which it had its seat last in this life
        )
        self._gathering = False  # its world waits for all to come
        self._unseated_s: float | None = (
            None  # since when the world has gone on without it, or has waited for all
        )

    @property
    def settled(self) -> bool:
        """Whether it is not there and will not come back."""
        return self.standing in ("done", "stopped", "given up")

    @property
    def state(self) -> ClientState:
        """As the launcher sees it."""
        return ClientState(
            name=self.plan.name,
            seat=self.plan.seat,
            standing=self.standing,
            pid=self.pid,
            restarts=self.restarts,
            status=self.status,
            reason=self.reason,
            unsaved=self.unsaved,
        )

    def see(self, world: WorldStatus | None) -> None:
        """What its world says of itself now; None while there is none."""
        self._world = world

    def ask_to_end(self) -> None:
        """Ask it to save its work and leave; it is not started again."""
        super().ask_to_end()
        if not (self.running or self.settled):
            self.standing, self.unsaved = "stopped", self._crash

    def wait_no_more(self) -> None:
        """Have one that was asked to end do so without its world, which does not go on."""
        if self._child is not None:
            self._child.send_signal(WAIT_NO_MORE)

    def _command(self, status_fd: int) -> tuple[str, ...]:
        if self.plan.order_file is not None:
            _write_order(self.plan.order_file, self.plan.order)
        resume = ("--resume",) if self._lives or self.plan.resume else ()
        return (*self.plan.argv, *resume, "--status-fd", str(status_fd))

    def _begun(self, now_s: float) -> None:
        self._seat_epoch, self._unseated_s = None, None

    def _heard(self, status: ClientStatus, now_s: float) -> None:
        self.standing, self._crash = "running", ""
        self._recovered(now_s, step=status.step)

    @property
    def _step(self) -> int:
        return 0 if self.status is None else self.status.step

    def _ended(self, code: int, words: str, now_s: float) -> None:
        if code == ClientExit.DONE:
            self._settle("done", "done", step=self._step)
        elif self._ending:
            if code not in _SAVED and self._step > 0:
                self.unsaved = _how_it_ended(code, words)
            self._settle("stopped", "stopped", code=code, step=self._step)
        elif code == ClientExit.GROWN:
            self._crash = ""
            self._replace(words, now_s, step=self._step)
        elif code == ClientExit.USER_ERROR:
            self.reason = words
            self.fault = (
                words or f"client {self.plan.name} {_how_it_ended(code)}; see {self.plan.log}"
            )
            self._settle("given up", "refused", reason=words)
        elif code == ClientExit.DISK_FULL:
            self.reason = f"has no disk space to save: {words}"
            self._settle("given up", "given up", reason=self.reason)
        else:
            self._crashed(code, words, now_s)

    def _crashed(self, code: int, words: str, now_s: float) -> None:
        no_world = self._world is None or self._world.stage == "loading"
        self._left_alone = (
            self._left_alone + 1 if code == ClientExit.SERVER_GONE and no_world else 0
        )
        excused = 0 < self._left_alone <= MOST_LEFT_ALONE  # it could not have done better
        progressed = self._step > self._best_step or excused
        self._best_step = max(self._best_step, self._step)
        self.reason = self._died(code, words, now_s, step=self._step)
        self._crash = self.reason if self._step > 0 else ""
        if not self._start_later(now_s, progressed):
            self._settle("given up", "given up", deaths=self._deaths)

    def _watch(self, child: Child, now_s: float) -> None:
        """End a client that the world gives no seat to, or took it from, and that does not notice by itself."""
        world, begun, seated = self._world, self._gathering, self._seat_epoch is not None
        self._gathering = (
            world is not None and world.stage == "empty" and world.epoch != self._seat_epoch
        )
        if (
            world is None
            or world.stage == "loading"
            or self._gathering != begun
            or (self._gathering and not seated)
        ):
            self._unseated_s = None
        elif self.plan.name in world.members:
            self._seat_epoch, self._unseated_s = world.epoch, None
        elif self._unseated_s is None:
            self._unseated_s = now_s
        elif now_s - self._unseated_s > self._may_take_s:
            self._hangs(child, without_seat_s=round(now_s - self._unseated_s, 3))
            self._unseated_s = now_s

    @property
    def _may_take_s(self) -> float:
        """How long it may be without its seat: where all are still waited for it may just wait as well."""
        lost = self._seat_epoch is not None and not self._gathering
        return self._rules.client_lease_s if lost else self._rules.joining_s


WORLD = "world"  # its name in logs and events
_ERROR_NAME = re.compile(r"^[A-Za-z]+Error: ")
A_START = 10  # ticks; a life that ends before has achieved nothing


class SupervisedWorld(_Supervised[WorldStatus]):
    """Also ends a world that hangs, and gives one up that dies again and again at the same tick."""

    def __init__(
        self, plan: WorldPlan, rules: LaunchRules, selector: selectors.BaseSelector, log: RunLog
    ) -> None:
        super().__init__(WORLD, WorldStatus, plan.log, rules.world, selector, log)
        self._plan, self._rules = plan, rules
        self._heard_s = 0.0
        self._held_s: float | None = None  # since when a signal holds it
        self._loaded = False  # in any life
        self._listening = ""  # where the first life was reached
        self._death_tick = -1

    @property
    def ticks(self) -> bool:
        """Whether it is there and has begun to tick."""
        return self.running and self.status is not None and self.status.ticks > 0

    def close(self) -> None:
        """Let go of everything."""
        super().close()
        self._plan.order_file.unlink(missing_ok=True)

    def _command(self, status_fd: int) -> tuple[str, ...]:
        _write_order(
            self._plan.order_file, self._plan.order(status_fd, not self._loaded, self._listening)
        )
        return self._plan.argv

    def _begun(self, now_s: float) -> None:
        self.status, self._heard_s, self._held_s = None, now_s, None

    def _heard(self, status: WorldStatus, now_s: float) -> None:
        self._heard_s = now_s
        if status.stage != "loading":
            self.standing, self._loaded = "running", True
            # Its clients know no other port than the one that was found first.
            self._listening = status.listening or self._listening
        if status.ticks > 0:
            self._recovered(now_s, epoch=status.epoch, tick=status.tick)

    def _watch(self, child: Child, now_s: float) -> None:
        file = self._plan.order_file
        if not file.parent.is_dir():  # with the socket: nobody could come back to this world
            self._log.add("place lost", who=WORLD, place=str(file.parent))
            _write_order(file, b"")
            child.kill()
            return
        lease_s = self._rules.world_lease_s if self.ticks else self._rules.loading_lease_s
        silent_s = now_s - self._heard_s
        # One that loads says nothing for long: how long it has been held is counted apart.
        self._held_s = (now_s if self._held_s is None else self._held_s) if child.held else None
        if silent_s > lease_s or (
            self._held_s is not None and now_s - self._held_s > self._rules.held_s
        ):
            self._hangs(child, silent_s=round(silent_s, 3))
            self._heard_s = now_s

    def _ended(self, code: int, words: str, now_s: float) -> None:
        words = _ERROR_NAME.sub("", words)
        if self._ending:
            self._settle("stopped", "end", code=code)
            return
        if code == WorldExit.EPOCH_OVER:
            self._death_tick = -1
            self._replace(words, now_s)
            return
        tick = self._plan.last_tick(0 if self.status is None else self.status.tick)
        reason = self._died(code, words, now_s, tick=tick)
        if code == WorldExit.DISK_FULL:
            words = words or "the world has no disk space; make room"  # nor has its log
            self._give_up(f"{words}; then continue (a training: wcsim resume RUN)", refused=False)
            return
        if code == WorldExit.USER_ERROR or (code == WorldExit.FAILED and not self._loaded):
            self._give_up(words or f"the world {reason}; see {self._log_file}", refused=True)
            return
        ticks = 0 if self.status is None else self.status.ticks
        progressed = tick != self._death_tick and ticks >= A_START
        self._death_tick = tick
        if not self._start_later(now_s, progressed):
            self._give_up(
                f"the world died {self._in_vain} times at tick {tick} ({reason}); see {self._log_file}",
                False,
            )

    def _give_up(self, fault: str, refused: bool) -> None:
        self.fault, self.refused = fault, refused
        self._settle("given up", "given up", reason=fault)
