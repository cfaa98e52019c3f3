"""Compare two traces: exactly where versions agree, within tolerances elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wcsim.bridge.recording.trace import TickRecord, TraceHeader
from wcsim.bridge.recording.trace_file import read_trace

SAME = ("seed", "tick_s", "seats", "origin_m", "origin_z_m")
"""What `first_difference` compares of the headers: equal runs may have other names, and other versions."""


def difference(trace: Path, golden: Path) -> str:
    """The first difference between two traces, "" when they agree.

    Hashes are compared exactly when both were made by the same versions; otherwise positions, to 1 mm over the first
    second and 5 cm later, because contacts amplify the last bit.
    """
    (head, ticks), (golden_head, golden_ticks) = read_trace(trace), read_trace(golden)
    exact = head.fingerprint == golden_head.fingerprint
    if [new.tick for new in ticks] != [old.tick for old in golden_ticks]:
        return f"its records are {_extent(ticks)}, those of the golden trace {_extent(golden_ticks)}"
    for new, old in zip(ticks, golden_ticks, strict=True):
        told = _tick_difference(new, old, exact, 0.001 if new.tick * head.tick_s <= 1.0 else 0.05)
        if told:
            return f"tick {new.tick}: {told}"
    return ""


def _extent(records: Sequence[TickRecord]) -> str:
    """How many records there are, and up to when."""
    return f"{len(records)}, up to tick {records[-1].tick}" if records else "none"


def _tick_difference(new: TickRecord, old: TickRecord, exact: bool, tolerance_m: float) -> str:
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


def first_difference(one: Path, other: Path) -> str:
    """The first difference between two traces, to the last bit and in words; "" when they are equal."""
    (head, ticks), (other_head, other_ticks) = read_trace(one), read_trace(other)
    told = _header_difference(head, other_head)
    if told:
        return told
    for a, b in zip(ticks, other_ticks, strict=False):
        told = _first_of_tick(a, b)
        if told:
            return f"epoch {a.epoch}, tick {a.tick}: {told}"
    if len(ticks) == len(other_ticks):
        return ""
    fewer, more = sorted((len(ticks), len(other_ticks)))
    return f"{one if len(ticks) == fewer else other} ends after {fewer} ticks, the other after {more}"


def _header_difference(a: TraceHeader, b: TraceHeader) -> str:
    for name in SAME:
        if getattr(a, name) != getattr(b, name):
            return f"header: {name} is {getattr(a, name)} and {getattr(b, name)}"
    return ""


def _first_of_tick(a: TickRecord, b: TickRecord) -> str:
    if (a.epoch, a.tick) != (b.epoch, b.tick):
        return f"the other trace has epoch {b.epoch}, tick {b.tick}"
    if len(a.commands) != len(b.commands) or a.seats != b.seats:
        return f"{len(a.commands)} commands (seats {list(a.seats)}) and {len(b.commands)} (seats {list(b.seats)})"
    for seat, one, other in zip(a.seats or range(len(a.commands)), a.commands, b.commands, strict=True):
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
