"""Who is in a world: members behind the barrier, those who wait for a seat, those whose chairs are still to go."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

from wcsim.server.protocol.events import Peer
from wcsim.types import Joystick, SeatSpec

REMEMBERED = 1024  # sessions that were given up or have left
MOST_LIVES = 1000  # respawns at one tick: each is work for the world, and a line in its journal


@dataclass(slots=True, kw_only=True)
class Member:
    """A client with a seat, or one that waits for it."""

    seat: int
    name: str
    spec: SeatSpec
    session: bytes
    peer: Peer
    claim: bytes = b""  # who shows another one does not get the seat
    life: int = 0  # respawns at the tick of now
    action: Joystick | None = None  # for the tick of now
    respawning: bool = False
    progress: int = -1
    heard_s: float = 0.0
    asked_s: float = 0.0  # since when it owes an action
    thought_s: float = 0.0  # how long it owed one in its lives before this one, at the tick of now

    @property
    def ready(self) -> bool:
        """Whether nothing is owed."""
        return self.action is not None or self.respawning


@dataclass(slots=True)
class Roster:
    """The lists, in the order of joining; no two entries share a seat, but a pending one may wait for one to go."""

    members: list[Member] = field(default_factory=list)
    pending: list[Member] = field(default_factory=list)  # replaced, never changed
    going: dict[int, str] = field(default_factory=dict)  # reason by seat
    retired: deque[bytes] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    forgotten: deque[bytes] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    """Sessions that were cut off, or left before they joined: so strangers cannot flush the list above."""

    def member(self, session: bytes) -> Member | None:
        """The member of this session."""
        return next((m for m in self.members if m.session == session), None)

    def at(self, seat: int) -> Member | None:
        """The member on this seat."""
        return next((m for m in self.members if m.seat == seat), None)

    def waiting(self, session: bytes) -> Member | None:
        """Who waits under this session."""
        return next((p for p in self.pending if p.session == session), None)

    def stop_waiting(self, session: bytes) -> bool:
        """Whether this session waited, which it does no more."""
        before, self.pending = self.pending, [p for p in self.pending if p.session != session]
        return len(self.pending) < len(before)

    def waiting_at(self, seat: int) -> Member | None:
        """Who waits for this seat."""
        return next((p for p in self.pending if p.seat == seat), None)

    def everyone(self) -> list[Member]:
        """Who is in, and who waits."""
        return [*self.members, *self.pending]

    def others_of(self, peer: Peer, claim: bytes) -> bool:
        """Whether somebody of another claim speaks through the same connection."""
        return any(
            entry.peer == peer and (not claim or entry.claim != claim) for entry in self.everyone()
        )

    def claimed(self, claim: bytes) -> int | None:
        """The seat that somebody with this claim has or waits for."""
        return next(
            (entry.seat for entry in self.everyone() if claim and entry.claim == claim), None
        )

    def free_seat(self, capacity: int) -> int | None:
        """The first seat that nobody has or waits for."""
        used = {entry.seat for entry in self.everyone()}
        return next((seat for seat in range(capacity) if seat not in used), None)

    def by_seat(self) -> list[Member]:
        """Members in seat order: what is done to all is done in this order, never in that of arrival."""
        return sorted(self.members, key=lambda m: m.seat)

    @property
    def master(self) -> Member | None:
        """The member of longest standing."""
        return self.members[0] if self.members else None

    def retire(self, session: bytes) -> None:
        """Remember a session that is over, so that its late messages are known as such."""
        if session and session not in self.retired:
            self.retired.append(session)

    def forget(self, session: bytes) -> None:
        """Remember a session that nobody is to know, so that a join of it that comes late finds nobody at home."""
        if session not in self.forgotten:
            self.forgotten.append(session)

    def copied(self) -> Roster:
        """A copy that shares nothing that changes."""
        return Roster(
            [replace(m) for m in self.members],
            list(self.pending),
            dict(self.going),
            self.retired.copy(),
            self.forgotten.copy(),
        )
