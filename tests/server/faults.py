"""The real cores in a simulated network on a simulated clock: one seed is one run, with its faults.

`python -m tests.server.faults SEED` prints the trace of one.
"""

import heapq
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from tests.server.model.shadow import stick_of
from tests.server.sim_world import SimWorld, Wrong
from wcsim.core import seeding
from wcsim.errors import WcsimError, WorldRestartedError
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import ClientCore, ClientPhase, JoinSettings, Outcome, Patience, ReceivedFrame
from wcsim.server.protocol.events import (
    ClientLostEvent,
    Effect,
    Event,
    MessageReceivedEvent,
    Peer,
    SendMessageEffect,
    SendSensorFrameEffect,
    ServerRules,
    StepWorldEffect,
    TimePassedEvent,
    WorldSteppedEvent,
)
from wcsim.server.protocol.server_core import ServerCore
from wcsim.types import Joystick, SeatSpec

END_S = 30.0  # of the faults
QUIET_S = 400.0  # the longest time that is left to go on in afterwards
GOAL_TICKS = 2  # that every live client must see after the last fault
PATIENCE = Patience(resend_s=2.0, reconnect_s=90.0, tick_s=3600.0)
FAULTS = (
    "crash", "hang", "leave", "cut", "duplicate", "slow", "jump", "world", "replay", "rebuild",
    "lose prefix", "suspect", "rival",
)  # fmt: skip


class Draws:
    """Random numbers of one seed, drawn in blocks."""

    def __init__(self, seed: int) -> None:
        self._generator: np.random.Generator = seeding.make_rng(seed, "faults")
        self._block: Iterator[float] = iter(())

    def unit(self) -> float:
        """A number in [0, 1)."""
        number = next(self._block, None)
        if number is None:
            self._block = iter(self._generator.random(256).tolist())
            number = next(self._block)
        return number

    def below(self, limit: int) -> int:
        """A whole number in [0, limit)."""
        return int(self.unit() * limit)


@dataclass(eq=False, slots=True)
class Process:
    """A client's process: its core, its driver and its connection."""

    number: int
    peer: Peer
    core: ClientCore
    think_s: float
    alive: bool = True
    asleep_s: float = 0.0  # hangs until then
    wire: int = 0  # of its connection; what is on its way in an older one is lost
    inbox: list[m.Reply] = field(default_factory=list)
    seen: list[tuple[bytes, int, int, int, int]] = field(default_factory=list)  # session, epoch, tick, life, chair
    ticks: int = 0  # seen since the faults ended
    progress: int = 0
    last_up_s: float = 0.0  # what is sent in one connection arrives in order
    last_down_s: float = 0.0


