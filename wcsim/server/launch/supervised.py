"""A process over all its lives, as a launcher keeps it: started, heard, asked to end, started again when it died."""

from __future__ import annotations

import selectors
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Generic, TypeVar

from wcsim.errors import ConfigError
from wcsim.server.launch.backoff import RestartRules, Restarts
from wcsim.server.launch.child import Child, how_it_ended
from wcsim.server.launch.event_log import RunLog
from wcsim.server.launch.spawner import Spawner
from wcsim.server.launch.states import Standing
from wcsim.server.specs import ClientStatus, WorldStatus, of_line

Status = TypeVar("Status", ClientStatus, WorldStatus)


class Supervised(ABC, Generic[Status]):
    """One process, restarted while that is of use; what its status and its end mean is said by a world or a client."""

    def __init__(
        self,
        name: str,
        says: type[Status],
        log_file: Path,
        rules: RestartRules,
        selector: selectors.BaseSelector,
        spawner: Spawner,
        log: RunLog,
    ) -> None:
        """Nothing runs before `start`; `name` is for the `log` of events, what it `says` are its status lines."""
        self._name, self._log_file, self._log = name, log_file, log
        self._says: type[Status] = says
        self._selector, self._spawner = selector, spawner
        self._restarts = Restarts(rules)
        self._child: Child | None = None
        self.standing: Standing = "down"
        self.status: Status | None = None  # the last one
        self.fault = ""  # why there is no use in going on with the whole run
        self._lives = 0
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
        return self._child is None or self._child.ended() is not None

    @property
    def pid(self) -> int:
        """Of the process, 0 while there is none."""
        return 0 if self._child is None else self._child.pid

    @property
    def restarts(self) -> int:
        """How often it was started again."""
        return max(0, self._lives - 1)

    def start(self, now_s: float) -> None:
        """Begin a life."""
        self._child = Child(self._command, self._log_file, self._selector, self._spawner)
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
        child, code = self._child, self._child.ended()
        for line in child.lines():
            try:
                self.status = of_line(self._says, line)
            except ConfigError:
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
            self._log.add("recovery", who=self._name, after_s=round(now_s - self._died_s, 3), **told)
            self._died_s = None

    def _died(self, code: int, words: str, now_s: float, **told: int) -> str:
        """Take note of a death; returns it in words."""
        reason = f"{how_it_ended(code)}{f': {words}' if words and code > 0 else ''}"
        self._died_s = now_s if self._died_s is None else self._died_s
        self._log.add("death", who=self._name, code=code, reason=reason, **told)
        return reason

    def _start_later(self, now_s: float, progressed: bool) -> bool:
        """Have it started again after a while; False when that is of no use any more."""
        wait_s = self._restarts.died(progressed=progressed)
        if wait_s is None:
            return False
        self.standing, self._due_s = "down", now_s + wait_s
        return True
