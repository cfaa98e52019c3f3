"""Reading logs, which somebody else may have written: record by record, checked, up to the last whole one.

A journal of a long run lies in parts: what ended as planned is put aside, so that the file in use stays short.
`journal` is the part that is being written, `journal.00001`, `journal.00002`, ... are those before it.
"""

from __future__ import annotations

import hashlib
import os
import re
import struct
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, nullcontext
from itertools import chain
from pathlib import Path
from typing import BinaryIO, Final

from wcsim.core.closing import Closing
from wcsim.core.reading import LOG, WHOLE_LOG, escaped, opened, regular_size
from wcsim.errors import FileError, JournalError, WcsimError
from wcsim.log.framing import Record, torn_bytes, whole_records
from wcsim.log.records import (
    ActorBody,
    Header,
    Input,
    LogKind,
    LogRecord,
    WorldState,
    begins_log,
    changed,
    header_content,
    header_of,
    is_tick,
    record_bytes,
    record_of,
    told_apart,
)

_DIGITS = 5


def part_files(path: Path) -> tuple[Path, ...]:
    """The parts of a journal that are there, the oldest first and the one in use last.

    >>> part_files(Path("nowhere/journal"))
    ()
    """
    aside = re.compile(rf"{re.escape(path.name)}\.[0-9]{{{_DIGITS},}}")
    try:
        before = sorted(
            (part for part in path.parent.iterdir() if aside.fullmatch(part.name)), key=_number
        )
    except OSError:
        before = []
    return (*before, path) if os.path.lexists(path) else tuple(before)


def put_aside(path: Path) -> Path:
    """Give the part in use the next number; returns its new name. Nobody may have it open for writing."""
    before = [part for part in part_files(path) if part != path]
    number = 1 + (_number(before[-1]) if before else 0)
    aside = path.with_name(f"{path.name}.{number:0{_DIGITS}d}")
    path.rename(aside)
    return aside


def _number(part: Path) -> int:
    return int(part.name.rpartition(".")[2])


_MADE_BY: Final = {
    "journal": "a run folder of a server, or its journal",
    "trace": "a file of `wcsim town run`, or the golden trace of a scene",
    "drive": "a file of `wcsim users record` or `wcsim drive`",
    "ledger": "a ledger of a run of `wcsim train-clients`",
}


class LogScan:
    """One reading of a log; `end` is where the last record that was read ends, `after` its CRC."""

    def __init__(
        self, path: Path, expected: LogKind | None = None, file: BinaryIO | None = None
    ) -> None:
        """Read the header; from `file` where the path is open, or may come to name another one.

        Raises JournalError when it is none of this version, or of another kind than expected.
        """
        self._path, self._file = path, file
        with self._opened() as first:
            self.header, self.end, self.after = _read_first(first, path)
        if expected is not None and expected != self.header.kind:
            raise JournalError(
                f"{escaped(path)}: is not a {expected} but a {self.header.kind}; expected {_MADE_BY[expected]}"
            )
        self.torn_bytes = 0  # known in the end

    def to_end(self) -> None:
        """Find where the last whole record ends, without a look at what the records say. Raises JournalError."""
        for end, item in self._items():
            self.end, self.after = end, item.crc

    def records(self, ticks: bool = True) -> Iterator[LogRecord]:
        """Those after the last one that was read. Raises JournalError for one that no log holds, and for damage."""
        told: dict[str, ActorBody] = {}
        for end, item in self._items():
            wanted = ticks or not is_tick(item.payload)
            record = _read_record(item.payload, self._path, self.end) if wanted else None
            self.end, self.after = (
                end,
                item.crc,
            )  # who stops here, and asks again, gets the next one
            if record is not None:
                yield (
                    _with_bodies(record, told, self._path)
                    if isinstance(record, WorldState)
                    else record
                )

    def _opened(self) -> AbstractContextManager[BinaryIO]:
        return opened(self._path, LOG) if self._file is None else nullcontext(self._file)

    def _items(self) -> Iterator[tuple[int, Record]]:
        """Each record, and where it ends."""
        with self._opened() as file:
            torn: int | None = -1
            while torn == -1:
                start = file.seek(self.end)
                for item in whole_records(file, self.after):
                    yield start + item.end, item
                torn = torn_bytes(file, self.end, self.after)
        if torn is None:
            raise JournalError(
                f"{escaped(self._path)}: is damaged at byte {self.end}; restore it from a copy, or record it again in "
                "a new file"
            )
        self.torn_bytes = torn


def _read_first(file: BinaryIO, path: Path) -> tuple[Header, int, int]:
    """The header of a log, where it ends, and its CRC. Raises JournalError when there is none of this version."""
    first = next(whole_records(file), None)
    if first is None:
        raise JournalError(
            f"{escaped(path)}: is not a log, or was truncated in its first record; expected a whole file written by "
            "wcsim: copy it again, or record it again"
        )
    try:
        return header_of(first.payload), first.end, first.crc
    except WcsimError as error:
        raise JournalError(f"{escaped(path)}: {error}") from None


def _read_record(payload: bytes, path: Path, end: int) -> LogRecord:
    """A record that begins at byte `end` of a log. Raises JournalError when no log holds it."""
    try:
        return record_of(payload)
    except WcsimError as error:
        raise JournalError(f"{escaped(path)}: after {end} bytes: {error}") from None


def is_log(path: Path) -> bool:
    """Whether a file begins as a log does, of whatever version; False for what cannot be read."""
    try:
        with opened(path, LOG) as file:
            first = next(whole_records(file), None)
    except FileError:
        return False
    return first is not None and begins_log(first.payload)


