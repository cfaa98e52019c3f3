"""Where two journals begin to tell of different runs, in words; nowhere exactly when their digests are equal."""

from __future__ import annotations

from dataclasses import fields
from itertools import zip_longest
from pathlib import Path

from wcsim.server.journal.journal import JournalHeader, JournalRecord, Ticked, iter_journal, read_header
from wcsim.server.journal.records import told_apart
from wcsim.types import Command

SAME = ("town_sha256", "config", "seed", "capacity", "tick_s", "hook", "recovery")
"""What is compared of the headers: equal runs may have other names and other folders."""


def journal_difference(one: Path, other: Path) -> str:
    """The first difference between two journals, "" when they are equal. Raises WcsimError when one is none."""
    told = _header_difference(read_header(one), read_header(other))
    if told:
        return told
    here = "before the first record"
    for a, b in zip_longest(iter_journal(one), iter_journal(other)):
        if a is None or b is None:
            return f"{one if a is None else other} ends {here}; the other one continues with {_called(b or a)}"
        if told_apart(a) != told_apart(b):
            return _record_difference(told_apart(a), told_apart(b))
        here = f"after {_called(a)}"
    return ""


def _header_difference(a: JournalHeader, b: JournalHeader) -> str:
    for name in SAME:
        one, other = getattr(a, name), getattr(b, name)
        if one != other:
            return f"header: {name} is {_short(one)} and {_short(other)}"
    return ""


def _record_difference(a: JournalRecord, b: JournalRecord) -> str:
    if type(a) is not type(b) or _called(a) != _called(b):
        return f"{_called(a)} against {_called(b)}"
    if isinstance(a, Ticked) and isinstance(b, Ticked) and a.commands != b.commands:
        return f"{_called(a)}: {_command_difference(a.commands, b.commands)}"
    name = next(item.name for item in fields(a) if getattr(a, item.name) != getattr(b, item.name))
    return f"{_called(a)}: {name} is {_short(getattr(a, name))} and {_short(getattr(b, name))}"


def _command_difference(a: tuple[Command, ...], b: tuple[Command, ...]) -> str:
    seats = [command.seat for command in a], [command.seat for command in b]
    if seats[0] != seats[1]:
        return f"commands for seats {seats[0]} and {seats[1]}"
    one, other = next(pair for pair in zip(a, b, strict=True) if pair[0] != pair[1])
    return (
        f"seat {one.seat} is commanded ({one.joystick.x!r}, {one.joystick.y!r}) and "
        f"({other.joystick.x!r}, {other.joystick.y!r})"
    )


def _called(record: JournalRecord | None) -> str:
    """A record as one says it: what, which epoch and tick, whose."""
    if record is None:
        return "nothing"
    words = [type(record).__name__]
    words += [f"{name} {getattr(record, name)}" for name in ("epoch", "tick", "seat") if hasattr(record, name)]
    return " ".join(words[:1]) + (f" ({', '.join(words[1:])})" if words[1:] else "")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 120 else f"{text[:117]}..."
