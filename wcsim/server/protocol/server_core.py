"""The server without input and output: who gets a seat, what it answers, and what drives its cycle.

`handle(event, now_s)` takes an event and returns effects. There is no socket, clock, thread or
random number in here: a world process, a checker of all states and a simulator of faults run the
same code.

The server owns membership and the barrier. A tick is done when every member has acted; the
master's action is the tick request of the paper. Each request has its epoch, tick and life, so one
that comes twice or late has no effect. docs/protocol.md shows the states.
"""

from dataclasses import replace

from wcsim import errors
from wcsim.core.reading import escape
from wcsim.server.protocol import events as ev
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.barrier import TickBarrier
from wcsim.server.protocol.members import MOST_LIVES, ClientRoster, RosterClient
from wcsim.types import Joystick
from wcsim.types.bounds import MOST_STEPS
from wcsim.users.profiles import is_user_file_name, list_profile_names


class ServerCore(TickBarrier):
    """A server: the barrier, and what it receives and answers; see the module's text."""

    def handle(self, event: ev.Event, now_s: float) -> list[ev.Effect]:
        """Handle one event; returns its effects in their order. Time must not run backwards."""
        self.out = []
        if self.stage in (ev.BarrierState.EPOCH_OVER, ev.BarrierState.STOPPED):
            return []
        match event:
            case ev.MessageReceivedEvent():
                self._receive(event.peer, event.message, now_s)
            case ev.WorldSteppedEvent():
                self.commit(event.tick, now_s, event.step_s)
            case ev.ClientLostEvent():
                self._lose(event, now_s)
            case ev.TimePassedEvent():
                self.watch(now_s)
            case ev.StopServerEvent():
                self.stop(event.reason)
        return self.out

    # --- joining and leaving ---

    def _join(self, peer: ev.Peer, join: m.Join, now_s: float) -> None:
        roster = self.roster
        # 1. A session that is known gets the same answer again, through its new connection.
        member = roster.member(join.session)
        if member is not None:
            member.peer = peer
            member.progress_s = now_s
            self.send_welcome(member)
            return
        if roster.waiting(join.session) is not None:
            roster.pending = [
                replace(p, peer=peer) if p.session == join.session else p for p in roster.pending
            ]
            return
        # 2. Find a seat, or refuse.
        try:
            if roster.has_others(peer, join.claim):
                raise errors.SeatTakenError(
                    "this connection already has a seat; use one connection per client"
                )
            seat = _find_seat(join, self.rules, roster)
        except errors.WcsimError as error:
            self.send(peer, m.failure_from_error(error, join.session))
            return
        # 3. Let the client wait for the end of the tick. Those that have this seat, or wait for it,
        #    have the same claim: they are older processes of the client, and leave.
        older = (roster.waiting_at(seat), roster.at(seat))
        roster.pending.append(
            RosterClient(
                seat=seat,
                session=join.session,
                peer=peer,
                claim=join.claim,
                name=join.name,
                spec=join.spec,
            )
        )
        for member in older:
            if member is not None:
                self.evict(member, "its client restarted", now_s)
        if self.stage is ev.BarrierState.EMPTY:
            self.gather(now_s)

    def _lose(self, lost: ev.ClientLostEvent, now_s: float) -> None:
        roster, session = self.roster, lost.session
        roster.stop_waiting(session)
        member = roster.member(session)
        if not lost.may_return:
            if member is not None:
                self.evict(member, lost.reason, now_s)
            roster.retire(session)  # its join may still be on its way
        else:
            # The client may use another connection by now. So it gets to know that its session is
            # unknown, and joins again with a new one. Under the same session, frames of two chairs
            # could be on their way to it.
            roster.forget(session)
            if member is not None:
                self.remove(member, lost.reason, now_s)

    # --- requests of members ---

    def _receive(self, peer: ev.Peer, message: m.Request, now_s: float) -> None:
        if isinstance(message, m.Join):
            self._join(peer, message, now_s)
            return
        member = self.roster.member(message.session)
        if member is None:
            self._answer_stranger(peer, message)
            return
        member.peer = peer
        # A beat shows progress only with a higher counter: a client that hangs may still beat.
        if not isinstance(message, m.Beat) or message.progress > member.progress:
            member.progress_s = now_s
        try:
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
                    self.roster.retire(member.session)
                    self.remove(member, "left", now_s)
        except errors.WcsimError as error:
            self.send(peer, m.failure_from_error(error, member.session))

    def _answer_stranger(self, peer: ev.Peer, message: m.Request) -> None:
        roster, session = self.roster, message.session
        if isinstance(message, m.Leave):
            if roster.stop_waiting(session):
                roster.retire(session)
            elif session not in roster.retired:
                roster.forget(session)
            self.send(peer, m.Bye(session))
        elif roster.waiting(session) is None:
            error: errors.WcsimError = errors.StaleSessionError(
                f"the server of epoch {self.epoch} does not know this session; join again"
            )
            if session in roster.retired:
                error = errors.EvictedError(
                    "the server dropped this client, or it left; join again with a new session"
                )
            self.send(peer, m.failure_from_error(error, session))

    def _act(self, member: RosterClient, act: m.Act, now_s: float) -> None:
        if self._answer_old(member, act.epoch, act.tick, act.life):
            return
        if not (-1.0 <= act.x <= 1.0 and -1.0 <= act.y <= 1.0):
            raise errors.BadActionError(f"joystick ({act.x}, {act.y}): expected both from -1 to 1")
        action = Joystick(act.x, act.y)
        if member.action not in (None, action):
            raise errors.BadActionError(
                f"a different second action for tick {act.tick}; repeat the first one"
            )
        if member.respawning:
            raise errors.ProtocolError(
                f"an action for tick {act.tick}, but the seat waits for its respawn; wait for it"
            )
        if member.action is None:
            member.action = action
            self.advance(now_s)

    def _respawn(self, member: RosterClient, respawn: m.Respawn, now_s: float) -> None:
        if self._answer_old(member, respawn.epoch, respawn.tick, respawn.life):
            return
        if member.action is not None:
            raise errors.ProtocolError(
                f"a respawn at tick {respawn.tick}, but the seat has acted; "
                "wait for the end of the tick"
            )
        if member.respawning:
            return
        if member.life >= MOST_LIVES:
            raise errors.ProtocolError(
                f"respawn {member.life + 1} at tick {respawn.tick}; "
                f"expected at most {MOST_LIVES}: act first"
            )
        member.respawning = True
        member.earlier_lives_s += now_s - member.owes_since_s
        self.advance(now_s)

    def _rebuild(self, member: RosterClient, rebuild: m.Rebuild, now_s: float) -> None:
        # An older epoch: the world was rebuilt already, at a request of this client or before it.
        if rebuild.epoch < self.epoch:
            self._send_epoch(member)
            return
        if rebuild.seed < 0:
            raise errors.ProtocolError(f"a new world of seed {rebuild.seed}; expected 0 or more")
        if member is not self.roster.master:
            raise errors.NotMasterError(
                f"seat {member.seat} is not the master; "
                "only the master may restart the shared world"
            )
        if rebuild.epoch > self.epoch or self.stage is not ev.BarrierState.COLLECT:
            raise errors.ProtocolError(
                f"a new world was requested in stage {self.stage.value}; request it between ticks"
            )
        self.rebuild(rebuild.seed, now_s)

    def _answer_old(self, member: RosterClient, epoch: int, tick: int, life: int) -> bool:
        """Answer a request that came late or twice with the present frame.

        Returns whether it was one; False for a request about the present frame.
        """
        requested, now = (epoch, tick, life), (self.epoch, self.tick, member.life)
        if requested == now:
            return False
        if requested > now:
            raise errors.FutureTickError(
                f"a request for epoch, tick, life {requested}; the server is at {now}"
            )
        if epoch < self.epoch:
            self._send_epoch(member)
            return True
        if tick < self.tick - 1:
            raise errors.StaleTickError(
                f"tick {tick} of epoch {epoch} is long over; the server is at tick {self.tick}"
            )
        if tick < self.tick:
            self.send(member.peer, m.TickDone(self.epoch, self.tick, self._master_seat))
        self.send_frame(member)
        return True

    def _send_epoch(self, member: RosterClient) -> None:
        self.send(member.peer, m.Restarted(self.epoch, "the world was restarted"))
        self.send_frame(member)


