"""Whether a client gets a seat, and which."""

from __future__ import annotations

import re
from dataclasses import dataclass

from wcsim.core.reading import escaped
from wcsim.errors import (
    ConfigError,
    ConfigMismatchError,
    EvictedError,
    ProtocolError,
    SeatTakenError,
    VersionMismatchError,
    WcsimError,
    WorldFullError,
)
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.bounds import MOST_METRES, MOST_STEPS
from wcsim.server.protocol.events import Rules
from wcsim.server.protocol.members import Roster
from wcsim.types import CLIENT_NAME, SeatSpec
from wcsim.users.profiles import is_of_file, profile_names

_NAME = re.compile(CLIENT_NAME)


@dataclass(frozen=True, slots=True, kw_only=True)
class Admission:
    """A seat for a client; `resumes` when the episode on it goes on."""

    seat: int
    resumes: bool


def admission(join: m.Join, rules: Rules, roll: Roster, now: tuple[int, int]) -> Admission | WcsimError:
    """The seat that a client gets at (epoch, tick) `now`, or the error that says why it gets none."""
    fault = _unfit(join, rules)
    if fault is not None:
        return fault
    if roll.is_over(join.session):
        return EvictedError("this session is over; join with a new one")
    if join.seat == m.ANY_SEAT:
        own = roll.claimed(join.claim)
        return _free_seat(rules, roll) if own is None else _own_seat(join, own, roll, now)
    if not 0 <= join.seat < rules.capacity:
        return SeatTakenError(f"seat {join.seat} does not exist; expected 0 to {rules.capacity - 1}")
    holder, waiting = roll.at(join.seat), roll.waiting_at(join.seat)
    for other in (holder, waiting):
        same = bool(join.claim) and other is not None and other.claim == join.claim
        if other is not None and (other.session or other.claim) and not same:
            return SeatTakenError(f"seat {join.seat} belongs to {other.name}; choose a free one")
    return _own_seat(join, join.seat, roll, now)


def _own_seat(join: m.Join, seat: int, roll: Roster, now: tuple[int, int]) -> Admission:
    return Admission(seat=seat, resumes=roll.at(seat) is not None and _goes_on(join, now))


def _unfit(join: m.Join, rules: Rules) -> WcsimError | None:
    if (join.protocol, join.schema) != (m.PROTOCOL, m.schema_hash()):
        return VersionMismatchError(
            f"the client has protocol {join.protocol}, schema {join.schema[:40]!r}; the server has {m.PROTOCOL}, "
            f"{m.schema_hash()!r}; install the same version of wcsim on both"
        )
    if len(join.session) != m.SESSION_BYTES:
        return VersionMismatchError(f"a session of {len(join.session)} bytes; expected {m.SESSION_BYTES}")
    if not _NAME.fullmatch(join.name):
        return ProtocolError(
            f"name {escaped(join.name, 40)!r}: expected 1 to 64 letters, digits, '-', '_' or '.', and no '.' at the "
            "start"
        )
    if join.config and join.config != rules.config:
        return ConfigMismatchError(
            f"the client expects a world with configuration {join.config[:64]!r}, but this one has {rules.config!r}; "
            "use the server's configuration"
        )
    return _unfit_spec(join.spec, rules)


def _unfit_spec(spec: SeatSpec, rules: Rules) -> WcsimError | None:
    """What is wrong with what a client asks for; that a start lies in the town is the world's to see."""
    named = is_of_file(spec.profile)
    if named and rules.recordings is not None and spec.profile not in rules.recordings:
        return ConfigError(
            "this world uses only the user files that it was started with; start it with --set "
            "env.profile=recorded:FILE (or FILE.toml), or choose one of wcsim's profiles"
        )
    if not named and spec.profile not in profile_names():
        known = ", ".join(profile_names())
        return ConfigError(f"unknown user profile {escaped(spec.profile, 40)!r}; expected one of: {known}")
    if not 1 <= spec.max_steps <= MOST_STEPS:
        return ProtocolError(f"an episode of {spec.max_steps} steps; expected 1 to {MOST_STEPS}")
    start = spec.start
    numbers = () if start is None else (*start.p_W_m, start.yaw_rad, *start.goal_W_m)
    if not all(abs(number) <= MOST_METRES for number in numbers):  # false for what is no number, too
        return ProtocolError(
            "the start has a number that is not finite, or lies far outside the town; expected a place in the town"
        )
    return None


def _free_seat(rules: Rules, roll: Roster) -> Admission | WcsimError:
    seat = roll.free_seat(rules.capacity)
    if seat is None:
        return WorldFullError(f"all {rules.capacity} seats are taken; wait until a client leaves")
    return Admission(seat=seat, resumes=False)


def _goes_on(join: m.Join, now: tuple[int, int]) -> bool:
    """Whether the client has seen all that its seat has, but perhaps the frame of now."""
    epoch, tick = now
    return join.resume in ((epoch, tick), (epoch, tick - 1))