class Simulation:
    """One run; `run` raises Wrong when the audit finds something."""

    def __init__(self, seed: int, trace: bool = False) -> None:
        self.draws, self._trace = Draws(seed), trace
        self._unit = self.draws.unit
        self.clients = 1 + self.draws.below(6)
        self.capacity = self.clients
        self.rules = ServerRules(
            capacity=self.capacity, expected=1 + self.draws.below(self.clients), gather_s=8.0, lease_s=12.0,
            notice_s=1.0,
        )  # fmt: skip
        self.now_s, self.jump_s = 0.0, 1000.0 * self._unit()
        self.core, self.world = ServerCore(self.rules), SimWorld()
        self.down_until_s = 0.0
        self._events: list[tuple[float, int, str, tuple[object, ...]]] = []
        self._order, self._peers, self._sessions = count(), count(1), count(1)
        self.processes: dict[Peer, Process] = {}
        self.slots: dict[int, Process] = {}
        self._said: list[tuple[Peer, int, m.Request]] = []
        self._any = self._unit() < 0.5
        self._delay_s = (0.02, 0.6)[self.draws.below(2)]
        for number in range(self.clients):
            self._at(10.0 * self._unit() ** 2, "start", number)
        for _ in range(1 + self.draws.below(8)):
            self._at(END_S * self._unit(), "fault", FAULTS[self.draws.below(len(FAULTS))])
        self._at(0.5, "clock")

    # --- the loop ---

    def run(self) -> SimWorld:
        """Run to the end and audit. Raises Wrong."""
        while self._events:
            self.now_s, _, kind, what = heapq.heappop(self._events)
            getattr(self, f"_on_{kind}")(*what)
            if self.now_s > END_S and all(self._content(process) for process in self.slots.values()):
                break
            if self.now_s > END_S + QUIET_S:
                raise Wrong(f"no way on for {[p.number for p in self.slots.values() if not self._content(p)]}")
        self.world.audit()
        return self.world

    def _content(self, process: Process) -> bool:
        return not process.alive or process.ticks >= GOAL_TICKS

    def _at(self, time_s: float, kind: str, *what: object) -> None:
        heapq.heappush(self._events, (time_s, next(self._order), kind, what))

    def _tell(self, *parts: object) -> None:
        if self._trace:
            sys.stdout.write(f"{self.now_s:8.3f}  {' '.join(map(str, parts))}\n")

    # --- the server ---

    def _feed(self, event: Event) -> None:
        todo = list(self.core.handle(event, self.now_s + self.jump_s))
        while todo:
            effect = todo.pop(0)
            if isinstance(effect, StepWorldEffect):
                self.world.step(effect)
                self._tell("step", effect.tick, *effect.commands)
                todo += self.core.handle(WorldSteppedEvent(self.world.tick), self.now_s + self.jump_s)
            else:
                self._carry_out(effect)

    def _carry_out(self, effect: Effect) -> None:
        match effect:
            case SendMessageEffect():
                self._post(effect.peer, effect.message)
            case SendSensorFrameEffect():
                chair = self.world.show(effect.seat, effect.epoch, effect.tick, effect.life)
                self._post(effect.peer, m.Frame(effect.epoch, effect.tick, effect.life, None, chair))
            case StepWorldEffect():
                raise Wrong("a step among other effects")
            case _:
                self.world.change(effect)

    def _post(self, peer: Peer, message: m.Reply) -> None:
        process = self.processes.get(peer)
        if process is not None and process.alive:
            process.last_down_s = max(process.last_down_s, self.now_s + 0.001 + self._delay_s * self._unit())
            self._at(process.last_down_s, "reply", process, process.wire, message)

    def _on_clock(self) -> None:
        self._at(self.now_s + 1.0, "clock")
        if self.now_s >= self.down_until_s:
            self._feed(TimePassedEvent())
        for process in self.slots.values():
            if process.alive and self.now_s >= process.asleep_s:
                self._do(process, process.core.clock(self.now_s))
                process.progress += 1
                if process.core.phase is ClientPhase.THINK:
                    self._do(process, process.core.beat(process.progress))

    def _on_request(self, process: Process, wire: int, message: m.Request) -> None:
        if wire == process.wire and self.now_s >= self.down_until_s:
            self._tell(process.number, "said", message)
            self._feed(MessageReceivedEvent(process.peer, message))

    def _on_stray(self, peer: Peer, message: m.Request) -> None:
        if self.now_s >= self.down_until_s:
            self._tell("stray", message)
            self._feed(MessageReceivedEvent(peer, message))

    # --- clients ---

    def _on_start(self, number: int) -> None:
        old = self.slots.get(number)
        if old is not None and old.alive:
            return
        peer = next(self._peers).to_bytes(4, "big")
        seat = m.ANY_SEAT if self._any else number
        ask = JoinSettings(claim=b"claim%d" % number, name=f"c{number}", spec=SeatSpec(), seat=seat)
        core = ClientCore(ask, PATIENCE, lambda: next(self._sessions).to_bytes(m.SESSION_BYTES, "big"))
        process = Process(number, peer, core, 0.3 + 3.0 * self._unit())
        self.processes[peer] = self.slots[number] = process
        self._do(process, core.join(self.now_s))

    def _on_reply(self, process: Process, wire: int, message: m.Reply) -> None:
        if not process.alive or wire != process.wire:
            return
        if self.now_s < process.asleep_s:
            self._at(process.asleep_s, "reply", process, wire, message)
            return
        self._tell(process.number, "hears", message)
        self._do(process, process.core.handle(message, self.now_s))

    def _on_act(self, process: Process, session: bytes) -> None:
        core = process.core
        if not process.alive or core.phase is not ClientPhase.THINK or core.session != session:
            return
        if self.now_s < process.asleep_s:
            self._at(process.asleep_s, "act", process, session)
            return
        if self._unit() < 0.05:
            self._do(process, core.respawn(self.now_s))
            return
        stick = Joystick(process.number / 8, stick_of(core.epoch, core.tick))
        self._do(process, core.act(core.tick, stick, self.now_s))

    def _on_join(self, process: Process) -> None:
        if process.alive and process.core.phase is ClientPhase.OFF:
            self._do(process, process.core.join(self.now_s))

    def _do(self, process: Process, outcomes: list[Outcome]) -> None:
        restarted = any(isinstance(x, WorldRestartedError) for x in outcomes)
        for outcome in outcomes:
            match outcome:
                case ReceivedFrame():
                    self._see(process, outcome, restarted)
                case WcsimError():
                    self._fail(process, outcome)
                case m.Welcome():
                    pass
                case _:
                    self._say(process, outcome)

    def _say(self, process: Process, message: m.Request) -> None:
        self._said.append((process.peer, process.wire, message))
        process.last_up_s = max(process.last_up_s, self.now_s + 0.001 + self._delay_s * self._unit())
        self._at(process.last_up_s, "request", process, process.wire, message)

    def _see(self, process: Process, seen: ReceivedFrame, restarted: bool) -> None:
        core = process.core
        now = (core.session, seen.epoch, seen.tick, core.life, seen.slot)
        if process.seen and not restarted:
            _, epoch, tick, life, chair = process.seen[-1]
            follows = now[1:] in ((epoch, tick + 1, 0, chair), (epoch, tick, life + 1, chair))
            if not follows and not (seen.epoch > epoch and self.world.rebuilt):
                raise Wrong(f"client {process.number} sees {now} after {process.seen[-1]}")
        process.seen.append(now)
        process.ticks += self.now_s > END_S
        self._at(self.now_s + process.think_s * self._unit(), "act", process, core.session)

    def _fail(self, process: Process, error: WcsimError) -> None:
        name = type(error).__name__
        self._tell(process.number, "fails:", name, error)
        if name == "WorldRestartedError":
            return
        if name == "NotMasterError":
            self._at(self.now_s + 0.1, "act", process, process.core.session)
            return
        if name not in ("EvictedError", "SeatTakenError", "WorldFullError", "ServerGoneError"):
            raise Wrong(f"client {process.number}: {name}: {error}")
        process.seen = []
        if process.core.phase is ClientPhase.GONE:
            self._end(process, "start")
        else:
            self._at(self.now_s + 1.0, "join", process)

    def _end(self, process: Process, then: str) -> None:
        process.alive = False
        self._at(self.now_s + 2.0 + 10.0 * self._unit(), then, process.number)

    # --- faults ---

    def _on_fault(self, kind: str) -> None:
        alive = [process for process in self.slots.values() if process.alive]
        self._tell("fault:", kind)
        if kind in ("world", "replay", "jump", "rival"):
            getattr(self, f"_fault_{kind}")()
        elif alive:
            getattr(self, f"_fault_{kind.replace(' ', '_')}")(alive[self.draws.below(len(alive))])

    def _fault_crash(self, process: Process) -> None:
        self._end(process, "start" if self._unit() < 0.7 else "nothing")
        if self._unit() < 0.5:  # a child of this machine: its end is noticed
            self._at(self.now_s + 0.01, "lost", process.core.session)

    def _on_nothing(self, number: int) -> None:
        """Nobody starts this client again."""

    def _on_lost(self, session: bytes, may_return: bool = False) -> None:
        if self.now_s >= self.down_until_s:
            self._feed(ClientLostEvent(session, may_return=may_return))

    def _fault_suspect(self, process: Process) -> None:
        self._on_lost(process.core.session)

    def _fault_hang(self, process: Process) -> None:
        process.asleep_s = self.now_s + 20.0 * self._unit()

    def _fault_slow(self, process: Process) -> None:
        process.think_s = 9.0

    def _fault_leave(self, process: Process) -> None:
        self._do(process, process.core.leave())
        self._end(process, "start")

    def _fault_cut(self, process: Process) -> None:
        process.wire += 1
        if self._unit() < 0.5:  # over the network its end is told, be it late
            self._at(self.now_s + 6.0 * self._unit(), "lost", process.core.session, True)

    def _fault_lose_prefix(self, process: Process) -> None:
        """The connection goes between two messages of one answer."""
        coming = [(time_s, n) for time_s, n, kind, what in self._events if kind == "reply" and what[0] is process]
        if coming:
            first = min(coming)
            self._events = [event for event in self._events if event[:2] != first]
            heapq.heapify(self._events)

    def _fault_duplicate(self, process: Process) -> None:
        here = (process.peer, process.wire)
        said = [message for peer, wire, message in self._said[-20:] if (peer, wire) == here]
        for message in said:
            self._at(self.now_s + 0.1 * self._unit(), "request", process, process.wire, message)

    def _fault_rebuild(self, process: Process) -> None:
        if process.core.phase is ClientPhase.THINK:
            self.world.rebuilt = True
            self._do(process, process.core.rebuild(5, self.now_s))

    def _fault_jump(self) -> None:
        self.jump_s += 3600.0 * self._unit()

    def _fault_replay(self) -> None:
        """What was said long ago comes again, from somewhere else."""
        for _ in range(min(10, len(self._said))):
            message = self._said[self.draws.below(len(self._said))][2]
            if not isinstance(message, m.Join | m.Leave):  # whoever has a session's key may end it
                self._at(self.now_s + self._unit(), "stray", b"else", message)

    def _fault_rival(self) -> None:
        """Somebody else claims a seat; where it is free, it gets it and never acts."""
        session, seat = next(self._sessions).to_bytes(m.SESSION_BYTES, "big"), self.draws.below(self.clients)
        join = m.Join(m.PROTOCOL, m.hash_message_schema(), "", session, b"rival", seat, "c7", SeatSpec())
        self._at(self.now_s, "stray", b"else", join)

    def _fault_world(self) -> None:
        for process in self.processes.values():
            process.wire += 1
        self.down_until_s = self.now_s + 5.0 * self._unit()
        self.world.begin_again()
        self.core = ServerCore(self.rules, self.world.epoch)


if __name__ == "__main__":
    Simulation(int(sys.argv[1]), trace=True).run()
