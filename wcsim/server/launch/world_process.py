"""The world process over all its lives, as a launcher keeps it."""

from __future__ import annotations

import re
import selectors
import signal
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from wcsim.errors import ConfigError, WcsimError
from wcsim.server.journal.journal import JOURNAL, Ticked, iter_journal
from wcsim.server.launch.backoff import Restarts
from wcsim.server.launch.child import Child, how_it_ended
from wcsim.server.launch.event_log import RunLog
from wcsim.server.launch.states import LaunchRules, Standing, WorldExit
from wcsim.server.specs import WorldSpec, WorldStatus, of_line, to_line, write_order

WORLD_ARGV = (sys.executable, "-m", "wcsim.server.host.process")
WORLD = "world"  # its name in logs and events
_ERROR_NAME = re.compile(r"^[A-Za-z]+Error: ")
REPLAY_S_A_TICK = 0.2  # time for each tick that a world has to do again before it goes on
MOST_READ_BYTES = 8 << 20  # of a journal, between a death and a restart
A_START = 10  # ticks; a life that ends before has achieved nothing


class WorldRun:
    """Starts a world, hears what it says, and starts it again when it died or hangs."""

    def __init__(
        self,
        order: WorldSpec,
        order_file: Path,
        log_file: Path,
        rules: LaunchRules,
        selector: selectors.BaseSelector,
        log: RunLog,
        argv: Sequence[str] = WORLD_ARGV,
    ) -> None:
        self._order, self._order_file, self._log_file = order, order_file, log_file
        self._rules, self._selector, self._log, self._argv = rules, selector, log, tuple(argv)
        self._restarts = Restarts(rules.world)
        self._child: Child | None = None
        self.standing: Standing = "down"
        self.status: WorldStatus | None = None  # of this life
        self.fault = ""  # why there is no use in going on
        self.refused = False  # ... for which the user has to do something
        self._due_s: float | None = None
        self._heard_s = 0.0
        self._ending = False
        self._loaded = False  # in any life
        self._death_tick = -1
        self._died_s: float | None = None
        self._lives = 0

    @property
    def running(self) -> bool:
        """Whether there is a process."""
        return self._child is not None

    @property
    def ticks(self) -> bool:
        """Whether it is there and has begun to tick."""
        return self._child is not None and self.status is not None and self.status.ticks > 0

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
        self._child = Child(self._command, self._log_file, self._selector)
        self._log.add("restart" if self._lives else "start", who=WORLD, pid=self._child.pid)
        self._lives += 1
        self.standing, self.status, self._due_s, self._heard_s = "starting", None, None, now_s

    def look(self, now_s: float) -> None:
        """Take in what has happened to it."""
        if self._child is None:
            if self._due_s is not None and now_s >= self._due_s:
                self.start(now_s)
            return
        code = self._child.ended()
        for line in self._child.lines():
            self._hear(line, now_s)
        if code is not None:
            self._ended(self._child, code, now_s)
        elif not self._ending:
            self._watch(self._child, now_s)

    def ask_to_end(self) -> None:
        """Ask it to close its journal and end; it is not started again."""
        self._ending, self._due_s = True, None
        if self._child is not None:
            self._child.send(signal.SIGTERM)

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
        self._order_file.unlink(missing_ok=True)

    def _command(self, status_fd: int) -> tuple[str, ...]:
        write_order(self._order_file, to_line(replace(self._order, status_fd=status_fd)))
        return (*self._argv, str(self._order_file))

    def _hear(self, line: bytes, now_s: float) -> None:
        try:
            self.status = of_line(WorldStatus, line)
        except ConfigError:
            return  # a world that fails says so in a line of another kind, too
        self._heard_s = now_s
        if self.status.stage != "loading":
            self.standing, self._loaded = "running", True
        if self._died_s is not None and self.status.ticks > 0:
            after_s = round(now_s - self._died_s, 3)
            self._log.add("recovery", who=WORLD, after_s=after_s, epoch=self.status.epoch, tick=self.status.tick)
            self._died_s = None

    def _watch(self, child: Child, now_s: float) -> None:
        if not self._order_file.parent.is_dir():  # with the socket: nobody could come back to this world
            self._log.add("place lost", who=WORLD, place=str(self._order_file.parent))
            write_order(self._order_file, b"")
            child.send(signal.SIGKILL)
            return
        again_s = REPLAY_S_A_TICK * max(0, self._death_tick) if self._order.recovery == "replay" else 0.0
        lease_s = self._rules.world_lease_s if self.ticks else self._rules.loading_lease_s + again_s
        if now_s - self._heard_s > lease_s:
            self._log.add("hang", who=WORLD, silent_s=round(now_s - self._heard_s, 3))
            self._heard_s = now_s
            child.send(signal.SIGKILL)

    def _ended(self, child: Child, code: int, now_s: float) -> None:
        words = _ERROR_NAME.sub("", child.last_words())
        child.close()
        self._child = None
        if self._ending:
            self.standing = "stopped"
            self._log.add("end", who=WORLD, code=code)
            return
        reason = f"{how_it_ended(code)}{f': {words}' if words and code > 0 else ''}"
        tick = self._last_tick()
        self._log.add("death", who=WORLD, code=code, reason=reason, tick=tick)
        self._died_s = now_s if self._died_s is None else self._died_s
        if code == WorldExit.DISK_FULL:
            self._give_up(f"{words}; then go on with --resume", refused=False)
            return
        if code == WorldExit.USER_ERROR or (code == WorldExit.FAILED and not self._loaded):
            self._give_up(words or f"the world {reason}; see {self._log_file}", refused=True)
            return
        ticks = 0 if self.status is None else self.status.ticks
        wait_s = self._restarts.died(progressed=tick != self._death_tick and ticks >= A_START)
        self._death_tick = tick
        if wait_s is None:
            deaths = self._restarts.in_vain
            self._give_up(f"the world died {deaths} times at tick {tick} ({reason}); see {self._log_file}", False)
        else:
            self.standing, self._due_s = "down", now_s + wait_s

    def _give_up(self, fault: str, refused: bool) -> None:
        self.standing, self.fault, self.refused = "given up", fault, refused
        self._log.add("given up", who=WORLD, reason=fault)

    def _last_tick(self) -> int:
        """The last tick that is known to have been done, exactly where there is a journal."""
        tick = 0 if self.status is None else self.status.tick
        journal = Path(self._order.run) / JOURNAL
        if not self._order.run or not journal.is_file() or journal.stat().st_size > MOST_READ_BYTES:
            return tick
        epoch = 0 if self.status is None else self.status.epoch
        try:
            done = [r.tick for r in iter_journal(journal) if isinstance(r, Ticked) and r.epoch == epoch]
        except WcsimError:
            return tick
        return done[-1] if done else 0
