"""Cores with one fault each: a checker that does not find them proves nothing."""

from __future__ import annotations

from collections.abc import Sequence

from wcsim.server.protocol import messages as m
from wcsim.server.protocol.barrier import Barrier
from wcsim.server.protocol.client_core import ClientCore, ClientPhase, Outcome
from wcsim.server.protocol.events import Rules
from wcsim.server.protocol.members import Member
from wcsim.server.protocol.server_core import ServerCore


class UncheckedTick(ServerCore):
    """Steps whenever somebody asks, for whatever tick and term."""

    def _tick(self, member: Member, tick: m.Tick) -> None:
        self.cycle.step()


class NoLease(ServerCore):
    """Waits for ever."""

    def __init__(self, rules: Rules, epoch: int = 0, tick: int = 0, kept: Sequence[Member] = ()) -> None:
        super().__init__(rules, epoch, tick, kept)
        self.cycle.__class__ = _Patient


class _Patient(Barrier):
    def watch(self, now_s: float) -> None:
        if now_s - self._told_s >= self.rules.notice_s:
            self._tell(now_s)


class NoPromotion(ServerCore):
    """A world whose master is gone has none."""

    def __init__(self, rules: Rules, epoch: int = 0, tick: int = 0, kept: Sequence[Member] = ()) -> None:
        super().__init__(rules, epoch, tick, kept)
        self.cycle.__class__ = _Headless


class _Headless(Barrier):
    def promote(self, member: Member | None, tell: bool) -> None:
        super().promote(None if tell else member, tell)


class NotLookedAtAgain(ServerCore):
    """A barrier that became full because somebody went is not noticed."""

    def __init__(self, rules: Rules, epoch: int = 0, tick: int = 0, kept: Sequence[Member] = ()) -> None:
        super().__init__(rules, epoch, tick, kept)
        self.cycle.__class__ = _Absent


class _Absent(Barrier):
    def remove(self, member: Member, reason: str, now_s: float) -> None:
        self._removing = True
        super().remove(member, reason, now_s)
        self._removing = False

    def advance(self, now_s: float) -> None:
        if not getattr(self, "_removing", False):
            super().advance(now_s)


class ShowsAnyFrame(ClientCore):
    """Takes a frame that it has had for the next one."""

    def _frame(self, frame: m.Frame) -> list[Outcome]:
        if self.phase in (ClientPhase.THINK, ClientPhase.WAIT_TICK, ClientPhase.WAIT_SENSORS):
            return self._seen(frame)
        return super()._frame(frame)


class TicksOnce(ClientCore):
    """Does not answer when it is told again that the barrier is full."""

    def _barrier_full(self, full: m.BarrierFull) -> list[Outcome]:
        if self._ahead == full.tick:
            return []
        self._ahead = full.tick
        return super()._barrier_full(full)


class NeverAsksAgain(ClientCore):
    """Takes for granted that what it said was heard."""

    def clock(self, now_s: float) -> list[Outcome]:
        return []
