"""The clients of a world: members, those who wait for a seat, and those whose chairs are to go."""

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Final, Self

from wcsim.server.protocol.events import Peer
from wcsim.types import Joystick, SeatSpec

REMEMBERED: Final = 1024  # sessions that were evicted or have left
MOST_LIVES: Final = 1000  # respawns at one tick: each is work for the world, and a journal record


@dataclass(slots=True, kw_only=True)
class RosterClient:
    """A client with a seat, or one that waits for it."""

    seat: int
    name: str
    spec: SeatSpec
    session: bytes
    peer: Peer
    claim: bytes = b""  # a client with another claim does not get the seat
    life: int = 0  # respawns at this tick
    action: Joystick | None = None  # for this tick
    respawning: bool = False
    progress: int = -1
    progress_s: float = 0.0  # when it last showed progress
    owes_since_s: float = 0.0  # since when it owes an action
    earlier_lives_s: float = 0.0  # how long it has owed one at this tick before its last respawn

    @property
    def ready(self) -> bool:
        """Whether nothing is owed."""
        return self.action is not None or self.respawning


@dataclass(slots=True)
class ClientRoster:
    """The lists of clients, in the order of joining.

    No two entries share a seat, except that a pending one may wait for an older member to go.
    """

    members: list[RosterClient] = field(default_factory=list)
    pending: list[RosterClient] = field(default_factory=list)  # replaced, never changed
    going: dict[int, str] = field(default_factory=dict)  # reason by seat
    retired: deque[bytes] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    forgotten: deque[bytes] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    """Sessions that were cut off, or left unjoined. So strangers cannot flush `retired`."""

    def member(self, session: bytes) -> RosterClient | None:
        """The member of this session."""
        return {p.session: p for p in self.members}.get(session)

    def at(self, seat: int) -> RosterClient | None:
        """The member on this seat."""
        return {p.seat: p for p in self.members}.get(seat)

    def waiting(self, session: bytes) -> RosterClient | None:
        """The pending client of this session."""
        return {p.session: p for p in self.pending}.get(session)

    def waiting_at(self, seat: int) -> RosterClient | None:
        """The client that waits for this seat."""
        return {p.seat: p for p in self.pending}.get(seat)

    def stop_waiting(self, session: bytes) -> bool:
        """Remove a session from those that wait; returns whether it waited."""
        before = len(self.pending)
        self.pending = [p for p in self.pending if p.session != session]
        return len(self.pending) < before

    def everyone(self) -> list[RosterClient]:
        """Members, then those who wait."""
        return [*self.members, *self.pending]

    def has_others(self, peer: Peer, claim: bytes) -> bool:
        """Whether a client of another claim uses the same connection."""
        same_peer = [p for p in self.everyone() if p.peer == peer]
        return any(not claim or p.claim != claim for p in same_peer)

    def claimed_seat(self, claim: bytes) -> int | None:
        """The seat that a client with this claim has or waits for."""
        for p in self.everyone():
            if claim and p.claim == claim:
                return p.seat
        return None

    def free_seat(self, capacity: int) -> int | None:
        """The lowest seat that no client has or waits for."""
        free = set(range(capacity)) - {p.seat for p in self.everyone()}
        return min(free, default=None)

    def by_seat(self) -> list[RosterClient]:
        """Members in seat order.

        What is done to all is done in this order, never in that of arrival.
        """
        return sorted(self.members, key=lambda p: p.seat)

    @property
    def master(self) -> RosterClient | None:
        """The member that joined first."""
        return self.members[0] if self.members else None

    def retire(self, session: bytes) -> None:
        """Remember a session that is over, so that its late messages are known as such."""
        if session and session not in self.retired:
            self.retired.append(session)

    def forget(self, session: bytes) -> None:
        """Remember a session whose late join must not succeed."""
        if session not in self.forgotten:
            self.forgotten.append(session)

    def copied(self) -> Self:
        """A copy that shares nothing that changes."""
        return type(self)(
            [replace(p) for p in self.members],
            list(self.pending),
            dict(self.going),
            self.retired.copy(),
            self.forgotten.copy(),
        )
