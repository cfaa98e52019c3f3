"""The server without input and output: who gets a seat, what it answers, and the cycle that messages drive.

`handle(event, now_s)` takes what happened and returns what is to be done. There is no socket, clock, thread or random
number in here: a world process, a checker of all states and a simulator of faults run the same code.

The server owns membership and the barrier. A tick is done when every member has acted; the master's action is the tick
request of the paper. Everything is said with its number, so that what comes twice or late does nothing twice.
docs/protocol.md shows the states.
"""

from __future__ import annotations

from dataclasses import replace

from wcsim.core.reading import escaped
from wcsim.errors import (
    BadActionError,
    ConfigError,
    ConfigMismatchError,
    EvictedError,
    FutureTickError,
    NotMasterError,
    ProtocolError,
    SeatTakenError,
    StaleSessionError,
    StaleTickError,
    VersionMismatchError,
    WcsimError,
    WorldFullError,
)
from wcsim.server.protocol import events as ev
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.barrier import Barrier
from wcsim.server.protocol.members import MOST_LIVES, Member, Roster
from wcsim.types import Joystick, SeatSpec
from wcsim.types.bounds import MOST_STEPS
from wcsim.users.profiles import is_user_file, profile_names


def _admission(join: m.Join, rules: ev.Rules, roll: Roster) -> int | WcsimError:
    """The seat that a client gets, or the error that says why it gets none."""
    fault = _unfit(join, rules)
    if fault is not None:
        return fault
    if join.session in roll.retired:
        return EvictedError("this session is over; join with a new one")
    if join.session in roll.forgotten:
        return StaleSessionError(
            "the server does not know this session any more; join with a new one"
        )
    if join.seat == m.ANY_SEAT:
        own = roll.claimed(join.claim)
        seat = roll.free_seat(rules.capacity) if own is None else own
        return (
            WorldFullError(f"all {rules.capacity} seats are taken; wait until a client leaves")
            if seat is None
            else seat
        )
    if not 0 <= join.seat < rules.capacity:
        return SeatTakenError(
            f"seat {join.seat} does not exist; expected 0 to {rules.capacity - 1}"
        )
    holder, waiting = roll.at(join.seat), roll.waiting_at(join.seat)
    for other in (holder, waiting):
        same = bool(join.claim) and other is not None and other.claim == join.claim
        if other is not None and not same:
            return SeatTakenError(f"seat {join.seat} belongs to {other.name}; choose a free one")
    return join.seat


def _unfit(join: m.Join, rules: ev.Rules) -> WcsimError | None:
    if (join.protocol, join.schema) != (m.PROTOCOL, m.schema_hash()):
        return VersionMismatchError(
            f"the client has protocol {join.protocol}, schema {join.schema[:40]!r}; the server has {m.PROTOCOL}, "
            f"{m.schema_hash()!r}; install the same version of wcsim on both"
        )
    if join.config and join.config != rules.config:
        return ConfigMismatchError(
            f"the client expects a world with configuration {join.config[:64]!r}, but this one has {rules.config!r}; "
            "use the server's configuration"
        )
    return _unfit_spec(join.spec, rules)


def _unfit_spec(spec: SeatSpec, rules: ev.Rules) -> WcsimError | None:
    """What is wrong with what a client asks for; that a start lies in the town is the world's to see."""
    named = is_user_file(spec.profile)
    if named and rules.recordings is not None and spec.profile not in rules.recordings:
        return ConfigError(
            "this world uses only the user files that it was started with; start it with --set "
            "env.profile=recorded:FILE (or FILE.toml), or choose one of wcsim's profiles"
        )
    if not named and spec.profile not in profile_names():
        known = ", ".join(profile_names())
        return ConfigError(
            f"unknown user profile {escaped(spec.profile, 40)!r}; expected one of: {known}"
        )
    if spec.max_steps > MOST_STEPS:
        return ProtocolError(f"an episode of {spec.max_steps} steps; expected 1 to {MOST_STEPS}")
    return None


