"""The first difference between two logs, in words; and between a new trace and a golden one."""

from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.errors import WcsimError
from wcsim.log.reader import iter_log, read_header, read_trace_states
from wcsim.log.records import (
    LogRecord,
    Ticked,
    WorldState,
    record_to_bytes,
    strip_uncompared_fields,
)

# Equal runs may have other names, other folders and other versions.
_COMPARED: Final = (
    "town_sha256",
    "config",
    "seed",
    "seats",
    "tick_s",
    "hook",
    "origin_m",
    "origin_z_m",
)
# Contacts amplify the last bit, so that the positions of two versions drift apart.
_EARLY_S: Final = 1.0
_EARLY_M: Final = 0.001
_LATER_M: Final = 0.05


def find_log_difference(one: Path, other: Path) -> str:
    """The first difference between two logs, to the last bit; "" when they are equal.

    Raises WcsimError when one is no log, or they are of two kinds.
    """
    # 1. The headers.
    head, other_head = read_header(one), read_header(other)
    if head.kind != other_head.kind:
        raise WcsimError(
            f"{one} is a {head.kind} and {other} a {other_head.kind}; expected two of a kind"
        )
    for name in _COMPARED:
        a, b = getattr(head, name), getattr(other_head, name)
        if a != b:
            return f"header: {name} is {_short(a)} and {_short(b)}"
    # 2. The records, one by one.
    place = "before the first record"
    for record, other_record in zip_longest(iter_log(one), iter_log(other)):
        if record is None or other_record is None:
            ended, rest = (one, other_record) if record is None else (other, record)
            return f"{ended} ends {place}; the other one continues with {_label(rest)}"
        difference = _record_difference(
            strip_uncompared_fields(record), strip_uncompared_fields(other_record)
        )
        if difference:
            return difference
        place = f"after {_label(record)}"
    return ""


def find_golden_difference(trace: Path, golden: Path) -> str:
    """The first difference between two traces, "" when they agree.

    Hashes are compared exactly when both were made by the same versions; otherwise positions, to
    1 mm over the first second and 5 cm later.
    """
    (head, ticks), (golden_head, golden_ticks) = read_trace_states(trace), read_trace_states(golden)
    exact = head.fingerprint == golden_head.fingerprint
    if [new.tick for new in ticks] != [old.tick for old in golden_ticks]:
        return (
            f"its records are {_extent(ticks)}, those of the golden trace {_extent(golden_ticks)}"
        )
    for new, old in zip(ticks, golden_ticks, strict=True):
        tolerance_m = _EARLY_M if new.tick * head.tick_s <= _EARLY_S else _LATER_M
        difference = _golden_tick_difference(new, old, exact, tolerance_m)
        if difference:
            return f"tick {new.tick}: {difference}"
    return ""


def explain_hash_mismatch(trace: Path, golden: Path) -> str:
    """Why a trace was compared with its golden one by positions alone; "" when all hashes agree."""
    (head, ticks), (golden_head, golden_ticks) = read_trace_states(trace), read_trace_states(golden)
    if [new.state_hash for new in ticks] == [old.state_hash for old in golden_ticks]:
        return ""
    here = head.fingerprint.split()
    others = ", ".join(word for word in golden_head.fingerprint.split() if word not in here)
    return f"positions agree, hashes do not: the golden trace is of {others}"


def _record_difference(a: LogRecord, b: LogRecord) -> str:
    label = _label(a)
    if type(a) is not type(b) or label != _label(b):
        return f"{label} against {_label(b)}"
    if isinstance(a, WorldState) and isinstance(b, WorldState):
        difference = _state_difference(a, b)
        return f"{label}: {difference}" if difference else ""
    if record_to_bytes(a) == record_to_bytes(b):
        return ""
    if isinstance(a, Ticked) and isinstance(b, Ticked):
        if a.seats != b.seats:
            return f"{label}: commands for seats {list(a.seats)} and {list(b.seats)}"
        for seat, one, other in zip(a.seats, a.sticks, b.sticks, strict=True):
            if one != other:
                return f"{label}: seat {seat} is commanded {one} and {other}"
    for name in a.__struct_fields__:
        one, other = getattr(a, name), getattr(b, name)
        if not np.array_equal(one, other):
            return f"{label}: {name} is {_short(one)} and {_short(other)}"
    # The bytes differ where no value does.
    return f"{label}:  is '-0.0' and '0.0'"


def _state_difference(a: WorldState, b: WorldState) -> str:
    if len(a.commands) != len(b.commands) or a.seats != b.seats:
        return (
            f"{len(a.commands)} commands (seats {list(a.seats)}) and {len(b.commands)} "
            f"(seats {list(b.seats)})"
        )
    seats = a.seats or range(len(a.commands))
    for seat, one, other in zip(seats, a.commands, b.commands, strict=True):
        if one.tobytes() != other.tobytes():
            return f"seat {seat} is commanded {tuple(one.tolist())} and {tuple(other.tolist())}"
    if a.actor_ids != b.actor_ids:
        return _actors_difference(a, b)
    for what, names, rows, others in (
        ("actor", a.actor_ids, a.actors, b.actors),
        ("seat", a.seats or range(len(a.plants)), a.plants, b.plants),
    ):
        for name, one, other in zip(names, rows, others, strict=True):
            if one.tobytes() != other.tobytes():
                gap_m = float(np.abs(one[:3] - other[:3]).max())
                how = f"is {gap_m:.3g} m away from" if gap_m else "moves differently from"
                return f"{what} {name} {how} the other"
    return f"state {a.state_hash} and {b.state_hash}" if a.state_hash != b.state_hash else ""


def _golden_tick_difference(
    new: WorldState, old: WorldState, exact: bool, tolerance_m: float
) -> str:
    if len(new.plants) != len(old.plants):
        return f"the number of chairs is {len(new.plants)}, golden {len(old.plants)}"
    if exact and new.state_hash == old.state_hash:
        return ""
    if new.actor_ids != old.actor_ids:
        return _actors_difference(new, old)
    most_m = 0.0 if exact else tolerance_m
    for name, a, b in zip(new.actor_ids, new.actors, old.actors, strict=True):
        gap_m = np.abs(a[:3] - b[:3]).max()
        if gap_m > most_m:
            return f"actor {name} is {gap_m:.3g} m away from the golden trace"
    gap_m = np.abs(new.plants[:, :3] - old.plants[:, :3]).max(initial=0.0)
    if gap_m > most_m:
        return f"a chair is {gap_m:.3g} m away from the golden trace"
    return "the state hash differs" if exact else ""


def _actors_difference(a: WorldState, b: WorldState) -> str:
    return f"actors {sorted(set(a.actor_ids) ^ set(b.actor_ids))[:4]} are in one trace only"


def _label(record: LogRecord) -> str:
    """The class of a record, with its epoch, tick and seat, as far as it has them."""
    places = [
        f"{name} {getattr(record, name)}"
        for name in ("epoch", "tick", "seat")
        if hasattr(record, name)
    ]
    return type(record).__name__ + (f" ({', '.join(places)})" if places else "")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 120 else f"{text[:117]}..."


def _extent(records: Sequence[WorldState]) -> str:
    """How many records there are, and up to which tick."""
    return f"{len(records)}, up to tick {records[-1].tick}" if records else "none"
