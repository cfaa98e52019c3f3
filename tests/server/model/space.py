"""States of a whole world with its clients, and what can happen in each of them.

Channels are in order and lose nothing but by a fault. A label with "!" is a fault: progress never needs one.
"""

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, replace

from tests.server.model.cores import Clients, Servers
from tests.server.model.scope import BUDGETS, Notice, Scope, Violation
from tests.server.model.shadow import Shadow, stick_of
from tests.server.model.view import NOTHING_SEEN, View, hear
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import ClientCore, ClientPhase, Outcome
from wcsim.server.protocol.events import (
    BarrierState,
    ClientLostEvent,
    Effect,
    MessageReceivedEvent,
    Peer,
    SendMessageEffect,
    SendSensorFrameEffect,
    StepWorldEffect,
    WorldSteppedEvent,
)
from wcsim.types import Joystick


@dataclass(frozen=True, slots=True)
class Slot:
    """One client's process and its two channels; messages to a process that is no more are nobody's."""

    core: int
    mode: str = "dead"  # or live, hung
    process: int = 0  # how many there have been
    drawn: int = 0  # sessions
    starts: int = 0  # left
    wire: int = 0  # connections that were cut
    homes: tuple[tuple[bytes, Peer], ...] = ()  # where each session of the server's joined first
    up: tuple[tuple[Peer, m.Request], ...] = ()
    down: tuple[m.Reply, ...] = ()
    view: View = NOTHING_SEEN


@dataclass(frozen=True, slots=True)
class World:
    """Everything at one moment."""

    server: int
    shadow: Shadow
    slots: tuple[Slot, ...]
    left: tuple[int, ...]  # of each budget


Move = tuple[str, World]
ClockMove = Callable[[int, int], tuple[int, tuple[Effect, ...]]]
ClientMove = Callable[[ClientCore], list[Outcome]]