class ServerCore(Barrier):
    """A server: the barrier, and what it hears and answers; see the module's text."""

    def handle(self, event: ev.Event, now_s: float) -> list[ev.Effect]:
        """Take in one event; returns what is to be done, in this order. Time must not run backwards."""
        self.out = []
        if self.stage in (ev.BarrierState.EPOCH_OVER, ev.BarrierState.STOPPED):
            return []
        match event:
            case ev.Received():
                self._receive(event.peer, event.message, now_s)
            case ev.Stepped():
                self.commit(event.tick, now_s, event.step_s)
            case ev.Lost():
                self._lose(event, now_s)
            case ev.Clock():
                self.watch(now_s)
            case ev.Stop():
                self.stop(event.reason)
        return self.out

    # --- coming and going ---

    def _join(self, peer: ev.Peer, join: m.Join, now_s: float) -> None:
        roll = self.roll
        known = roll.member(join.session)
        if known is not None:
            known.peer, known.heard_s = peer, now_s
            self.welcome(known)
            return
        if roll.waiting(join.session) is not None:
            roll.pending = [
                replace(p, peer=peer) if p.session == join.session else p for p in roll.pending
            ]
            return
        if roll.others_of(peer, join.claim):
            error = SeatTakenError(
                "this connection already has a seat; use one connection per client"
            )
            self.send(peer, m.failure_of(error, join.session))
            return
        found = _admission(join, self.rules, roll)
        if isinstance(found, int):
            self._let_in(peer, join, found, now_s)
        else:
            self.send(peer, m.failure_of(found, join.session))

    def _let_in(self, peer: ev.Peer, join: m.Join, seat: int, now_s: float) -> None:
        """Into the row of those who wait; an older life of the client goes."""
        roll = self.roll
        # Who has this seat, or waits for it, has the same claim.
        older = (roll.waiting_at(seat), roll.at(seat))
        waiting = Member(
            seat=seat,
            session=join.session,
            peer=peer,
            claim=join.claim,
            name=join.name,
            spec=join.spec,
        )
        roll.pending.append(waiting)
        for one in older:
            if one is not None:
                self.evict(one, "its client restarted", now_s)
        if self.stage is ev.BarrierState.EMPTY:
            self.gather(now_s)

    def _lose(self, lost: ev.Lost, now_s: float) -> None:
        roll, session = self.roll, lost.session
        roll.stop_waiting(session)
        member = roll.member(session)
        if not lost.may_return:
            if member is not None:
                self.evict(member, lost.reason, now_s)
            roll.retire(session)  # its join may still be on its way
        else:
            # It may have spoken through another connection since: so it hears that it is not known, and joins again,
            # but with a new session. Frames of two chairs could else be on their way to it under the same one.
            roll.forget(session)
            if member is not None:
                self.remove(member, lost.reason, now_s)

    # --- what members say ---

    def _receive(self, peer: ev.Peer, message: m.Request, now_s: float) -> None:
        if isinstance(message, m.Join):
            self._join(peer, message, now_s)
            return
        member = self.roll.member(message.session)
        if member is None:
            self._answer_stranger(peer, message)
            return
        member.peer = peer
        if not isinstance(message, m.Beat) or message.progress > member.progress:
            member.heard_s = now_s
        try:
            self._obey(member, message, now_s)
        except WcsimError as error:
            self.send(peer, m.failure_of(error, member.session))

    def _obey(self, member: Member, message: m.Request, now_s: float) -> None:
        match message:
            case m.Act():
                self._act(member, message, now_s)
            case m.Respawn():
                self._respawn(member, message, now_s)
            case m.Rebuild():
                self._rebuild(member, message, now_s)
            case m.Beat():
                member.progress = max(member.progress, message.progress)
            case m.Leave():
                self.send(member.peer, m.Bye(member.session))
                self.roll.retire(member.session)
                self.remove(member, "left", now_s)

    def _answer_stranger(self, peer: ev.Peer, message: m.Request) -> None:
        roll, session = self.roll, message.session
        if isinstance(message, m.Leave):
            if roll.stop_waiting(session):
                roll.retire(session)
            elif session not in roll.retired:
                roll.forget(session)
            self.send(peer, m.Bye(session))
        elif roll.waiting(session) is None:
            error: WcsimError = StaleSessionError(
                f"the server of epoch {self.epoch} does not know this session; join again"
            )
            if session in roll.retired:
                error = EvictedError(
                    "the server dropped this client, or it left; join again with a new session"
                )
            self.send(peer, m.failure_of(error, session))

    def _act(self, member: Member, act: m.Act, now_s: float) -> None:
        if not self._is_now(member, act.epoch, act.tick, act.life):
            return
        if not (-1.0 <= act.x <= 1.0 and -1.0 <= act.y <= 1.0):
            raise BadActionError(f"joystick ({act.x}, {act.y}): expected both from -1 to 1")
        action = Joystick(act.x, act.y)
        if member.action not in (None, action):
            raise BadActionError(
                f"a different second action for tick {act.tick}; repeat the first one"
            )
        if member.respawning:
            raise ProtocolError(
                f"an action for tick {act.tick}, but the seat waits for its respawn; wait for it"
            )
        if member.action is None:
            member.action = action
            self.advance(now_s)

    def _respawn(self, member: Member, respawn: m.Respawn, now_s: float) -> None:
        if not self._is_now(member, respawn.epoch, respawn.tick, respawn.life):
            return
        if member.action is not None:
            raise ProtocolError(
                f"a respawn at tick {respawn.tick}, but the seat has acted; wait for the end of the tick"
            )
        if not member.respawning:
            if member.life >= MOST_LIVES:
                raise ProtocolError(
                    f"respawn {member.life + 1} at tick {respawn.tick}; expected at most {MOST_LIVES}: act first"
                )
            member.respawning = True
            member.thought_s += now_s - member.asked_s
            self.advance(now_s)

    def _rebuild(self, member: Member, rebuild: m.Rebuild, now_s: float) -> None:
        if rebuild.epoch < self.epoch:
            self._tell_of_epoch(member)  # it was done, by this client or before it asked
        elif rebuild.seed < 0:
            raise ProtocolError(f"a new world of seed {rebuild.seed}; expected 0 or more")
        elif member is not self.roll.master:
            raise NotMasterError(
                f"seat {member.seat} is not the master; only the master may restart the shared world"
            )
        elif rebuild.epoch > self.epoch or self.stage is not ev.BarrierState.COLLECT:
            raise ProtocolError(
                f"a new world was requested in stage {self.stage.value}; request it between ticks"
            )
        else:
            self.rebuild(rebuild.seed, now_s)

    def _is_now(self, member: Member, epoch: int, tick: int, life: int) -> bool:
        """Whether a request is about what the seat sees now; one that came late or twice is answered with just that."""
        asked, now = (epoch, tick, life), (self.epoch, self.tick, member.life)
        if asked == now:
            return True
        if asked > now:
            raise FutureTickError(
                f"a request for epoch, tick, life {asked}; the server is at {now}"
            )
        if epoch < self.epoch:
            self._tell_of_epoch(member)
            return False
        if tick < self.tick - 1:
            raise StaleTickError(
                f"tick {tick} of epoch {epoch} is long over; the server is at tick {self.tick}"
            )
        if tick < self.tick:
            self.send(member.peer, m.TickDone(self.epoch, self.tick, self._master_seat))
        self.show(member)
        return False

    def _tell_of_epoch(self, member: Member) -> None:
        self.send(member.peer, m.Restarted(self.epoch, "the world was restarted"))
        self.show(member)
