"""Headers, ticks and events of a drive as the payloads of its records, and back, every number checked.

A header and an event are JSON; a tick is a row of little-endian numbers, and the stick within it as float32.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import asdict
from typing import Any

import numpy as np

from wcsim.core.reading import FileKind, escaped, parse_json
from wcsim.errors import JournalError
from wcsim.types import F64, Joystick, StartSpec
from wcsim.users.recording.drive_types import (
    DRIVE_MAGIC,
    MOST_SAMPLES,
    NO_ACTION,
    DriveHeader,
    RecordedEvent,
    RecordedTick,
)

MOST_RECORDS = 1_000_000  # in a file; a day of ten ticks a second
DRIVE_FILE = FileKind(what="a drive recorded by wcsim", limit_bytes=1 << 30, error=JournalError)
_EVENT, _TICK = b"E", b"T"
_ROW = struct.Struct("<QIiHH16d")  # tick, episode, action, flags, samples; see `tick_bytes`
_FLAGS = ("warning", "intervening", "overruled", "helped", "arrived", "gave_up", "crashed", "truncated")
_KNOWS_INTENT = 1 << len(_FLAGS)
_LARGEST, _LARGEST_INTEGER, _MOST_ACTIONS = 1e9, 1 << 62, 1 << 16
_ON_STICK = 1.0 + 1e-6  # of an axis, with what rounding adds
_KIND_LETTERS, _DETAIL_LETTERS = 40, 1000
_TEXTS = (
    *("wcsim", "fingerprint", "town", "town_address", "town_sha256", "config"),
    *("profile", "user", "beside", "policy", "level", "episode", "scene"),
)


def header_payload(header: DriveHeader) -> bytes:
    """A header as its record holds it. Raises ValueError or JournalError for one that no reader would take."""
    payload = json.dumps({"magic": DRIVE_MAGIC, **asdict(header)}, allow_nan=False).encode()
    header_of_drive(payload, "a header")
    return payload


def start_json(start: StartSpec) -> str:
    """A start as the detail of an event `respawn`, every number to the last bit."""
    return json.dumps(asdict(start), allow_nan=False)


def start_of_json(text: str) -> StartSpec:
    """What `start_json` wrote. Raises JournalError for anything else."""
    where = f"the drive's respawn at {escaped(text, 80)}"
    try:
        return _start_of(parse_json(text, where, DRIVE_FILE))
    except (KeyError, TypeError, ValueError):
        raise JournalError(
            f"{where}: is not a start; expected a place, a heading and a goal: record it again"
        ) from None


def is_drive_header(payload: bytes) -> bool:
    """Whether a file's first record says that it is a drive, of whatever version."""
    return payload.startswith(b'{"magic": "wcsim-drive-')


def header_of_drive(payload: bytes, where: str) -> DriveHeader:
    """A header from its record. Raises JournalError, which begins with `where`, when it is none of this version."""
    try:
        data = parse_json(payload.decode(), where, DRIVE_FILE)
        magic = data.pop("magic", "")
        if magic != DRIVE_MAGIC:
            raise JournalError(
                f"{where}: is of format {str(magic)[:40]!r}; expected {DRIVE_MAGIC!r}: use the wcsim that made it"
            )
        start = data.pop("start", None)
        header = DriveHeader(**data, start=None if start is None else _start_of(start))
        _require(
            all(isinstance(getattr(header, name), str) for name in _TEXTS),
            _whole(header.seed, _LARGEST_INTEGER),
            _whole(header.max_steps, _LARGEST_INTEGER) and header.max_steps > 0,
            _is_number(header.tick_s) and 1e-3 <= header.tick_s <= 10.0,
        )
    except (KeyError, TypeError, ValueError):
        raise JournalError(f"{where}: has no header of a drive of this version; expected {DRIVE_FILE.what}") from None
    return header


