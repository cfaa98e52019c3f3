"""The world process over all its lives, as a launcher keeps it."""

from __future__ import annotations

import re
import selectors
import sys
from dataclasses import replace
from pathlib import Path

from wcsim.errors import WcsimError
from wcsim.server.journal.journal import JOURNAL, EpochBegun, Ticked, iter_part
from wcsim.server.launch.child import Child
from wcsim.server.launch.event_log import RunLog
from wcsim.server.launch.spawner import Spawner
from wcsim.server.launch.states import LaunchRules, WorldExit
from wcsim.server.launch.supervised import Supervised
from wcsim.server.specs import WorldSpec, WorldStatus, to_line, write_order

WORLD_ARGV = (sys.executable, "-m", "wcsim.server.host.process")
WORLD = "world"  # its name in logs and events
_ERROR_NAME = re.compile(r"^[A-Za-z]+Error: ")
MOST_READ_BYTES = 8 << 20  # of a journal, between a death and a restart
A_START = 10  # ticks; a life that ends before has achieved nothing


class SupervisedWorld(Supervised[WorldStatus]):
    """Also ends a world that hangs, and gives one up that dies again and again at the same tick."""

    def __init__(
        self,
        order: WorldSpec,
        order_file: Path,
        log_file: Path,
        rules: LaunchRules,
        selector: selectors.BaseSelector,
        spawner: Spawner,
        log: RunLog,
    ) -> None:
        super().__init__(WORLD, WorldStatus, log_file, rules.world, selector, spawner, log)
        self._order, self._order_file, self._rules = order, order_file, rules
        self.refused = False  # ended by a fault for which the user has to do something
        self._heard_s = 0.0
        self._loaded = False  # in any life
        self._death_tick = -1
        self._replaced = 0  # lives that ended as planned, at the end of an epoch

    @property
    def restarts(self) -> int:
        """How often it was started again after a death."""
        return super().restarts - self._replaced

    @property
    def ticks(self) -> bool:
        """Whether it is there and has begun to tick."""
        return self.running and self.status is not None and self.status.ticks > 0

    def close(self) -> None:
        """Let go of everything."""
        super().close()
        self._order_file.unlink(missing_ok=True)

    def _command(self, status_fd: int) -> tuple[str, ...]:
        write_order(self._order_file, to_line(replace(self._order, begins=not self._loaded, status_fd=status_fd)))
        return (*WORLD_ARGV, str(self._order_file))

    def _begun(self, now_s: float) -> None:
        self.status, self._heard_s = None, now_s

    def _heard(self, status: WorldStatus, now_s: float) -> None:
        self._heard_s = now_s
        if status.stage != "loading":
            self.standing, self._loaded = "running", True
            if status.listening:  # its clients know no other port than the one that was found first
                self._order = replace(self._order, listen=status.listening)
        if status.ticks > 0:
            self._recovered(now_s, epoch=status.epoch, tick=status.tick)

    def _watch(self, child: Child, now_s: float) -> None:
        if not self._order_file.parent.is_dir():  # with the socket: nobody could come back to this world
            self._log.add("place lost", who=WORLD, place=str(self._order_file.parent))
            write_order(self._order_file, b"")
            child.kill()
            return
        lease_s = self._rules.world_lease_s if self.ticks else self._rules.loading_lease_s
        if now_s - self._heard_s > lease_s:
            self._hangs(child, silent_s=round(now_s - self._heard_s, 3))
            self._heard_s = now_s

    def _ended(self, code: int, words: str, now_s: float) -> None:
        words = _ERROR_NAME.sub("", words)
        if self._ending:
            self.standing = "stopped"
            self._log.add("end", who=WORLD, code=code)
            return
        if code == WorldExit.EPOCH_OVER:
            self._replace(words, now_s)
            return
        tick = self._last_tick()
        reason = self._died(code, words, now_s, tick=tick)
        if code == WorldExit.DISK_FULL:
            self._give_up(f"{words}; then continue (a training: wcsim resume RUN)", refused=False)
            return
        if code == WorldExit.USER_ERROR or (code == WorldExit.FAILED and not self._loaded):
            self._give_up(words or f"the world {reason}; see {self._log_file}", refused=True)
            return
        ticks = 0 if self.status is None else self.status.ticks
        progressed = tick != self._death_tick and ticks >= A_START
        self._death_tick = tick
        if not self._start_later(now_s, progressed):
            deaths = self._restarts.in_vain
            self._give_up(f"the world died {deaths} times at tick {tick} ({reason}); see {self._log_file}", False)

    def _replace(self, words: str, now_s: float) -> None:
        """Its epoch is over: no death, and no reason to wait."""
        self._log.add("replaced", who=WORLD, reason=words)
        self._replaced += 1
        self._death_tick, self._died_s = -1, now_s
        self.standing, self._due_s = "down", now_s

    def _give_up(self, fault: str, refused: bool) -> None:
        self.standing, self.fault, self.refused = "given up", fault, refused
        self._log.add("given up", who=WORLD, reason=fault)

    def _last_tick(self) -> int:
        """The last tick of its epoch that is known to have been done, exactly where there is a journal."""
        tick = 0 if self.status is None else self.status.tick
        journal = Path(self._order.run) / JOURNAL
        if not self._order.run or not journal.is_file() or journal.stat().st_size > MOST_READ_BYTES:
            return tick
        done = 0
        try:
            for record in iter_part(journal):  # a world that died while it loaded has not said which epoch it was in
                if isinstance(record, Ticked | EpochBegun):
                    done = record.tick if isinstance(record, Ticked) else 0
        except WcsimError:
            return tick
        return done
