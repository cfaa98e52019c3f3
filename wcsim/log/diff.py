"""Where two logs begin to tell of different runs, in words; and a new trace against a golden one."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.errors import WcsimError
from wcsim.log.reader import iter_log, read_header, read_states
from wcsim.log.records import Header, LogRecord, Ticked, WorldState, record_bytes, told_apart

SAME: Final = ("town_sha256", "config", "seed", "seats", "tick_s", "hook", "origin_m", "origin_z_m")
"""What is compared of the headers: equal runs may have other names, other folders and other versions."""


def first_difference(one: Path, other: Path) -> str:
    """The first difference between two logs, to the last bit and in words; "" when they are equal.

    Raises WcsimError when one is none, or they are of two kinds.
    """
    head, other_head = read_header(one), read_header(other)
    if head.kind != other_head.kind:
        raise WcsimError(
            f"{one} is a {head.kind} and {other} a {other_head.kind}; expected two of a kind"
        )
    told = _header_difference(head, other_head)
    if told:
        return told
    here = "before the first record"
    for a, b in zip_longest(iter_log(one), iter_log(other)):
        if a is None or b is None:
            return f"{one if a is None else other} ends {here}; the other one continues with {_called(b or a)}"
        told = _record_difference(told_apart(a), told_apart(b))
        if told:
            return told
        here = f"after {_called(a)}"
    return ""


def golden_difference(trace: Path, golden: Path) -> str:
    """The first difference between two traces, "" when they agree.

    Hashes are compared exactly when both were made by the same versions; otherwise positions, to 1 mm over the first
    second and 5 cm later, because contacts amplify the last bit.
    """
    (head, ticks), (golden_head, golden_ticks) = read_states(trace), read_states(golden)
    exact = head.fingerprint == golden_head.fingerprint
    if [new.tick for new in ticks] != [old.tick for old in golden_ticks]:
        return (
            f"its records are {_extent(ticks)}, those of the golden trace {_extent(golden_ticks)}"
        )
    for new, old in zip(ticks, golden_ticks, strict=True):
        told = _golden_tick_difference(
            new, old, exact, 0.001 if new.tick * head.tick_s <= 1.0 else 0.05
        )
        if told:
            return f"tick {new.tick}: {told}"
    return ""


def golden_note(trace: Path, golden: Path) -> str:
    """Why a trace that agrees with its golden one was compared by positions alone, "" where all hashes are the same."""
    (head, ticks), (golden_head, golden_ticks) = read_states(trace), read_states(golden)
    if [new.state_hash for new in ticks] == [old.state_hash for old in golden_ticks]:
        return ""
    made, here = golden_head.fingerprint.split(), head.fingerprint.split()
    return f"positions agree, hashes do not: the golden trace is of {', '.join(w for w in made if w not in here)}"


def _header_difference(a: Header, b: Header) -> str:
    for name in SAME:
        one, other = getattr(a, name), getattr(b, name)
        if one != other:
            return f"header: {name} is {_short(one)} and {_short(other)}"
    return ""


def _record_difference(a: LogRecord, b: LogRecord) -> str:
    if type(a) is not type(b) or _called(a) != _called(b):
        return f"{_called(a)} against {_called(b)}"
    if isinstance(a, WorldState) and isinstance(b, WorldState):
        told = _state_difference(a, b)
        return f"{_called(a)}: {told}" if told else ""
    if record_bytes(a) == record_bytes(b):
        return ""
    if (
        isinstance(a, Ticked)
        and isinstance(b, Ticked)
        and (a.seats, a.sticks) != (b.seats, b.sticks)
    ):
        return f"{_called(a)}: {_command_difference(a, b)}"
    fields = ((name, getattr(a, name), getattr(b, name)) for name in a.__struct_fields__)
    name, one, other = next(
        (field for field in fields if not np.array_equal(field[1], field[2])), ("", "-0.0", "0.0")
    )
    return f"{_called(a)}: {name} is {_short(one)} and {_short(other)}"


def _command_difference(a: Ticked, b: Ticked) -> str:
    if a.seats != b.seats:
        return f"commands for seats {list(a.seats)} and {list(b.seats)}"
    each = zip(a.seats, a.sticks, b.sticks, strict=True)
    seat, one, other = next(found for found in each if found[1] != found[2])
    return f"seat {seat} is commanded {one} and {other}"


def _called(record: LogRecord | None) -> str:
    """A record as one says it: what, which epoch and tick, whose."""
    if record is None:
        return "nothing"
    words = [type(record).__name__]
    words += [
        f"{name} {getattr(record, name)}"
        for name in ("epoch", "tick", "seat")
        if hasattr(record, name)
    ]
    return " ".join(words[:1]) + (f" ({', '.join(words[1:])})" if words[1:] else "")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 120 else f"{text[:117]}..."


def _state_difference(a: WorldState, b: WorldState) -> str:
    if len(a.commands) != len(b.commands) or a.seats != b.seats:
        return f"{len(a.commands)} commands (seats {list(a.seats)}) and {len(b.commands)} (seats {list(b.seats)})"
    for seat, one, other in zip(
        a.seats or range(len(a.commands)), a.commands, b.commands, strict=True
    ):
        if one.tobytes() != other.tobytes():
            return f"seat {seat} is commanded {tuple(one.tolist())} and {tuple(other.tolist())}"
    if a.actor_ids != b.actor_ids:
        return f"actors {sorted(set(a.actor_ids) ^ set(b.actor_ids))[:4]} are in one trace only"
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


def _extent(records: Sequence[WorldState]) -> str:
    """How many records there are, and up to when."""
    return f"{len(records)}, up to tick {records[-1].tick}" if records else "none"


def _golden_tick_difference(
    new: WorldState, old: WorldState, exact: bool, tolerance_m: float
) -> str:
    if len(new.plants) != len(old.plants):
        return f"the number of chairs is {len(new.plants)}, golden {len(old.plants)}"
    if exact and new.state_hash == old.state_hash:
        return ""
    if new.actor_ids != old.actor_ids:
        return f"actors {sorted(set(new.actor_ids) ^ set(old.actor_ids))[:4]} are in one trace only"
    for name, a, b in zip(new.actor_ids, new.actors, old.actors, strict=True):
        if np.abs(a[:3] - b[:3]).max() > (0.0 if exact else tolerance_m):
            return f"actor {name} is {np.abs(a[:3] - b[:3]).max():.3g} m away from the golden trace"
    gap_m = float(np.abs(new.plants[:, :3] - old.plants[:, :3]).max(initial=0.0))
    if gap_m > (0.0 if exact else tolerance_m):
        return f"a chair is {gap_m:.3g} m away from the golden trace"
    return "the state hash differs" if exact else ""
