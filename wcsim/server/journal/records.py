"""What a journal tells of a world, record by record, and each record as bytes.

A payload is a JSON line, and for a tick the joystick positions after it as little-endian float64.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from wcsim.core.reading import MOST_JSON_BYTES
from wcsim.errors import WcsimError
from wcsim.server.protocol.bounds import MAX_SEED, MOST_SEATS
from wcsim.types import Command, Joystick, SeatSpec

MAGIC = "wcsim-journal"
VERSION = 2  # of new journals
_CHAINED = 2  # the first version in which each record's CRC begins with that of the one before
_CONTENT = 1  # of what the digest is over
_TICK = b'["t",'


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalHeader:
    """What the world of a journal is made from; `fingerprint` names the versions that its exact hashes hold for."""

    name: str  # of the run
    town: str  # what `find_town` takes
    town_sha256: str  # see `towns_hash`
    config: str  # resolved, as JSON
    seed: int  # the root of all epochs' seeds
    capacity: int  # seats, taken or free
    tick_s: float
    fingerprint: str
    hook: str = ""  # the user's own step hook, module:Class
    more_towns: tuple[str, ...] = ()  # that take turns with it, an epoch each
    recovery: str = "new_epoch"  # what a server does with the journal after a crash


@dataclass(frozen=True, slots=True, kw_only=True)
class EpochBegun:
    """The world began (again); the seats that are taken stay so, unless it is a `fresh` world, where all are free."""

    epoch: int
    seed: int
    fresh: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Admitted:
    """A client took a seat at this tick."""

    epoch: int
    tick: int
    seat: int
    spec: SeatSpec
    name: str = ""
    claim: str = ""  # see `hub.sealed`; hexadecimal


@dataclass(frozen=True, slots=True, kw_only=True)
class Dismissed:
    """A seat became free at this tick."""

    epoch: int
    tick: int
    seat: int
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Respawned:
    """A seat's next episode began at this tick, without one."""

    epoch: int
    tick: int
    seat: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Ticked:
    """The world reached `tick` by these commands (of tick - 1), one for each taken seat."""

    epoch: int
    tick: int
    commands: tuple[Command, ...]
    state_hash: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """The server ended in good order."""

    reason: str = ""


JournalRecord = EpochBegun | Admitted | Dismissed | Respawned | Ticked | Ended

_LETTERS: dict[type, str] = {EpochBegun: "e", Admitted: "a", Dismissed: "d", Respawned: "r", Ended: "z"}
_KINDS = {letter: kind for kind, letter in _LETTERS.items()}


def header_bytes(header: JournalHeader) -> bytes:
    """A header as a payload."""
    return msgspec.json.encode({"magic": MAGIC, "version": VERSION, **msgspec.to_builtins(header)})


def header_content(header: JournalHeader) -> bytes:
    """What two equal runs have in common, for the digest: neither names, nor places, nor this machine's versions."""
    same = {"town_sha256", "config", "seed", "capacity", "tick_s", "hook", "recovery"}
    kept = {key: value for key, value in msgspec.to_builtins(header).items() if key in same}
    return msgspec.json.encode({"version": _CONTENT, **kept})


def header_of(payload: bytes) -> JournalHeader:
    """A payload as a header. Raises WcsimError when it is none of a known version."""
    try:
        head = msgspec.json.decode(_bounded(payload), type=dict[str, Any])
        magic, version = head.pop("magic", None), head.pop("version", None)
        if magic != MAGIC or type(version) is not int or not 1 <= version <= VERSION:
            raise WcsimError(f"got magic {magic!r}, version {version!r}; expected {MAGIC!r}, 1 to {VERSION}")
        return _sane(msgspec.convert(head, JournalHeader))
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise WcsimError(f"the first record is not a header: {error}") from None


def is_chained(payload: bytes) -> bool:
    """Whether the records of a journal with this sound header are chained, see `users/recording/framing.py`."""
    return int(msgspec.json.decode(payload, type=dict[str, Any])["version"]) >= _CHAINED


def _bounded(line: bytes) -> bytes:
    """Refuse JSON that would fill the memory once it is read. Raises WcsimError."""
    if len(line) > MOST_JSON_BYTES:
        raise WcsimError(f"got {len(line)} bytes of JSON; expected at most {MOST_JSON_BYTES}")
    return line


def _sane(header: JournalHeader) -> JournalHeader:
    """Refuse what would make a world of it boundless. Raises WcsimError."""
    sane = 1 <= header.capacity <= MOST_SEATS and 0 <= header.seed <= MAX_SEED and 1e-3 <= header.tick_s <= 10.0
    if not sane:
        got = f"capacity {header.capacity}, seed {header.seed}, tick_s {header.tick_s}"
        raise WcsimError(f"{got}; expected 1 to {MOST_SEATS} seats, a seed of 63 bits and 0.001 to 10 s")
    return header


def record_bytes(record: JournalRecord) -> bytes:
    """A record as a payload."""
    if isinstance(record, Ticked):
        seats = [command.seat for command in record.commands]
        sticks = [(command.joystick.x, command.joystick.y) for command in record.commands]
        line = msgspec.json.encode(["t", record.epoch, record.tick, record.state_hash, seats])
        return line + b"\n" + np.array(sticks, "<f8").tobytes()
    return msgspec.json.encode([_LETTERS[type(record)], msgspec.to_builtins(record)])


def told_apart(record: JournalRecord) -> JournalRecord:
    """A record without what may differ between equal runs: names, reasons, claims."""
    if isinstance(record, Admitted):
        return replace(record, name="", claim="")
    return replace(record, reason="") if isinstance(record, Dismissed | Ended) else record


def is_tick(payload: bytes) -> bool:
    """Whether a payload is that of a tick."""
    return payload.startswith(_TICK)


def record_of(payload: bytes) -> JournalRecord:
    """A payload as a record. Raises WcsimError when it is none."""
    try:
        if is_tick(payload):
            return _ticked(payload)
        letter, fields = msgspec.json.decode(_bounded(payload), type=tuple[str, dict[str, Any]])
        kind = _KINDS.get(letter)
        if kind is None:
            raise WcsimError(f"a record is of kind {letter!r}; expected one of t, {', '.join(_KINDS)}")
        record: JournalRecord = msgspec.convert(fields, kind)
        return record
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise WcsimError(f"a record does not belong in a journal: {error}") from None


def _ticked(payload: bytes) -> Ticked:
    line, _, raw = payload.partition(b"\n")
    told = msgspec.json.decode(_bounded(line), type=tuple[str, int, int, str, tuple[int, ...]])
    _, epoch, tick, state_hash, seats = told
    if len(raw) != 16 * len(seats):
        raise WcsimError(f"tick {tick} has {len(raw)} bytes of commands for {len(seats)} seats; expected 16 each")
    sticks = np.frombuffer(raw, "<f8").reshape(-1, 2).tolist()
    commands = tuple(
        Command(seat=seat, tick=tick - 1, joystick=Joystick(x, y)) for seat, (x, y) in zip(seats, sticks, strict=True)
    )
    return Ticked(epoch=epoch, tick=tick, commands=commands, state_hash=state_hash)
