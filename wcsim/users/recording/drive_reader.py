"""Reading drives, which somebody else may have written: bounded, checked, up to the last whole record."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from wcsim.core.reading import escaped, opened
from wcsim.errors import FileError, JournalError
from wcsim.users.recording.drive_bytes import DRIVE_FILE, MOST_RECORDS, header_of_drive, is_drive_header, part_of_drive
from wcsim.users.recording.drive_types import DriveHeader, DriveRecording, RecordedEvent, RecordedTick
from wcsim.users.recording.framing import torn_bytes, whole_records


def is_drive(path: Path) -> bool:
    """Whether a file begins as a drive does, of whatever version; False for what cannot be read."""
    try:
        with opened(path, DRIVE_FILE) as file:
            first = next(whole_records(file, 0), None)
    except FileError:
        return False
    return first is not None and is_drive_header(first.payload)


def read_drive_header(path: Path) -> DriveHeader:
    """The header of a recording. Raises JournalError when it is none, or one of another version."""
    with opened(path, DRIVE_FILE) as file:
        first = next(whole_records(file, 0), None)
    return _header(b"" if first is None else first.payload, path)


def read_drive(path: Path) -> DriveRecording:
    """Read a recording; a torn last record is left out.

    Raises:
        JournalError: The file is none, is of another version, what it says cannot be, or there is damage in it.
    """
    torn: list[bool] = []
    payloads = _payloads(path, torn)
    header = _header(next(payloads, b""), path)
    ticks: list[RecordedTick] = []
    events: list[RecordedEvent] = []
    for payload in payloads:
        part = part_of_drive(payload, escaped(path))
        if isinstance(part, RecordedEvent):
            events.append(part)
            continue
        if ticks and not _follows(ticks[-1], part):
            raise JournalError(
                f"{escaped(path)}: tick {part.tick} does not follow tick {ticks[-1].tick}; record it again"
            )
        ticks.append(part)
        if len(ticks) + len(events) > MOST_RECORDS:
            raise JournalError(f"{escaped(path)}: more than {MOST_RECORDS} records; expected {DRIVE_FILE.what}")
    return DriveRecording(name=str(path), header=header, ticks=tuple(ticks), events=tuple(events), torn=torn[0])


def _follows(before: RecordedTick, tick: RecordedTick) -> bool:
    return tick.tick == before.tick + 1 and tick.time_s > before.time_s and tick.episode >= before.episode


def _header(payload: bytes, path: Path) -> DriveHeader:
    if not is_drive_header(payload):
        raise JournalError(f"{escaped(path)}: is not a drive; expected a file of `wcsim users record` or `wcsim drive`")
    return header_of_drive(payload, escaped(path))


def _payloads(path: Path, torn: list[bool]) -> Iterator[bytes]:
    end = after = 0
    with opened(path, DRIVE_FILE) as file:
        size = os.fstat(file.fileno()).st_size
        if size > DRIVE_FILE.limit_bytes:
            raise JournalError(
                f"{escaped(path)}: larger than {DRIVE_FILE.limit_bytes} bytes; expected {DRIVE_FILE.what}"
            )
        for record in whole_records(file, 0):
            end, after = record.end, record.crc
            yield record.payload
        left = torn_bytes(file, end, after) if end else 0
        if left is None:
            raise JournalError(f"{escaped(path)}: is damaged after {end} bytes, and more follows; record it again")
        torn.append(left != 0)
