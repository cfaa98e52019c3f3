"""The real cores as numbered states: what a core does in a state is computed once, times are left out.

All times are 0 after every event. Time passes by events of its own, in which the clock jumps for those concerned.
"""

from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any

from tests.server.model.scope import Scope
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import ClientCore, JoinSettings, Outcome, Patience
from wcsim.server.protocol.events import Effect, Event, ServerRules, TimePassedEvent
from wcsim.server.protocol.server_core import ServerCore
from wcsim.types import SeatSpec

PATIENCE = Patience(resend_s=2.0, reconnect_s=900.0, tick_s=9000.0)
LATER_S = 200.0  # beyond every lease of `rules`
SPEC = SeatSpec()


def rules(scope: Scope) -> ServerRules:
    """Leases that the clock's jumps tell apart."""
    return ServerRules(
        capacity=scope.capacity,
        expected=scope.expected,
        gather_s=20.0,
        lease_s=100.0,
        notice_s=1.0,
    )


def session_name(client: int, number: int) -> bytes:
    """The session that a client draws as its `number`-th."""
    return bytes([client, number]).ljust(m.SESSION_BYTES, b"s")


class Servers:
    """All states that a server core was in."""

    def __init__(self, scope: Scope) -> None:
        self._scope = scope
        self.cores: list[ServerCore] = []
        self._ids: dict[Hashable, int] = {}
        self._done: dict[Hashable, tuple[int, tuple[Effect, ...]]] = {}

    def new(self, epoch: int, expected: int) -> int:
        """A server that has just begun."""
        core = self._scope.server(replace(rules(self._scope), expected=expected), epoch)
        core.last_tick = self._scope.ends_at if epoch == 0 else None
        return self._number(core)

    def handle(self, state: int, event: Event) -> tuple[int, tuple[Effect, ...]]:
        """What follows from an event, at once."""
        return self._memo((state, event), state, lambda core: core.handle(event, 0.0))

    def overdue(self, state: int, seat: int) -> tuple[int, tuple[Effect, ...]]:
        """The lease of one seat ends; all others are heard of in time."""

        def pass_time(core: ServerCore) -> list[Effect]:
            for mate in core.roster.members:
                mate.progress_s = mate.owes_since_s = 0.0 if mate.seat == seat else LATER_S
            core._last_notice_s = LATER_S
            return core.handle(TimePassedEvent(), LATER_S)

        return self._memo((state, "overdue", seat), state, pass_time)

    def gathered(self, state: int) -> tuple[int, tuple[Effect, ...]]:
        """The time for gathering is over."""

        def pass_time(core: ServerCore) -> list[Effect]:
            core._last_notice_s = 30.0
            return core.handle(TimePassedEvent(), 30.0)

        return self._memo((state, "gather"), state, pass_time)

    def _memo(
        self, key: Hashable, state: int, act: Callable[[ServerCore], list[Effect]]
    ) -> tuple[int, tuple[Effect, ...]]:
        found = self._done.get(key)
        if found is None:
            core = self.cores[state].copied()
            effects = tuple(effect for effect in act(core) if not _is_note(effect))
            found = self._done[key] = (self._number(core), effects)
        return found

    def _number(self, core: ServerCore) -> int:
        _timeless(core)
        key = (
            core.stage,
            core.epoch,
            core.tick,
            core.gathering,
            core.rules.expected,
            core._gather_since_s is None,
            tuple((x.seat, x.session, x.peer, x.claim) for x in core.roster.members),
            tuple((x.life, x.action, x.respawning) for x in core.roster.members),
            tuple((p.seat, p.session, p.peer, p.claim) for p in core.roster.pending),
            tuple(sorted(core.roster.going)),
            tuple(sorted(set(core.roster.retired))),
            tuple(sorted(set(core.roster.forgotten))),
        )
        return _number_of(key, core, self._ids, self.cores)


def _number_of(key: Hashable, core: Any, ids: dict[Hashable, int], cores: list[Any]) -> int:
    """The number of a core with this key; one that is new is kept."""
    number = ids.setdefault(key, len(cores))
    if number == len(cores):
        cores.append(core)
    return number


def _is_note(effect: Effect) -> bool:
    return isinstance(getattr(effect, "message", None), m.Waiting)


def _timeless(core: ServerCore) -> None:
    core._last_notice_s = 0.0
    core._gather_since_s = None if core._gather_since_s is None else 0.0
    for mate in core.roster.members:
        mate.progress_s = mate.owes_since_s = 0.0


class Clients:
    """All states that the core of one client was in."""

    def __init__(self, scope: Scope, client: int) -> None:
        self._make, self.client = scope.client, client
        seat = m.ANY_SEAT if scope.any_seat else client % scope.capacity
        self._ask = JoinSettings(claim=bytes([client]), name=f"c{client}", spec=SPEC, seat=seat)
        self.cores: list[ClientCore] = []
        self._ids: dict[Hashable, int] = {}
        self._done: dict[Hashable, tuple[int, tuple[Outcome, ...], int]] = {}

    def new(self) -> int:
        """A client that is off."""
        return self._number(self._make(self._ask, PATIENCE, lambda: b""))

    def do(
        self, state: int, drawn: int, key: Hashable, act: Callable[[ClientCore], list[Outcome]]
    ) -> tuple[int, tuple[Outcome, ...], int]:
        """What follows when a client does something or hears a message; with the sessions drawn so far."""
        found = self._done.get((state, drawn, key))
        if found is None:
            core, draws = self.cores[state].copied(), [drawn]

            def draw() -> bytes:
                draws[0] += 1
                return session_name(self.client, draws[0])

            core._new_session = draw
            outcomes = tuple(act(core))
            found = self._done[(state, drawn, key)] = (self._number(core), outcomes, draws[0])
        return found

    def _number(self, core: ClientCore) -> int:
        core._reply_s = core._sent_s = core._request_s = 0.0
        core.late = ()
        core._restart_reason = "yes" if core._restart_reason else ""
        place = (core.phase, core.session, core.seat, core.epoch, core.tick, core.life, core.master)
        key = (*place, core.pending, core._restart_reason, core._done_tick)
        return _number_of(key, core, self._ids, self.cores)