def tick_payload(tick: RecordedTick) -> bytes:
    """A tick as its record holds it. Raises ValueError for a number that no reader would take."""
    intent = tick.intent or Joystick(0.0, 0.0)
    flags = sum(1 << bit for bit, name in enumerate(_FLAGS) if getattr(tick, name))
    flags |= 0 if tick.intent is None else _KNOWS_INTENT
    sticks = (tick.stick, intent, tick.commanded, tick.chosen)
    numbers = (
        tick.time_s,
        *(number for stick in sticks for number in (stick.x, stick.y)),
        *(float(number) for number in tick.p_WB_m),
        tick.yaw_rad,
        tick.roll_rad,
        tick.pitch_rad,
        tick.speed_mps,
    )
    row = _ROW.pack(tick.tick, tick.episode, tick.action, flags, len(tick.sticks), *numbers)
    data = _TICK + row + tick.sticks.astype("<f4").tobytes()
    _tick_of(data)
    return data


def event_payload(event: RecordedEvent) -> bytes:
    """An event as its record holds it; a text that is too long is cut."""
    cut = {"kind": event.kind[:_KIND_LETTERS], "detail": event.detail[:_DETAIL_LETTERS]}
    return _EVENT + json.dumps({**asdict(event), **cut}, allow_nan=False).encode()


def part_of_drive(payload: bytes, where: str) -> RecordedTick | RecordedEvent:
    """A tick or an event from its record. Raises JournalError, which begins with `where`."""
    try:
        if payload[:1] == _TICK:
            return _tick_of(payload)
        if payload[:1] == _EVENT:
            return _event_of(parse_json(payload[1:].decode(), where, DRIVE_FILE))
    except (KeyError, TypeError, ValueError, struct.error):
        pass
    raise JournalError(f"{where}: contains an unknown record; expected {DRIVE_FILE.what}")


def _tick_of(payload: bytes) -> RecordedTick:
    """A tick from its record. Raises ValueError or struct.error when it cannot be one."""
    number, episode, action, flags, samples, *numbers = _ROW.unpack_from(payload, 1)
    rest = payload[1 + _ROW.size :]
    _require(samples <= MOST_SAMPLES, len(rest) == 8 * samples, flags < 2 * _KNOWS_INTENT)
    sticks: F64 = np.frombuffer(rest, "<f4").astype(np.float64).reshape(-1, 2)
    _require(
        all(math.isfinite(value) and abs(value) <= _LARGEST for value in numbers),
        all(abs(value) <= _ON_STICK for value in numbers[1:9]),
        bool((np.abs(sticks) <= _ON_STICK).all()),
        NO_ACTION <= action <= _MOST_ACTIONS,
        number <= _LARGEST_INTEGER and numbers[0] >= 0.0,
    )
    stick, intent, commanded, chosen = (Joystick(*numbers[i : i + 2]) for i in (1, 3, 5, 7))
    return RecordedTick(
        tick=number,
        episode=episode,
        time_s=numbers[0],
        stick=stick,
        intent=intent if flags & _KNOWS_INTENT else None,
        sticks=sticks,
        commanded=commanded,
        chosen=chosen,
        action=action,
        p_WB_m=np.array(numbers[9:12]),
        yaw_rad=numbers[12],
        roll_rad=numbers[13],
        pitch_rad=numbers[14],
        speed_mps=numbers[15],
        **{name: bool(flags >> bit & 1) for bit, name in enumerate(_FLAGS)},
    )


def _event_of(data: dict[str, Any]) -> RecordedEvent:
    event = RecordedEvent(**data)
    texts = (event.kind, event.detail)
    _require(
        all(isinstance(text, str) for text in texts),
        len(event.kind) <= _KIND_LETTERS and len(event.detail) <= _DETAIL_LETTERS,
        _whole(event.tick, _LARGEST_INTEGER),
        _is_number(event.time_s),
    )
    return event


def _start_of(data: Any) -> StartSpec:
    start = StartSpec(p_W_m=tuple(data["p_W_m"]), yaw_rad=data["yaw_rad"], goal_W_m=tuple(data["goal_W_m"]))
    numbers = (*start.p_W_m, start.yaw_rad, *start.goal_W_m)
    _require(len(numbers) == 5, len(start.p_W_m) == 2, len(data) == 3, all(map(_is_number, numbers)))
    return start


def _require(*facts: bool) -> None:
    if not all(facts):
        raise ValueError("out of bounds")


def _whole(value: Any, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _LARGEST