def read_header(path: Path, expected: LogKind | None = None) -> Header:
    """The header of a log, of its newest part. Raises JournalError when it is none, or of another kind."""
    return LogScan(_parts(path)[-1], expected).header


def iter_log(path: Path) -> Iterator[LogRecord]:
    """The records of a log one by one, of all its parts, up to the last whole one; somebody may be writing it.

    Raises JournalError when it is no log, and at the place of a damage that is no torn end.
    """
    first, *others = _parts(path)
    return chain(LogScan(first).records(), *(LogScan(part).records() for part in others))


def iter_inputs(path: Path) -> Iterator[Input]:
    """What was done to the world of a journal, of all its parts. Raises as `iter_log`."""
    first, *others = _parts(path)
    return chain(inputs_of_part(first), *(inputs_of_part(part) for part in others))


def inputs_of_part(path: Path, ticks: bool = True) -> Iterator[Input]:
    """As `iter_inputs`, of one part of a journal alone.

    Without `ticks` those of `Ticked` are left out, unread: nearly all are, and reading them takes most of the time.
    """
    return (
        record for record in LogScan(path, "journal").records(ticks) if isinstance(record, Input)
    )


def read_states(path: Path) -> tuple[Header, tuple[WorldState, ...]]:
    """All states of a trace, each with the bodies of all its actors; a torn last record is left out.

    Raises:
        JournalError: The file is none, what it says cannot be, or there is damage in it.
    """
    scan = scan_in_memory(path, "trace")
    return scan.header, tuple(record for record in scan.records() if isinstance(record, WorldState))


def scan_in_memory(path: Path, expected: LogKind) -> LogScan:
    """A log that may be held in memory. Raises JournalError for a longer one, and as `LogScan`."""
    regular_size(path, WHOLE_LOG)
    return LogScan(path, expected)


def log_digest(path: Path) -> str:
    """A hash (hex) over what was done up to the last whole record; equal for two equal runs, wherever they ran.

    Names, reasons, places and versions are left out. Raises JournalError as `iter_log`.
    """
    digest = hashlib.blake2b(digest_size=16)
    for payload in (header_content(read_header(path)), *map(_content, iter_log(path))):
        digest.update(struct.pack("<I", len(payload)) + payload)
    return digest.hexdigest()


def _content(record: LogRecord) -> bytes:
    return record_bytes(told_apart(record))


def _parts(path: Path) -> tuple[Path, ...]:
    """The parts of a log; where there is none, the file that should be there."""
    return part_files(path) or (path,)


def _with_bodies(state: WorldState, told: dict[str, ActorBody], path: Path) -> WorldState:
    """A state with the bodies of all its actors, of which a file tells once. Raises JournalError."""
    told.update((body.id, body) for body in state.bodies)
    try:
        return changed(state, bodies=tuple(told[name] for name in state.actor_ids) if told else ())
    except KeyError as error:
        raise JournalError(
            f"{escaped(path)}: tick {state.tick} has no size of actor {error}; record it again"
        ) from None


_LOCKS: Final = Path("/proc/locks")


class LogTail(Closing):
    """Reads the inputs of a log from the beginning of its newest part on, and goes over into the part after it.

    Args:
        path: Of the log; it need not be there yet.
    """

    def __init__(self, path: Path) -> None:
        self.header: Header | None = None  # once there is a log
        self._path, self._held = path, ExitStack()
        self._file: BinaryIO | None = None
        self._scan: LogScan | None = None  # of that file

    def read(self, most: int = 1000) -> list[Input]:
        """The records that have come, oldest first, so many at the most; none where nothing has come.

        Raises:
            JournalError: It is no log, or damaged.
        """
        if self._scan is None and not self._open():
            return []
        found = self._records(most)
        if found or not self._is_over():
            return found
        found = self._records(
            most
        )  # what came before its part was put aside, but after the first look
        if found:
            return found
        self.close()
        return self._records(most) if self._open() else []

    def close(self) -> None:
        """Close the file; reading goes on with the newest part."""
        self._held.close()
        self._file = self._scan = None

    def is_written(self) -> bool | None:
        """Whether a process has the log open for writing; None where that cannot be known.

        Where a file system has no device of its own (btrfs, overlay), a file and its lock may name different ones.
        """
        try:
            there = self._path.stat()
            locks = _LOCKS.read_text(encoding="ascii")
        except OSError:
            return None
        major, minor = os.major(there.st_dev), os.minor(there.st_dev)
        device = rf"{major:02x}:{minor:02x}" if major else r"00:[0-9a-f]+"
        return re.search(rf"(?m)\s{device}:{there.st_ino}\s", locks) is not None

    def _open(self) -> bool:
        """Open the newest part; whether there is one with a header in it by now."""
        parts = part_files(self._path)
        if not parts:
            return False
        self._file = self._held.enter_context(opened(parts[-1], LOG))
        try:
            if parts[-1].stat().st_size:
                self._scan = LogScan(parts[-1], file=self._file)
                self.header = self._scan.header
        finally:
            if self._scan is None:
                self.close()
        return self._scan is not None

    def _records(self, most: int) -> list[Input]:
        found = list[Input]()
        try:
            for record in () if self._scan is None else self._scan.records():
                if isinstance(record, Input):
                    found.append(record)
                if len(found) >= most:
                    break
        except JournalError:
            if not found:  # else at the next look
                raise
        return found

    def _is_over(self) -> bool:
        """Whether another part is in use now."""
        if self._file is None:
            return False
        try:
            now = self._path.stat()
        except OSError:  # between two parts
            return False
        mine = os.fstat(self._file.fileno())
        return (now.st_dev, now.st_ino) != (mine.st_dev, mine.st_ino)
