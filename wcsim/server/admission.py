"""Whether a client gets a seat, and which."""

from __future__ import annotations

from dataclasses import dataclass

from wcsim.errors import (
    ConfigMismatchError,
    EvictedError,
    ProtocolError,
    SeatTakenError,
    VersionMismatchError,
    WcsimError,
    WorldFullError,
)
from wcsim.server import messages as m
from wcsim.server.events import Rules
from wcsim.server.members import Roll

MOST_NAME = 100  # characters


@dataclass(frozen=True, slots=True, kw_only=True)
class Admission:
    """A seat for a client; `resumes` when the episode on it goes on."""

    seat: int
    resumes: bool


def admission(join: m.Join, rules: Rules, roll: Roll, now: tuple[int, int]) -> Admission | WcsimError:
    """The seat that a client gets at (epoch, tick) `now`, or the error that says why it gets none."""
    fault = _unfit(join, rules)
    if fault is not None:
        return fault
    if join.session in roll.retired:
        return EvictedError("this session is over; join again with another one")
    if join.seat == m.ANY_SEAT:
        own = roll.claimed(join.claim)
        return _free_seat(rules, roll) if own is None else _own_seat(join, own, roll, now)
    if not 0 <= join.seat < rules.capacity:
        return SeatTakenError(f"seat {join.seat} is not there; expected 0 to {rules.capacity - 1}")
    holder, waiting = roll.at(join.seat), roll.waiting_at(join.seat)
    for other in (holder, waiting):
        if other is not None and (other.session or other.claim) and other.claim != join.claim:
            return SeatTakenError(f"seat {join.seat} is {other.name}'s, with another claim; ask for a free one")
    return _own_seat(join, join.seat, roll, now)


def _own_seat(join: m.Join, seat: int, roll: Roll, now: tuple[int, int]) -> Admission:
    return Admission(seat=seat, resumes=roll.at(seat) is not None and _goes_on(join, now))


def _unfit(join: m.Join, rules: Rules) -> WcsimError | None:
    if (join.protocol, join.schema) != (m.PROTOCOL, m.schema_hash()):
        return VersionMismatchError(
            f"client speaks protocol {join.protocol}, schema {join.schema[:40]!r}, server {m.PROTOCOL}, "
            f"{m.schema_hash()!r}; install the same version of wcsim on both"
        )
    if len(join.session) != m.SESSION_BYTES:
        return VersionMismatchError(f"a session of {len(join.session)} bytes; expected {m.SESSION_BYTES}")
    if len(join.name) > MOST_NAME:
        return ProtocolError(f"a name of {len(join.name)} characters; expected {MOST_NAME} at most")
    if join.config and join.config != rules.config:
        return ConfigMismatchError(
            f"client expects a world of configuration {join.config[:64]!r}, this one is {rules.config!r}; "
            "use the server's configuration"
        )
    return None


def _free_seat(rules: Rules, roll: Roll) -> Admission | WcsimError:
    seat = roll.free_seat(rules.capacity)
    if seat is None:
        return WorldFullError(f"all {rules.capacity} seats are taken; wait until somebody leaves")
    return Admission(seat=seat, resumes=False)


def _goes_on(join: m.Join, now: tuple[int, int]) -> bool:
    """Whether the client has seen all that its seat has, but perhaps the frame of now."""
    epoch, tick = now
    return join.resume in ((epoch, tick), (epoch, tick - 1))
