"""A client process over all its lives, as a launcher keeps it."""

from __future__ import annotations

import selectors

from wcsim.server.launch.child import Child, how_it_ended
from wcsim.server.launch.event_log import RunLog
from wcsim.server.launch.spawner import Spawner
from wcsim.server.launch.states import ClientExit, ClientPlan, ClientState, LaunchRules
from wcsim.server.launch.supervised import Supervised
from wcsim.server.specs import ClientStatus, WorldStatus, write_order

_SAVED = (ClientExit.STOPPED, ClientExit.SERVER_GONE, ClientExit.EVICTED, ClientExit.GROWN)
MOST_LEFT_ALONE = 20  # deaths for want of a world that a client is forgiven


class SupervisedClient(Supervised[ClientStatus]):
    """Also ends a client that hangs, and forgives one that died for want of a world."""

    def __init__(
        self, plan: ClientPlan, rules: LaunchRules, selector: selectors.BaseSelector, spawner: Spawner, log: RunLog
    ) -> None:
        super().__init__(plan.name, ClientStatus, plan.log, rules.client, selector, spawner, log)
        self.plan, self._rules = plan, rules
        self.reason = self.unsaved = ""
        self._crash = ""  # how its last life ended, until the next one is heard
        self._world: WorldStatus | None = None  # as last seen
        self._best_step = 0  # of the lives before this one
        self._left_alone = 0  # deaths in a row that were the world's fault
        self._seat_epoch: int | None = None  # of the world in which it had its seat last in this life
        self._gathering = False  # its world waits for all to come
        self._unseated_s: float | None = None  # since when the world has gone on without it, or has waited for all
        self._replaced = 0  # lives that ended as planned, because their process had grown

    @property
    def restarts(self) -> int:
        """How often it was started again after a death."""
        return super().restarts - self._replaced

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
            self._child.wait_no_more()

    def _command(self, status_fd: int) -> tuple[str, ...]:
        if self.plan.order_file is not None:
            write_order(self.plan.order_file, self.plan.order)
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
            self.standing = "done"
            self._log.add("done", who=self.plan.name, step=self._step)
        elif self._ending:
            self.standing = "stopped"
            if code not in _SAVED and self._step > 0:
                self.unsaved = f"{how_it_ended(code)}{f': {words}' if words and code > 0 else ''}"
            self._log.add("stopped", who=self.plan.name, code=code, step=self._step)
        elif code == ClientExit.GROWN:
            self._replaced, self._crash = self._replaced + 1, ""
            self._log.add("replaced", who=self.plan.name, reason=words, step=self._step)
            self.standing, self._due_s, self._died_s = "down", now_s, now_s
        elif code == ClientExit.USER_ERROR:
            self.standing, self.reason = "given up", words
            self.fault = words or f"client {self.plan.name} {how_it_ended(code)}; see {self.plan.log}"
            self._log.add("refused", who=self.plan.name, reason=words)
        elif code == ClientExit.DISK_FULL:
            self.standing, self.reason = "given up", f"has no disk space to save: {words}"
            self._log.add("given up", who=self.plan.name, reason=self.reason)
        else:
            self._crashed(code, words, now_s)

    def _crashed(self, code: int, words: str, now_s: float) -> None:
        no_world = self._world is None or self._world.stage == "loading"
        self._left_alone = self._left_alone + 1 if code == ClientExit.SERVER_GONE and no_world else 0
        excused = 0 < self._left_alone <= MOST_LEFT_ALONE  # it could not have done better
        progressed = self._step > self._best_step or excused
        self._best_step = max(self._best_step, self._step)
        self.reason = self._died(code, words, now_s, step=self._step)
        self._crash = self.reason if self._step > 0 else ""
        if not self._start_later(now_s, progressed):
            self.standing = "given up"
            self._log.add("given up", who=self.plan.name, deaths=self._restarts.deaths)

    def _watch(self, child: Child, now_s: float) -> None:
        """End a client that the world gives no seat to, or took it from, and that does not notice by itself."""
        world, begun, seated = self._world, self._gathering, self._seat_epoch is not None
        self._gathering = world is not None and world.stage == "empty" and world.epoch != self._seat_epoch
        if world is None or world.stage == "loading" or self._gathering != begun or (self._gathering and not seated):
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