def _find_seat(join: m.Join, rules: ev.ServerRules, roster: ClientRoster) -> int:
    """The seat that a client gets. Raises the error that says why it gets none."""
    _require_fit(join, rules)
    if join.session in roster.retired:
        raise errors.EvictedError("this session is over; join with a new one")
    if join.session in roster.forgotten:
        raise errors.StaleSessionError(
            "the server does not know this session any more; join with a new one"
        )
    if join.seat == m.ANY_SEAT:
        seat = roster.claimed_seat(join.claim)
        if seat is None:
            seat = roster.free_seat(rules.capacity)
        if seat is None:
            raise errors.WorldFullError(
                f"all {rules.capacity} seats are taken; wait until a client leaves"
            )
        return seat
    if not 0 <= join.seat < rules.capacity:
        raise errors.SeatTakenError(
            f"seat {join.seat} does not exist; expected 0 to {rules.capacity - 1}"
        )
    for other in (roster.at(join.seat), roster.waiting_at(join.seat)):
        if other is not None and (not join.claim or other.claim != join.claim):
            raise errors.SeatTakenError(
                f"seat {join.seat} belongs to {other.name}; choose a free one"
            )
    return join.seat


def _require_fit(join: m.Join, rules: ev.ServerRules) -> None:
    """Refuse another version, another configuration, and specs that no seat may have.

    That a start lies in the town is for the world to check.
    """
    if (join.protocol, join.schema) != (m.PROTOCOL, m.hash_message_schema()):
        raise errors.VersionMismatchError(
            f"the client has protocol {join.protocol}, schema {join.schema[:40]!r}; "
            f"the server has {m.PROTOCOL}, {m.hash_message_schema()!r}; "
            "install the same version of wcsim on both"
        )
    if join.config and join.config != rules.config:
        raise errors.ConfigMismatchError(
            f"the client expects a world with configuration {join.config[:64]!r}, "
            f"but this one has {rules.config!r}; use the server's configuration"
        )
    spec = join.spec
    is_recorded = is_user_file_name(spec.profile)
    if is_recorded and rules.recordings is not None and spec.profile not in rules.recordings:
        raise errors.ConfigError(
            "this world uses only the user files that it was started with; start it with --set "
            "env.profile=recorded:FILE (or FILE.toml), or choose one of wcsim's profiles"
        )
    if not is_recorded and spec.profile not in list_profile_names():
        known = ", ".join(list_profile_names())
        raise errors.ConfigError(
            f"unknown user profile {escape(spec.profile, 40)!r}; expected one of: {known}"
        )
    if spec.max_steps > MOST_STEPS:
        raise errors.ProtocolError(
            f"an episode of {spec.max_steps} steps; expected 1 to {MOST_STEPS}"
        )
