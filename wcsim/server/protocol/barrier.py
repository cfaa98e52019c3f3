"""The cycle of a server: who is in, when the barrier is full, who is given up.

The master's action is the tick request of the paper's Fig. 4: it is granted once all others have acted, too, or at once
where they have. A tick thus costs a client one message and its answer, and no master can hold a full barrier up.

What changes the world is done in seat order and between ticks only: chairs go just before a step, and come just after
one. So two runs in which the same clients do the same give the same world, whatever the order of their messages.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Self

from wcsim.errors import EvictedError, ProtocolError
from wcsim.server.protocol import events as ev
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.members import Member, Roster
from wcsim.types import Command


class Barrier:
    """The state of a server and what moves it; `out` collects what is to be done."""

    def __init__(self, rules: ev.Rules, epoch: int = 0) -> None:
        """Nobody is there, at the beginning of `epoch`."""
        self.rules = rules
        self.epoch, self.tick = epoch, 0
        self.stage = ev.BarrierState.EMPTY
        self.last_tick: int | None = None  # of this epoch, where another server is to go on
        self.gathering = True
        self.roll = Roster()
        self.out: list[ev.Effect] = []
        self._gather_s: float | None = None  # since when somebody waits for the others to come
        self._told_s = -math.inf  # when those who wait were told for whom

    def copied(self) -> Self:
        """One in the same state that goes its own way."""
        twin = type(self).__new__(type(self))
        twin.__dict__.update(self.__dict__, roll=self.roll.copied(), out=[])
        return twin

    def late(self) -> tuple[str, ...]:
        """Names of those for whom the barrier waits."""
        return tuple(member.name for member in self.roll.by_seat() if not member.ready)

    @property
    def _master_seat(self) -> int:
        master = self.roll.master
        return m.ANY_SEAT if master is None else master.seat

    # --- ticks ---

    def gather(self, now_s: float) -> None:
        """Nobody is in: let in those who wait, once all are here that are expected."""
        if not self.roll.pending:
            self._gather_s = None
            return
        if self._gather_s is None:
            self._gather_s = now_s
        missing = self.gathering and len(self.roll.pending) < self.rules.expected
        if not missing or now_s - self._gather_s >= self.rules.gather_s:
            self.admit(now_s)

    def admit(self, now_s: float) -> None:
        """Give those who wait their seats, after every chair that was to go has gone."""
        self.dismiss()
        coming = sorted(self.roll.pending, key=lambda p: p.seat)
        self.roll.pending = []
        for p in coming:
            self.out.append(ev.Admit(p.seat, p.spec, p.name))
            self.roll.members.append(replace(p, heard_s=now_s, asked_s=now_s))
        for p in coming:
            member = self.roll.at(p.seat)
            if member is not None:
                self.welcome(member)
        if self.roll.members:
            self.gathering, self.stage = False, ev.BarrierState.COLLECT
        else:
            self.stage = ev.BarrierState.EMPTY

    def advance(self, now_s: float) -> None:
        """Go on when nobody owes anything: first with respawns, then through the full barrier."""
        members = self.roll.members
        if (
            self.stage is not ev.BarrierState.COLLECT
            or not members
            or not all([mate.ready for mate in members])
        ):
            return
        again = [mate for mate in self.roll.by_seat() if mate.respawning]
        if again:
            self.out.append(ev.RespawnSeats(tuple(mate.seat for mate in again)))
            for mate in again:
                mate.respawning, mate.life, mate.asked_s = False, mate.life + 1, now_s
                self.show(mate)
            return
        # Who has left by the last tick is gone from the journal, too: those who were in at its end are waited for.
        self.dismiss()
        if self.last_tick is not None and self.tick >= self.last_tick:
            self.stage = ev.BarrierState.EPOCH_OVER
        else:
            self.step()

    def step(self) -> None:
        """All have acted, and the chairs that were to go are gone: the world moves."""
        self.stage = ev.BarrierState.STEPPING
        actions = [(mate.seat, mate.action) for mate in self.roll.by_seat()]
        commands = tuple(
            Command(seat=s, tick=self.tick, joystick=a) for s, a in actions if a is not None
        )
        self.out.append(ev.Step(self.tick, commands))

    def commit(self, tick: int, now_s: float, step_s: float = 0.0) -> None:
        """The world has reached `tick`: everybody hears of it and gets a frame, then those who wait come in."""
        if self.stage is not ev.BarrierState.STEPPING or tick != self.tick + 1:
            raise ProtocolError(
                f"the world reports tick {tick} in stage {self.stage.value}; expected {self.tick + 1}"
            )
        self.tick = tick
        self._begin_tick(now_s)
        members = self.roll.by_seat()
        done = m.TickDone(self.epoch, tick, self._master_seat, step_s)
        for mate in members:
            self.send(mate.peer, done)
        for mate in members:
            self.show(mate)
        self.stage = ev.BarrierState.COLLECT if members else ev.BarrierState.EMPTY
        if self.roll.pending or not members:
            self.admit(now_s)

    def rebuild(self, seed: int, now_s: float) -> None:
        """A new epoch with the members of now."""
        self.dismiss()
        self.epoch, self.tick = self.epoch + 1, 0
        self.stage = ev.BarrierState.COLLECT
        self.out.append(ev.RebuildWorld(self.epoch, seed))
        self._begin_tick(now_s)
        for mate in self.roll.by_seat():
            self.send(
                mate.peer, m.Restarted(self.epoch, f"the world was restarted with seed {seed}")
            )
            self.show(mate)

    # --- who goes ---

    def evict(self, member: Member, reason: str, now_s: float) -> None:
        """Give a client up; should it live, it hears of it."""
        told = EvictedError(f"the server dropped this client: {reason}")
        self.send(member.peer, m.failure_of(told, member.session))
        self.roll.retire(member.session)
        if not self.roll.stop_waiting(member.session):
            self.remove(member, reason, now_s)

    def remove(self, member: Member, reason: str, now_s: float) -> None:
        """Take a member off the roll, and look at the barrier again: the others may owe nothing."""
        self.roll.members.remove(member)
        self.roll.going[member.seat] = reason
        if self.stage is ev.BarrierState.STEPPING:
            return
        if self.roll.members:
            self.advance(now_s)
        else:
            self.admit(now_s)

    def dismiss(self) -> None:
        """Take the chairs out of the world whose clients have gone; also after the last tick, which no step follows."""
        for seat, reason in sorted(self.roll.going.items()):
            self.out.append(ev.Dismiss(seat, reason))
        self.roll.going.clear()

    def watch(self, now_s: float) -> None:
        """Leases, and word to those who wait."""
        if self.stage is ev.BarrierState.EMPTY:
            self.gather(now_s)
        elif self.stage is ev.BarrierState.COLLECT:
            self._give_up_overdue(now_s)
        if now_s - self._told_s >= self.rules.notice_s:
            self._tell(now_s)

    def stop(self, reason: str) -> None:
        """Everybody is told that this is the end."""
        self.stage = ev.BarrierState.STOPPED
        for one in self.roll.by_seat() + self.roll.pending:
            self.send(one.peer, m.Bye(one.session, reason or "the server stops"))

    # --- what is sent ---

    def welcome(self, member: Member) -> None:
        """Tell a client that it is in, and show it what its seat sees."""
        self.send(
            member.peer,
            m.Welcome(member.session, self.epoch, self.tick, member.seat, self._master_seat),
        )
        self.show(member)

    def show(self, member: Member) -> None:
        """Send a client the frame of now."""
        self.out.append(ev.SendFrame(member.peer, member.seat, self.epoch, self.tick, member.life))

    def send(self, peer: ev.Peer, message: m.Reply) -> None:
        """Send a message."""
        self.out.append(ev.Send(peer, message))

    # --- inside ---

    def _begin_tick(self, now_s: float) -> None:
        self._told_s = now_s
        for mate in self.roll.members:
            mate.action, mate.respawning, mate.life = None, False, 0
            mate.asked_s, mate.thought_s = now_s, 0.0

    def _give_up_overdue(self, now_s: float) -> None:
        for mate in self.roll.by_seat():
            reason = self._overdue(mate, now_s)
            if reason and self.stage is ev.BarrierState.COLLECT and mate in self.roll.members:
                self.evict(mate, reason, now_s)

    def _overdue(self, mate: Member, now_s: float) -> str:
        if mate.ready:
            return ""
        owes_s = now_s - mate.asked_s
        silent_s = now_s - max(mate.heard_s, mate.asked_s)
        if silent_s > self.rules.lease_s:
            return f"no sign of progress for {silent_s:.0f} s"
        limit_s = self.rules.max_think_s
        late = (
            limit_s is not None and mate.thought_s + owes_s > limit_s
        )  # a new life gives no new time
        return f"no action within {limit_s:g} s" if late else ""

    def _tell(self, now_s: float) -> None:
        self._told_s = now_s
        note = m.Waiting(self.epoch, self.tick, self.late())
        for one in [mate for mate in self.roll.by_seat() if mate.ready] + self.roll.pending:
            self.send(one.peer, note)
