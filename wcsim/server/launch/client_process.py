"""A client process over all its lives, as a launcher keeps it."""

from __future__ import annotations

import selectors
import signal

from wcsim.errors import ConfigError
from wcsim.server.launch.backoff import Restarts
from wcsim.server.launch.child import Child, how_it_ended
from wcsim.server.launch.event_log import RunLog
from wcsim.server.launch.states import ClientExit, ClientPlan, ClientState, LaunchRules, Standing
from wcsim.server.specs import ClientStatus, WorldStatus, of_line, write_order

MOST_LEFT_ALONE = 20  # deaths for want of a world that a client is forgiven


class ClientRun:
    """Starts a client, hears what it says, starts it again when it died, and gives it up when that is of no use."""

    def __init__(self, plan: ClientPlan, rules: LaunchRules, selector: selectors.BaseSelector, log: RunLog) -> None:
        self.plan, self._rules = plan, rules
        self._selector, self._log = selector, log
        self._restarts = Restarts(rules.client)
        self._child: Child | None = None
        self.standing: Standing = "down"
        self.status: ClientStatus | None = None
        self.reason = ""
        self.fault = ""  # a mistake of the user that ends the whole run
        self._lives = 0
        self._no_world = True
        self._due_s: float | None = None
        self._ending = False
        self._best_step = 0  # of the lives before this one
        self._left_alone = 0  # deaths in a row that were the world's fault
        self._died_s: float | None = None  # since when it has not been back
        self._seated = False  # in this life
        self._unseated_s: float | None = None  # since when the world has gone on without it

    @property
    def settled(self) -> bool:
        """Whether it is not there and will not come back."""
        return self.standing in ("done", "stopped", "given up")

    @property
    def ended(self) -> bool:
        """Whether there is no process of it any more."""
        return self._child is None or self._child.ended() is not None

    @property
    def state(self) -> ClientState:
        """As the launcher sees it."""
        return ClientState(
            name=self.plan.name,
            seat=self.plan.seat,
            standing=self.standing,
            pid=0 if self._child is None else self._child.pid,
            restarts=max(0, self._lives - 1),
            status=self.status,
            reason=self.reason,
        )

    def start(self) -> None:
        """Begin a life."""
        again = self._lives > 0
        if self.plan.order_file is not None:
            write_order(self.plan.order_file, self.plan.order)
        words = (*self.plan.argv, *(("--resume",) if again or self.plan.resume else ()))
        self._child = Child(lambda fd: (*words, "--status-fd", str(fd)), self.plan.log, self._selector)
        self._lives += 1
        self.standing, self._due_s, self._seated, self._unseated_s = "starting", None, False, None
        self._log.add("restart" if again else "start", who=self.plan.name, pid=self._child.pid)

    def look(self, now_s: float, world: WorldStatus | None) -> None:
        """Take in what has happened to it."""
        if self._child is None:
            if self._due_s is not None and now_s >= self._due_s:
                self.start()
            return
        code = self._child.ended()
        self._no_world = world is None or world.stage == "loading"
        for line in self._child.lines():
            self._hear(line, now_s)
        if code is not None:
            self._ended(self._child, code, now_s)
        elif not self._ending:
            self._watch_seat(self._child, now_s, world)

    def ask_to_end(self) -> None:
        """Ask it to save its work and leave; it is not started again."""
        self._ending, self._due_s = True, None
        if self._child is not None:
            self._child.send(signal.SIGTERM)
        elif not self.settled:
            self.standing = "stopped"

    def kill(self) -> None:
        """End it now."""
        self._ending, self._due_s = True, None
        if self._child is not None:
            self._child.send(signal.SIGKILL)

    def close(self) -> None:
        """Let go of everything."""
        if self._child is not None:
            self._child.close()
            self._child = None

    def _hear(self, line: bytes, now_s: float) -> None:
        try:
            self.status = of_line(ClientStatus, line)
        except ConfigError:
            return
        self.standing = "running"
        if self._died_s is not None:
            self._log.add("recovery", who=self.plan.name, after_s=round(now_s - self._died_s, 3), step=self._step)
            self._died_s = None

    @property
    def _step(self) -> int:
        return 0 if self.status is None else self.status.step

    def _ended(self, child: Child, code: int, now_s: float) -> None:
        words = child.last_words()
        child.close()
        self._child = None
        if code == ClientExit.DONE:
            self.standing = "done"
            self._log.add("done", who=self.plan.name, step=self._step)
        elif self._ending:
            self.standing = "stopped"
            self._log.add("stopped", who=self.plan.name, code=code, step=self._step)
        elif code == ClientExit.USER_ERROR:
            self.standing, self.reason = "given up", words
            self.fault = words or f"client {self.plan.name} {how_it_ended(code)}; see {self.plan.log}"
            self._log.add("refused", who=self.plan.name, reason=words)
        elif code == ClientExit.DISK_FULL:
            self.standing, self.reason = "given up", f"has no room to save: {words}"
            self._log.add("given up", who=self.plan.name, reason=self.reason)
        else:
            self._died(code, words, now_s)

    def _died(self, code: int, words: str, now_s: float) -> None:
        self.reason = f"{how_it_ended(code)}{f': {words}' if words and code > 0 else ''}"
        self._left_alone = self._left_alone + 1 if code == ClientExit.SERVER_GONE and self._no_world else 0
        excused = 0 < self._left_alone <= MOST_LEFT_ALONE  # it could not have done better
        wait_s = self._restarts.died(progressed=self._step > self._best_step or excused)
        self._best_step = max(self._best_step, self._step)
        self._died_s = now_s if self._died_s is None else self._died_s
        self._log.add("death", who=self.plan.name, code=code, reason=self.reason, step=self._step)
        if wait_s is None:
            self.standing = "given up"
            self._log.add("given up", who=self.plan.name, deaths=self._restarts.deaths)
        else:
            self.standing, self._due_s = "down", now_s + wait_s

    def _watch_seat(self, child: Child, now_s: float, world: WorldStatus | None) -> None:
        """End a client that the world gives no seat to, or took it from, and that does not notice by itself."""
        gathering = world is not None and world.stage == "empty" and not self._seated  # it waits for others to come
        if world is None or world.stage == "loading" or gathering:
            self._unseated_s = None
        elif self.plan.name in world.members:
            self._seated, self._unseated_s = True, None
        elif self._unseated_s is None:
            self._unseated_s = now_s
        elif now_s - self._unseated_s > (self._rules.client_lease_s if self._seated else self._rules.joining_s):
            self._log.add("hang", who=self.plan.name, without_seat_s=round(now_s - self._unseated_s, 3))
            self._unseated_s = now_s
            child.send(signal.SIGKILL)
