"""Cores with one fault each: a checker that does not find them proves nothing."""

from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import ClientCore, ClientPhase, Outcome
from wcsim.server.protocol.events import BarrierState, ClientLostEvent
from wcsim.server.protocol.members import RosterClient
from wcsim.server.protocol.server_core import ServerCore


class AnyTick(ServerCore):
    """Takes an action for one of now, whatever tick it was meant for."""

    def _answer_old(self, member: RosterClient, epoch: int, tick: int, life: int) -> bool:
        return False


class ForgetsTheCut(ServerCore):
    """Knows the session of a lost connection still."""

    def _lose(self, lost: ClientLostEvent, now_s: float) -> None:
        if not lost.may_return:
            super()._lose(lost, now_s)


class EvictsTheCut(ServerCore):
    """Takes the client of a lost connection for one that is to hear of it."""

    def _lose(self, lost: ClientLostEvent, now_s: float) -> None:
        super()._lose(ClientLostEvent(lost.session), now_s)


class BeginsTheCutAnew(ServerCore):
    """Gives a session of a lost connection another chair."""

    def _lose(self, lost: ClientLostEvent, now_s: float) -> None:
        super()._lose(lost, now_s)
        self.roster.forgotten.clear()


class TooEarly(ServerCore):
    """Steps as soon as somebody has acted."""

    def advance(self, now_s: float) -> None:
        acted = any(mate.action is not None for mate in self.roster.members)
        if self.stage is BarrierState.COLLECT and acted:
            self.dismiss()
            self.step()
        else:
            super().advance(now_s)


class LosesAnAction(ServerCore):
    """Steps without what the last one in seat order has said."""

    def step(self) -> None:
        self.roster.by_seat()[-1].action = None
        super().step()


class StepsTwice(ServerCore):
    """Asks for the same step again."""

    def step(self) -> None:
        super().step()
        super().step()


class NoLease(ServerCore):
    """Waits for ever."""

    def watch(self, now_s: float) -> None:
        if now_s - self._last_notice_s >= self.rules.notice_s:
            self._send_waiting(now_s)


class NoHeir(ServerCore):
    """Says that the youngest member is the master."""

    @property
    def _master_seat(self) -> int:
        return self.roster.members[-1].seat


class NotLookedAtAgain(ServerCore):
    """A barrier that became full because somebody went is not noticed."""

    def remove(self, member: RosterClient, reason: str, now_s: float) -> None:
        self._removing = True
        super().remove(member, reason, now_s)
        self._removing = False

    def advance(self, now_s: float) -> None:
        if not getattr(self, "_removing", False):
            super().advance(now_s)


class EndsUnseen(ServerCore):
    """Ends its epoch when the world has reached the last tick."""

    def commit(self, tick: int, now_s: float, step_s: float = 0.0) -> None:
        super().commit(tick, now_s, step_s)
        if tick == self.last_tick:
            self.stage = BarrierState.EPOCH_OVER


class KeepsChairs(ServerCore):
    """Does not dismiss who has left, where no step follows."""

    def dismiss(self) -> None:
        if self.tick != self.last_tick or self.late() or not self.roster.members:
            super().dismiss()


class ShowsAnyFrame(ClientCore):
    """Takes a frame that it has had for the next one."""

    def _receive_frame(self, frame: m.Frame) -> list[Outcome]:
        if self.phase in (ClientPhase.THINK, ClientPhase.WAIT_TICK, ClientPhase.WAIT_SENSORS):
            return self._show(frame)
        return super()._receive_frame(frame)


class SaysNoCut(ClientCore):
    """Goes on in another chair without a word."""

    def _receive_welcome(self, welcome: m.Welcome) -> list[Outcome]:
        told = super()._receive_welcome(welcome)
        self._restart_reason = ""
        return told


class NeverAsksAgain(ClientCore):
    """Takes for granted that what it said was heard."""

    def clock(self, now_s: float) -> list[Outcome]:
        return []