class Space:
    """All that can happen within a scope."""

    def __init__(self, scope: Scope) -> None:
        self.scope = scope
        self.servers = Servers(scope)
        self.clients = tuple(Clients(scope, i) for i in range(scope.clients))
        self.sticks = {f"c{i}": (i + 1) / 16 for i in range(scope.clients)}

    def first(self) -> World:
        """Nobody is there yet."""
        slots = tuple(Slot(clients.new(), starts=self.scope.starts) for clients in self.clients)
        left = tuple(int(getattr(self.scope, name)) for name in BUDGETS)
        return World(self.servers.new(0, self.scope.expected), Shadow(), slots, left)

    def moves(self, at: World) -> Iterator[Move]:
        """Everything that can happen next. Raises Violation."""
        yield from self._server_moves(at)
        for i, slot in enumerate(at.slots):
            if slot.up:
                yield from self._arrivals(at, i, slot)
            if slot.mode == "live":
                yield from self._client_moves(at, i, slot)
            elif slot.mode == "dead" and slot.starts:
                yield self._begin(at, i, slot)
            yield from self._faults(at, i, slot)

    def done(self, at: World) -> bool:
        """Whether every client that lives has reached the last tick, or waits for one after it; in the last epoch."""
        if self._ends(at.shadow.epoch):
            return False
        roster, top = self.servers.cores[at.server].roster, at.shadow.tick >= self.scope.last_tick
        for i, slot in enumerate(at.slots):
            core = self.clients[i].cores[slot.core]
            if slot.mode == "hung" or (slot.mode == "dead" and not slot.starts):
                continue
            if slot.mode == "live" and core.phase is ClientPhase.OFF and not slot.starts:
                continue
            there = slot.mode == "live" and (core.epoch, core.tick) == (at.shadow.epoch, self.scope.last_tick)
            if not (there and core.phase is ClientPhase.THINK) and not (
                top and roster.waiting(core.session) is not None
            ):
                return False
        return True

    # --- the server and time ---

    def _server_moves(self, at: World) -> Iterator[Move]:
        core = self.servers.cores[at.server]
        if core.stage is BarrierState.STEPPING:
            yield "stepped", self._stepped(at)
            if not self.scope.split_step:
                return
        if core.stage is BarrierState.EPOCH_OVER:
            yield from self._ends_of_epoch(at)
        alive, told = self._alive(at), self.scope.notice is Notice.PROCESS
        told_else = self.scope.notice is Notice.CONNECTION  # no lease is needed then
        for mate in core.roster.members:
            fault, label = mate.session in alive, f"overdue seat {mate.seat}"
            if fault or not told_else or self._is_connected(at, mate.session):
                yield from self._paid(at, label, "suspect", fault, self.servers.overdue, mate.seat)
            if (fault or told) and not self._hung(at, mate.session):
                yield from self._lost(at, mate.session, fault)
        for waiting in core.roster.pending:
            if waiting.session not in alive and told and not self._hung(at, waiting.session):
                yield from self._lost(at, waiting.session, fault=False)
        if told_else:
            for i, slot in enumerate(at.slots):
                if any(_is_over(slot, peer) for peer in (*dict(slot.homes).values(), *dict(slot.up))):
                    yield f"connection of {i} lost", self._connection_lost(at, i, slot)
        if core.stage is BarrierState.EMPTY and core.roster.pending:
            yield from self._paid(at, "gathered", "", False, lambda server, _: self.servers.gathered(server), 0)
        yield from self._deaths(at)

    def _paid(self, at: World, label: str, budget: str, fault: bool, act: ClockMove, seat: int) -> Iterator[Move]:
        """A move of the server's clock; as a fault, when there is some of the budget left."""
        paid = self._pay(at, budget) if fault else at
        if paid is not None:
            server, effects = act(at.server, seat)
            if server != at.server or effects:
                yield ("!" if fault else "") + label, self._carry_out(replace(paid, server=server), effects)

    def _lost(self, at: World, session: bytes, fault: bool) -> Iterator[Move]:
        paid = self._pay(at, "suspect") if fault else at
        if paid is not None:
            server, effects = self.servers.handle(at.server, ClientLostEvent(session))
            yield (
                ("!" if fault else "") + f"lost {session[:2].hex()}",
                self._carry_out(replace(paid, server=server), effects),
            )

    def _connection_lost(self, at: World, i: int, slot: Slot) -> World:
        """As the host does: sessions that began in it are as good as dead, what is still on its way is not heard."""
        homes = dict(slot.homes)
        up = tuple(one for one in slot.up if not _is_over(slot, one[0]))
        kept = tuple((session, home) for session, home in slot.homes if not _is_over(slot, home))
        at = _with(at, i, replace(slot, up=up, homes=kept))
        for one in self.servers.cores[at.server].roster.everyone():
            if one.session in homes and _is_over(slot, homes[one.session]):
                server, effects = self.servers.handle(at.server, ClientLostEvent(one.session, may_return=True))
                at = self._carry_out(replace(at, server=server), effects)
        return at

    def _stepped(self, at: World) -> World:
        server, effects = self.servers.handle(at.server, WorldSteppedEvent(at.shadow.tick + 1))
        return self._carry_out(replace(at, server=server, shadow=at.shadow.stepped()), effects)

    def _deaths(self, at: World) -> Iterator[Move]:
        paid = self._pay(at, "world")
        if paid is not None:
            yield "!world", self._next_epoch(paid, heard=False)

    def _next_epoch(self, at: World, heard: bool) -> World:
        """Another server, which waits for all who had a chair; whether what was said to clients last reaches them."""
        slots = tuple(replace(slot, up=(), down=slot.down if heard else (), homes=()) for slot in at.slots)
        shadow = Shadow(epoch=at.shadow.epoch + 1, made=at.shadow.made)
        server = self.servers.new(shadow.epoch, max(1, len(at.shadow.chairs)))
        return replace(at, server=server, shadow=shadow, slots=slots)

    def _ends_of_epoch(self, at: World) -> Iterator[Move]:
        """The server's process ends as planned. Raises Violation where a step is lost, or a chair is left over."""
        sessions = {mate.session: mate.seat for mate in self.servers.cores[at.server].roster.members}
        if sorted(sessions.values()) != [chair.seat for chair in at.shadow.chairs]:
            raise Violation(f"the epoch ends with the chairs {at.shadow.chairs}; its members: {sessions}")
        for i, slot in enumerate(at.slots):
            seen, here = slot.view.last, self.clients[i].cores[slot.core].session in sessions
            if slot.mode != "dead" and here and (seen is None or seen[:2] != (at.shadow.epoch, at.shadow.tick)):
                raise Violation(f"the epoch ends at tick {at.shadow.tick}, and {i} has seen {seen}")
        for heard in (True, False):
            yield f"the epoch is over, {'' if heard else 'un'}heard", self._next_epoch(at, heard)

    def _ends(self, epoch: int) -> bool:
        """Whether an epoch ends as planned."""
        return epoch == 0 and self.scope.ends_at is not None

    def _carry_out(self, at: World, effects: tuple[Effect, ...]) -> World:
        if sum(isinstance(effect, StepWorldEffect) for effect in effects) > 1:
            raise Violation(f"step twice at tick {at.shadow.tick}")
        for effect in effects:
            match effect:
                case SendMessageEffect():
                    self._names_the_master(at, effect.message)
                    at = self._post(at, effect.peer, effect.message)
                case SendSensorFrameEffect():
                    at = self._show(at, effect)
                case StepWorldEffect():
                    at.shadow.check(effect.tick, effect.commands, self.sticks)
                case _:
                    at = replace(at, shadow=at.shadow.after(effect))
        return at

    def _names_the_master(self, at: World, message: m.Reply) -> None:
        """The master is who has been there for longest."""
        if isinstance(message, m.TickDone | m.Welcome):
            members = self.servers.cores[at.server].roster.members
            seats = [mate.seat for mate in members]
            here = [chair for chair in at.shadow.chairs if chair.seat in seats]
            oldest = min(here, key=lambda chair: chair.number).seat
            if message.master != oldest:
                raise Violation(f"the master is said to be seat {message.master}; seat {oldest} is the oldest")

    def _show(self, at: World, show: SendSensorFrameEffect) -> World:
        chair = at.shadow.at(show.seat)
        seen, is_so = (show.epoch, show.tick), (at.shadow.epoch, at.shadow.tick)
        if chair is None or (*seen, show.life) != (*is_so, chair.life):
            raise Violation(f"a frame of {seen}, life {show.life}; seat {show.seat} is {chair} at {is_so}")
        return self._post(at, show.peer, m.Frame(*seen, show.life, None, chair.number))

    def _post(self, at: World, peer: Peer, message: m.Reply) -> World:
        i, slot = peer[0], at.slots[peer[0]]
        if _is_over(slot, peer):
            return at
        return _with(at, i, replace(slot, down=(*slot.down, message)))

    # --- clients ---

    def _arrivals(self, at: World, i: int, slot: Slot) -> Iterator[Move]:
        (peer, message), rest = slot.up[0], slot.up[1:]
        if self.servers.cores[at.server].stage is not BarrierState.STEPPING or self.scope.split_step:
            server, effects = self.servers.handle(at.server, MessageReceivedEvent(peer, message))
            self._fenced(at.server, server, message)
            after = _with(replace(at, server=server), i, replace(slot, up=rest, homes=self._homes(slot, server)))
            yield f"{i} said {_short(message)}", self._carry_out(after, effects)
        paid = self._pay(at, "duplicate")
        if paid is not None:
            yield f"!dup {i} {_short(message)}", _with(paid, i, replace(slot, up=(*slot.up, slot.up[0])))
        paid = self._pay(at, "lose")
        if paid is not None:
            yield f"!lose {i} {_short(message)}", _with(paid, i, replace(slot, up=rest))

    def _homes(self, slot: Slot, server: int) -> tuple[tuple[bytes, Peer], ...]:
        """Where the sessions that the server knows have joined first, when it has heard what is next."""
        if self.scope.notice is not Notice.CONNECTION:
            return ()
        peer, message = slot.up[0]
        homes = {**({message.session: peer} if isinstance(message, m.Join) else {}), **dict(slot.homes)}
        here = {one.session for one in self.servers.cores[server].roster.everyone()}
        return tuple((session, home) for session, home in homes.items() if session in here)

    def _fenced(self, before: int, after: int, message: m.Request) -> None:
        """Who is not a member changes neither members nor the core."""
        old, new = self.servers.cores[before], self.servers.cores[after]
        if isinstance(message, m.Join) or old.roster.member(message.session) is not None:
            return
        same = [(c.stage, c.epoch, c.tick, c.roster.members) for c in (old, new)]
        if same[0] != same[1]:
            raise Violation(f"a fenced session acts: {_short(message)}")

    def _begin(self, at: World, i: int, slot: Slot) -> Move:
        fresh = replace(slot, core=self.clients[i].new(), mode="live", process=slot.process + 1)
        return f"{i} starts", self._join(at, i, replace(fresh, down=(), view=NOTHING_SEEN))

    def _join(self, at: World, i: int, slot: Slot) -> World:
        return self._act(at, i, replace(slot, starts=slot.starts - 1), "join", lambda core: core.join(0.0))

    def _client_moves(self, at: World, i: int, slot: Slot) -> Iterator[Move]:
        core = self.clients[i].cores[slot.core]
        if slot.down:
            heard, rest = slot.down[0], replace(slot, down=slot.down[1:])
            yield f"{i} hears {_short(heard)}", self._act(at, i, rest, heard, lambda c: c.handle(heard, 0.0))
            paid = self._pay(at, "lose")
            if paid is not None:
                yield f"!{i} misses {_short(heard)}", _with(paid, i, rest)
        elif core.waiting and not slot.up:
            after = self._act(at, i, slot, "again", lambda c: c.clock(3.0))
            if after != at:
                yield f"{i} asks again", after
        if core.phase is ClientPhase.OFF and slot.starts:
            yield f"{i} joins", self._join(at, i, slot)
        if core.phase is ClientPhase.THINK:
            yield from self._driver_moves(at, i, slot, core.epoch, core.tick)

    def _driver_moves(self, at: World, i: int, slot: Slot, epoch: int, tick: int) -> Iterator[Move]:
        until = self.scope.last_tick + self._ends(epoch)
        if tick < until or epoch < at.shadow.epoch:
            stick = Joystick(self.sticks[f"c{i}"], stick_of(epoch, tick))
            yield f"{i} acts {tick}", self._act(at, i, slot, "act", lambda c: c.act(tick, stick, 0.0))
            paid = self._pay(at, "respawn")
            if paid is not None:
                yield f"{i} respawns", self._act(paid, i, slot, "respawn", lambda c: c.respawn(0.0))
        paid = self._pay(at, "rebuild")
        if paid is not None:
            yield f"!{i} rebuilds", self._act(paid, i, slot, "rebuild", lambda c: c.rebuild(7, 0.0))
        paid = self._pay(at, "leave")
        if paid is not None:
            yield f"!{i} leaves", self._act(paid, i, slot, "leave", lambda c: c.leave())

    def _faults(self, at: World, i: int, slot: Slot) -> Iterator[Move]:
        if slot.mode == "dead":
            return
        for budget, mode in (("crash", "dead"), ("hang", "hung"), ("wake", "live")):
            paid = self._pay(at, budget)
            if paid is not None and slot.mode != mode and (budget != "wake" or slot.mode == "hung"):
                down = () if mode == "dead" else slot.down
                yield f"!{budget} {i}", _with(paid, i, replace(slot, mode=mode, down=down))
        paid = self._pay(at, "cut")
        if paid is not None and self.scope.notice is Notice.CONNECTION:
            yield f"!cut {i}", _with(paid, i, replace(slot, wire=slot.wire + 1, down=()))
        elif paid is not None and (slot.up or slot.down):
            yield f"!cut {i}", _with(paid, i, replace(slot, up=(), down=()))

    def _act(self, at: World, i: int, slot: Slot, key: Hashable, act: ClientMove) -> World:
        before = self.clients[i].cores[slot.core]
        core, outcomes, drawn = self.clients[i].do(slot.core, slot.drawn, key, act)
        after = self.clients[i].cores[core]
        given_up = self.scope.suspect + self.scope.hang > 0
        view = hear(slot.view, before, after, outcomes, given_up)
        peer = bytes([i, slot.process, slot.wire])
        up = slot.up + tuple((peer, x) for x in outcomes if isinstance(x, m.Request))
        gone = after.phase is ClientPhase.GONE
        slot = replace(slot, core=core, drawn=drawn, up=up, view=NOTHING_SEEN if gone else view)
        return _with(at, i, replace(slot, mode="dead", down=()) if gone else slot)

    # --- who lives ---

    def _alive(self, at: World) -> set[bytes]:
        cores = [self.clients[i].cores[slot.core] for i, slot in enumerate(at.slots) if slot.mode == "live"]
        return {core.session for core in cores if core.phase is not ClientPhase.OFF}

    def _is_connected(self, at: World, session: bytes) -> bool:
        """Whether the connection stands in which a session of the server's joined first."""
        slot = at.slots[session[0]]
        return any(session == one and not _is_over(slot, home) for one, home in slot.homes)

    def _hung(self, at: World, session: bytes) -> bool:
        slot = at.slots[session[0]]
        return slot.mode == "hung" and self.clients[session[0]].cores[slot.core].session == session

    def _pay(self, at: World, budget: str) -> World | None:
        k = BUDGETS.index(budget)
        if not at.left[k]:
            return None
        return replace(at, left=(*at.left[:k], at.left[k] - 1, *at.left[k + 1 :]))


def _is_over(slot: Slot, peer: Peer) -> bool:
    """Whether nobody is at the other end of a connection any more."""
    return slot.mode == "dead" or peer[1:] != bytes([slot.process, slot.wire])


def _with(at: World, i: int, slot: Slot) -> World:
    return replace(at, slots=(*at.slots[:i], slot, *at.slots[i + 1 :]))


def _short(message: m.Request | m.Reply) -> str:
    names = ("epoch", "tick", "life", "master", "error")
    told = [str(getattr(message, name)) for name in names if hasattr(message, name)]
    session = getattr(message, "session", b"")[:2].hex()
    return f"{type(message).__name__}({','.join([*told, session])})"
