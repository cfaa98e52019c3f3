"""The cycle of a server: who is in, when the barrier is full, who is evicted.

The master's action is the tick request of the paper's Fig. 4. It is granted once all others have
acted too, or at once where they have. A tick thus costs a client one message and its answer, and no
master can delay a full barrier.

The world changes in seat order and between ticks only: chairs leave just before a step, and appear
just after one. So two runs in which the same clients do the same give the same world, whatever the
order of their messages.
"""

import math
from copy import copy
from dataclasses import replace
from typing import Self

from wcsim.errors import EvictedError, ProtocolError
from wcsim.server.protocol import events as ev
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.members import ClientRoster, RosterClient
from wcsim.types import Command


class TickBarrier:
    """The state of a server and what changes it; `out` collects the effects of an event."""

    def __init__(self, rules: ev.ServerRules, epoch: int = 0) -> None:
        """No client is there, at the start of `epoch`."""
        self.rules = rules
        self.epoch = epoch
        self.tick = 0
        self.stage = ev.BarrierState.EMPTY
        self.last_tick: int | None = None  # of this epoch, if another server is to go on
        self.gathering = True  # until the first clients are admitted
        self.roster = ClientRoster()
        self.out: list[ev.Effect] = []
        self._gather_since_s: float | None = None  # since when a client waits for the others
        self._last_notice_s = -math.inf  # when those who wait last got a `Waiting`

    def copied(self) -> Self:
        """A barrier in the same state that changes by itself."""
        other = copy(self)
        other.roster, other.out = self.roster.copied(), []
        return other

    def late(self) -> tuple[str, ...]:
        """Names of those for whom the barrier waits."""
        return tuple(member.name for member in self.roster.by_seat() if not member.ready)

    @property
    def _master_seat(self) -> int:
        master = self.roster.master
        return m.ANY_SEAT if master is None else master.seat

    # --- ticks ---

    def gather(self, now_s: float) -> None:
        """No client is in: admit those who wait, once all that are expected have come."""
        if not self.roster.pending:
            self._gather_since_s = None
            return
        if self._gather_since_s is None:
            self._gather_since_s = now_s
        is_missing = self.gathering and len(self.roster.pending) < self.rules.expected
        if not is_missing or now_s - self._gather_since_s >= self.rules.gather_s:
            self.admit(now_s)

    def admit(self, now_s: float) -> None:
        """Give those who wait their seats, after every chair that was to go has gone."""
        self.dismiss()
        joining = sorted(self.roster.pending, key=lambda p: p.seat)
        self.roster.pending = []
        admitted = [replace(p, progress_s=now_s, owes_since_s=now_s) for p in joining]
        self.roster.members += admitted
        self.out += [
            ev.AdmitSeatEffect(member.seat, member.spec, member.name) for member in admitted
        ]
        for member in admitted:
            self.send_welcome(member)
        if self.roster.members:
            self.gathering = False
            self.stage = ev.BarrierState.COLLECT
        else:
            self.stage = ev.BarrierState.EMPTY

    def advance(self, now_s: float) -> None:
        """Go on when no member owes anything: with respawns first, else through the barrier."""
        members = self.roster.members
        is_full = all([mate.ready for mate in members])
        if self.stage is not ev.BarrierState.COLLECT or not members or not is_full:
            return
        respawning = [mate for mate in self.roster.by_seat() if mate.respawning]
        if respawning:
            self.out.append(ev.RespawnSeatsEffect(tuple(mate.seat for mate in respawning)))
            for mate in respawning:
                mate.respawning = False
                mate.life += 1
                mate.owes_since_s = now_s
                self.send_frame(mate)
            return
        # A client that left at the last tick leaves the journal, too. The next server waits only
        # for those who were in at the end.
        self.dismiss()
        if self.last_tick is not None and self.tick >= self.last_tick:
            self.stage = ev.BarrierState.EPOCH_OVER
        else:
            self.step()

    def step(self) -> None:
        """Have the world do a tick: all have acted, and the chairs that were to go have gone."""
        self.stage = ev.BarrierState.STEPPING
        actions = [(mate.seat, mate.action) for mate in self.roster.by_seat()]
        commands = tuple(
            Command(seat=seat, tick=self.tick, joystick=action)
            for seat, action in actions
            if action is not None
        )
        self.out.append(ev.StepWorldEffect(self.tick, commands))

    def commit(self, tick: int, now_s: float, step_s: float = 0.0) -> None:
        """The world has reached `tick`: all get word and a frame, then those who wait come in."""
        if self.stage is not ev.BarrierState.STEPPING or tick != self.tick + 1:
            raise ProtocolError(
                f"the world reports tick {tick} in stage {self.stage.value}; "
                f"expected {self.tick + 1}"
            )
        self.tick = tick
        self._start_tick(now_s)
        members = self.roster.by_seat()
        done = m.TickDone(self.epoch, tick, self._master_seat, step_s)
        for mate in members:
            self.send(mate.peer, done)
        for mate in members:
            self.send_frame(mate)
        self.stage = ev.BarrierState.COLLECT if members else ev.BarrierState.EMPTY
        if self.roster.pending or not members:
            self.admit(now_s)

    def rebuild(self, seed: int, now_s: float) -> None:
        """Start a new epoch with the present members."""
        self.dismiss()
        self.epoch += 1
        self.tick = 0
        self.stage = ev.BarrierState.COLLECT
        self.out.append(ev.RebuildWorldEffect(self.epoch, seed))
        self._start_tick(now_s)
        restarted = m.Restarted(self.epoch, f"the world was restarted with seed {seed}")
        for mate in self.roster.by_seat():
            self.send(mate.peer, restarted)
            self.send_frame(mate)

    # --- who goes ---

    def evict(self, member: RosterClient, reason: str, now_s: float) -> None:
        """Remove a client, and send it why, in case that it lives."""
        error = EvictedError(f"the server dropped this client: {reason}")
        self.send(member.peer, m.failure_from_error(error, member.session))
        self.roster.retire(member.session)
        if not self.roster.stop_waiting(member.session):
            self.remove(member, reason, now_s)

    def remove(self, member: RosterClient, reason: str, now_s: float) -> None:
        """Remove a member, and look at the barrier again: the others may owe nothing."""
        self.roster.members.remove(member)
        self.roster.going[member.seat] = reason
        if self.stage is ev.BarrierState.STEPPING:
            return
        if self.roster.members:
            self.advance(now_s)
        else:
            self.admit(now_s)

    def dismiss(self) -> None:
        """Take the chairs of clients that have left out of the world.

        Also after the last tick, which no step follows.
        """
        for seat, reason in sorted(self.roster.going.items()):
            self.out.append(ev.DismissSeatEffect(seat, reason))
        self.roster.going.clear()

    def watch(self, now_s: float) -> None:
        """Evict overdue members, and send those who wait for whom."""
        if self.stage is ev.BarrierState.EMPTY:
            self.gather(now_s)
        elif self.stage is ev.BarrierState.COLLECT:
            for mate in self.roster.by_seat():
                # An eviction may fill the barrier, and so change stage and members.
                reason = self._overdue_reason(mate, now_s)
                is_collecting = self.stage is ev.BarrierState.COLLECT
                if reason and is_collecting and mate in self.roster.members:
                    self.evict(mate, reason, now_s)
        if now_s - self._last_notice_s >= self.rules.notice_s:
            self._send_waiting(now_s)

    def stop(self, reason: str) -> None:
        """End: all clients get a `Bye`."""
        self.stage = ev.BarrierState.STOPPED
        for p in self.roster.by_seat() + self.roster.pending:
            self.send(p.peer, m.Bye(p.session, reason or "the server stops"))

    # --- what is sent ---

    def send_welcome(self, member: RosterClient) -> None:
        """Send a client its seat, and the frame of that seat."""
        self.send(
            member.peer,
            m.Welcome(member.session, self.epoch, self.tick, member.seat, self._master_seat),
        )
        self.send_frame(member)

    def send_frame(self, member: RosterClient) -> None:
        """Send a client its present frame."""
        self.out.append(
            ev.SendSensorFrameEffect(member.peer, member.seat, self.epoch, self.tick, member.life)
        )

    def send(self, peer: ev.Peer, message: m.Reply) -> None:
        """Send a message."""
        self.out.append(ev.SendMessageEffect(peer, message))

    # --- inside ---

    def _start_tick(self, now_s: float) -> None:
        self._last_notice_s = now_s
        for mate in self.roster.members:
            mate.action = None
            mate.respawning = False
            mate.life = 0
            mate.owes_since_s = now_s
            mate.earlier_lives_s = 0.0

    def _overdue_reason(self, mate: RosterClient, now_s: float) -> str:
        """Why a member is evicted, "" when it is not."""
        if mate.ready:
            return ""
        silent_s = now_s - max(mate.progress_s, mate.owes_since_s)
        if silent_s > self.rules.lease_s:
            return f"no sign of progress for {silent_s:.0f} s"
        # A new life gives no new time.
        think_s = mate.earlier_lives_s + (now_s - mate.owes_since_s)
        limit_s = self.rules.max_think_s
        is_late = limit_s is not None and think_s > limit_s
        return f"no action within {limit_s:g} s" if is_late else ""

    def _send_waiting(self, now_s: float) -> None:
        self._last_notice_s = now_s
        note = m.Waiting(self.epoch, self.tick, self.late())
        ready = [mate for mate in self.roster.by_seat() if mate.ready]
        for p in ready + self.roster.pending:
            self.send(p.peer, note)
