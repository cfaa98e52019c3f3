"""Reading traces (`bridge/recording/trace.py`), which somebody else may have written.

Every number in them is checked.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wcsim.bridge.recording.trace import MAGIC, ActorBody, TickRecord, TraceHeader
from wcsim.core.reading import FileKind, escaped, opened, parse_json
from wcsim.errors import JournalError
from wcsim.types import ActorKind
from wcsim.users.recording.framing import torn_bytes, whole_records

_MAX_SEATS = 64
_KIND = FileKind(what="a trace written by wcsim", limit_bytes=4 << 30, error=JournalError)
_TICK_JSON_BYTES = 8 << 20  # names and bodies of some 100,000 actors
_OF_TICK = {"epoch", "tick", "seats", "actors", "hash", "time_s", "bodies", "at"}
_NO_XML = re.compile(r"[\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ufffe\uffff]")  # and what turns a line round
_COMMAND, _PLANT, _ACTOR = 2, 15, 8  # numbers of each
_LARGEST_INTEGER, _LARGEST = 1 << 62, 1e9


def read_trace(path: Path) -> tuple[TraceHeader, tuple[TickRecord, ...]]:
    """Read a trace; a torn last record is left out.

    Raises:
        JournalError: The file is none, what it says cannot be, or there is damage in it.
    """
    payloads = _payloads(path)
    told: dict[str, ActorBody] = {}
    try:
        first = next(payloads, b"")
        if not first:
            raise JournalError(
                f"{escaped(path)}: is not a trace, or was truncated in its first record; expected a complete file "
                "written by wcsim: copy it again, or record it again"
            )
        header = _header(first, escaped(path))
        return header, tuple(_tick(payload, told, escaped(path)) for payload in payloads)
    except (KeyError, TypeError, ValueError, OverflowError):
        message = f"{escaped(path)}: is not a trace of this version; expected a file written by wcsim"
        raise JournalError(message) from None


def _payloads(path: Path) -> Iterator[bytes]:
    end = 0
    with opened(path, _KIND) as file:
        size = os.fstat(file.fileno()).st_size
        if size > _KIND.limit_bytes:
            raise JournalError(f"{escaped(path)}: larger than {_KIND.limit_bytes} bytes; expected {_KIND.what}")
        for record in whole_records(file):
            end = record.end
            yield record.payload
        if end and torn_bytes(file, end) is None:
            raise JournalError(f"{escaped(path)}: is damaged after {end} bytes, and more follows; record it again")


def _header(payload: bytes, where: str) -> TraceHeader:
    head = parse_json(payload.decode(), where, _KIND)
    if head.pop("magic") != MAGIC:
        raise ValueError(MAGIC)
    head["origin_m"] = _numbers(head.get("origin_m", (0.0, 0.0)), 2)
    if head.get("chair_box_m") is not None:
        head["chair_box_m"] = _numbers(head["chair_box_m"], 2)
    header = TraceHeader(**head)
    _require(
        isinstance(header.name, str) and isinstance(header.fingerprint, str),
        _is_number(header.tick_s) and header.tick_s > 0.0,
        _is_number(header.origin_z_m),
    )
    _integer(header.seed, _LARGEST_INTEGER)
    _integer(header.seats, _MAX_SEATS)
    return header


def _tick(payload: bytes, told: dict[str, ActorBody], where: str) -> TickRecord:
    line, _, raw = payload.partition(b"\n")
    head = parse_json(line.decode(), where, _KIND, _TICK_JSON_BYTES)
    _require(head.keys() <= _OF_TICK)  # the first that holds more ends the reading, whatever is in the others
    seats = _integer(head["seats"], _MAX_SEATS)
    actors = tuple(map(_text, _list(head["actors"])))
    for body in _list(head.get("bodies", [])):
        name, kind, size_lwh_m, piece = body
        told[_text(name)] = ActorBody(
            id=name,
            kind=ActorKind(kind),
            size_lwh_m=_numbers(size_lwh_m, 3),
            piece=_integer(piece, _LARGEST_INTEGER),
        )
    numbers = np.frombuffer(raw, "<f8")
    plants_at, actors_at = seats * _COMMAND, seats * (_COMMAND + _PLANT)
    _require(len(numbers) == actors_at + len(actors) * _ACTOR, bool((np.abs(numbers) <= _LARGEST).all()))
    at = tuple(_integer(seat, _MAX_SEATS) for seat in _list(head.get("at", [])))
    _require(len(at) in (0, seats), _is_number(head.get("time_s", 0.0)))
    return TickRecord(
        epoch=_integer(head["epoch"], _LARGEST_INTEGER),
        tick=_integer(head["tick"], _LARGEST_INTEGER),
        commands=numbers[:plants_at].reshape(-1, _COMMAND),
        plants=numbers[plants_at:actors_at].reshape(-1, _PLANT),
        actor_ids=actors,
        actors=numbers[actors_at:].reshape(-1, _ACTOR),
        state_hash=_text(head["hash"]),
        time_s=float(head.get("time_s", 0.0)),
        bodies=tuple(told[name] for name in actors) if told else (),
        seats=at,
    )


def _require(*facts: bool) -> None:
    if not all(facts):
        raise ValueError("out of bounds")


def _list(value: Any) -> list[Any]:
    _require(isinstance(value, list))
    return list(value)


def _text(value: Any) -> str:
    _require(isinstance(value, str) and not _NO_XML.search(value))
    return str(value)


def _integer(value: Any, most: int) -> int:
    _require(isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most)
    return int(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _LARGEST


def _numbers(values: Sequence[Any], count: int) -> Any:
    _require(isinstance(values, (list, tuple)) and len(values) == count and all(map(_is_number, values)))
    return tuple(values)
