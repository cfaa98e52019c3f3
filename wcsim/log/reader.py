"""Reads logs, record by record and checked; any process may have written them, or be writing them.

A log is a file: first a header, which names its kind (`Header.kind`), then the records of that kind
(`records.py`). `read_header` gives the one, `iter_log`, `iter_journal_inputs` and
`read_trace_states` the others. A truncated end is left out, as a killed process leaves it; damage
before the end is a JournalError.

A journal of a long run lies in parts, so that the file in use stays short: `journal` is the part
that is being written, `journal.00001`, `journal.00002`, ... are those before it.
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

from wcsim.core.closing import ClosingContextBase
from wcsim.core.reading import LOG, WHOLE_LOG, escape, open_regular_file, read_file_size
from wcsim.errors import FileError, JournalError, WcsimError
from wcsim.log.framing import FramedRecord, count_truncated_bytes, iter_whole_records
from wcsim.log.records import (
    HEADER_STARTS,
    TICK_TAG,
    ActorBody,
    Header,
    Input,
    LogKind,
    LogRecord,
    WorldState,
    encode_header_for_comparison,
    header_from_bytes,
    record_from_bytes,
    record_to_bytes,
    strip_uncompared_fields,
    with_fields,
)

_MADE_BY: Final[dict[LogKind, str]] = {
    "journal": "a run folder of a server, or its journal",
    "trace": "a file of `wcsim town run`, or the golden trace of a scene",
    "drive": "a file of `wcsim users record` or `wcsim drive`",
    "ledger": "a ledger of a run of `wcsim train-clients`",
}
_PART_DIGITS: Final = 5
_LOCKS: Final = Path("/proc/locks")


def is_log_file(path: Path) -> bool:
    """Whether a file begins as a log, of whatever version; False for what cannot be read."""
    try:
        with open_regular_file(path, LOG) as file:
            first = next(iter_whole_records(file), None)
    except FileError:
        return False
    return first is not None and first.payload.startswith(HEADER_STARTS)


def read_header(path: Path, expected: LogKind | None = None) -> Header:
    """The header of a log, of its newest part. Raises JournalError as `LogScan`."""
    return LogScan(_parts(path)[-1], expected).header


def iter_log(path: Path) -> Iterator[LogRecord]:
    """The records of a log one by one, of all its parts, up to the last whole one.

    The headers of all parts are read at once, so that a part that is no log raises here.
    Raises JournalError when it is no log, and where it is damaged before its end.
    """
    first, *others = _parts(path)
    return chain(LogScan(first).records(), *(LogScan(part).records() for part in others))


def iter_journal_inputs(path: Path) -> Iterator[Input]:
    """What was done to the world of a journal, of all its parts. Raises as `iter_log`."""
    first, *others = _parts(path)
    return chain(
        iter_journal_part_inputs(first), *(iter_journal_part_inputs(part) for part in others)
    )


def iter_journal_part_inputs(path: Path, ticks: bool = True) -> Iterator[Input]:
    """As `iter_journal_inputs`, of one part of a journal alone.

    Without `ticks` those of `Ticked` are left out, unread: nearly all inputs are, and reading them
    takes most of the time.
    """
    return (
        record for record in LogScan(path, "journal").records(ticks) if isinstance(record, Input)
    )


def read_trace_states(path: Path) -> tuple[Header, tuple[WorldState, ...]]:
    """The header of a trace and all its states, each with the bodies of all its actors.

    Raises:
        JournalError: The file is no trace, is damaged, or its values cannot be.
    """
    scan = scan_small_log(path, "trace")
    return scan.header, tuple(record for record in scan.records() if isinstance(record, WorldState))


def scan_small_log(path: Path, expected: LogKind) -> LogScan:
    """A log short enough to be held in memory. Raises JournalError, also as `LogScan`."""
    read_file_size(path, WHOLE_LOG)
    return LogScan(path, expected)


def hash_log(path: Path) -> str:
    """A hash (hex) over what was done in a log; two equal runs have the same one.

    Names, reasons, places and versions are left out. Raises JournalError as `iter_log`.
    """
    header = encode_header_for_comparison(read_header(path))
    records = (record_to_bytes(strip_uncompared_fields(record)) for record in iter_log(path))
    digest = hashlib.blake2b(digest_size=16)
    for payload in chain([header], records):
        digest.update(struct.pack("<I", len(payload)) + payload)
    return digest.hexdigest()


class LogScan:
    """One pass through a file of a log.

    Attributes:
        header: Of the log.
        end: Byte at which the last record that was read ends.
        after: CRC of that record.
        truncated_bytes: How many bytes of a truncated record follow the last whole one; known once
            all records have been read.
    """

    def __init__(
        self, path: Path, expected: LogKind | None = None, file: BinaryIO | None = None
    ) -> None:
        """Read the header; from `file` where the path is open, or may come to name another file.

        Raises JournalError when it is no log of this version, or of another kind than expected.
        """
        self._path = path
        self._file = file
        self.truncated_bytes = 0
        with self._opened() as log:
            first = next(iter_whole_records(log), None)
        if first is None:
            raise JournalError(
                f"{escape(path)}: is not a log, or was truncated in its first record; expected a "
                "whole file written by wcsim: copy it again, or record it again"
            )
        try:
            self.header = header_from_bytes(first.payload)
        except WcsimError as error:
            raise JournalError(f"{escape(path)}: {error}") from None
        self.end = first.end
        self.after = first.crc
        if expected is not None and expected != self.header.kind:
            raise JournalError(
                f"{escape(path)}: is not a {expected} but a {self.header.kind}; "
                f"expected {_MADE_BY[expected]}"
            )

    def skip_to_end(self) -> None:
        """Find where the last whole record ends, without decoding any. Raises JournalError."""
        for end, item in self._items():
            self.end = end
            self.after = item.crc

    def records(self, ticks: bool = True) -> Iterator[LogRecord]:
        """The records after the last one that was read.

        Without `ticks` those of `Ticked` are left out, unread. Raises JournalError for a record
        that no log holds, and for damage.
        """
        bodies: dict[str, ActorBody] = {}
        for end, item in self._items():
            record: LogRecord | None = None
            if ticks or item.payload[1:3] != TICK_TAG:
                try:
                    record = record_from_bytes(item.payload)
                except WcsimError as error:
                    raise JournalError(
                        f"{escape(self._path)}: after {self.end} bytes: {error}"
                    ) from None
            # Before the yield: a caller that stops here, and reads on later, gets the next record.
            self.end = end
            self.after = item.crc
            if isinstance(record, WorldState):
                record = _with_bodies(record, bodies, self._path)
            if record is not None:
                yield record

    def _opened(self) -> AbstractContextManager[BinaryIO]:
        return open_regular_file(self._path, LOG) if self._file is None else nullcontext(self._file)

    def _items(self) -> Iterator[tuple[int, FramedRecord]]:
        """Each whole record after the last one that was read, and where it ends in the file."""
        with self._opened() as file:
            rest: int | str = "appended"
            while rest == "appended":
                start = file.seek(self.end)
                for item in iter_whole_records(file, self.after):
                    yield start + item.end, item
                rest = count_truncated_bytes(file, self.end, self.after)
        if isinstance(rest, str):
            raise JournalError(
                f"{escape(self._path)}: is damaged at byte {self.end}; restore it from a copy, or "
                "record it again in a new file"
            )
        self.truncated_bytes = rest


class LogFollower(ClosingContextBase):
    """Follows a log that is being written: from its newest part on, and into a newer one.

    Of parts that come and go between two calls it reads the newest alone.

    Args:
        path: Of the log; it need not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self.header: Header | None = None  # once there is a log
        self._path = path
        self._held = ExitStack()
        self._file: BinaryIO | None = None
        self._scan: LogScan | None = None  # of that file

    def read(self, most: int = 1000) -> list[Input]:
        """The inputs written since the last call, oldest first, at most `most`; often none.

        Raises:
            JournalError: It is no log, or damaged.
        """
        found = self._read_part(most)
        if found or not self._is_rotated():
            return found
        # The writer may have appended after the first look, before it put the part aside.
        found = self._read_part(most)
        if found:
            return found
        self.close()
        return self._read_part(most)

    def close(self) -> None:
        """Close the file; reading goes on with the newest part."""
        self._held.close()
        self._file = self._scan = None

    def is_written(self) -> bool | None:
        """Whether a process has the log open for writing; None where that cannot be known.

        Where a file system has no device of its own (btrfs, overlay), a file and its lock may name
        different ones.
        """
        try:
            status = self._path.stat()
            locks = _LOCKS.read_text(encoding="ascii")
        except OSError:
            return None
        major, minor = os.major(status.st_dev), os.minor(status.st_dev)
        device = rf"{major:02x}:{minor:02x}" if major else r"00:[0-9a-f]+"
        return re.search(rf"(?m)\s{device}:{status.st_ino}\s", locks) is not None

    def _open(self) -> None:
        """Open the newest part, if there is one with a header in it by now."""
        parts = list_log_parts(self._path)
        if not parts:
            return
        self._file = self._held.enter_context(open_regular_file(parts[-1], LOG))
        try:
            if parts[-1].stat().st_size:
                self._scan = LogScan(parts[-1], file=self._file)
                self.header = self._scan.header
        finally:
            if self._scan is None:
                self.close()

    def _read_part(self, most: int) -> list[Input]:
        if self._scan is None:
            self._open()
        found = list[Input]()
        if self._scan is None:
            return found
        try:
            for record in self._scan.records():
                if isinstance(record, Input):
                    found.append(record)
                if len(found) >= most:
                    break
        except JournalError:
            # What was read before the damage comes first; the next call raises.
            if not found:
                raise
        return found

    def _is_rotated(self) -> bool:
        """Whether another part is in use now."""
        if self._file is None:
            return False
        try:
            current = self._path.stat()
        except OSError:  # between two parts
            return False
        own = os.fstat(self._file.fileno())
        return (current.st_dev, current.st_ino) != (own.st_dev, own.st_ino)


def list_log_parts(path: Path) -> tuple[Path, ...]:
    """The parts of a journal that exist, the oldest first and the one in use last.

    >>> list_log_parts(Path("nowhere/journal"))
    ()
    """
    rotated = re.compile(rf"{re.escape(path.name)}\.[0-9]{{{_PART_DIGITS},}}")
    try:
        before = [part for part in path.parent.iterdir() if rotated.fullmatch(part.name)]
    except OSError:
        before = []
    before.sort(key=_part_number)
    return (*before, path) if os.path.lexists(path) else tuple(before)


def rotate_log(path: Path) -> Path:
    """Rename the part in use to the next number; returns its new name.

    No process may have it open for writing.
    """
    before = [part for part in list_log_parts(path) if part != path]
    number = 1 + (_part_number(before[-1]) if before else 0)
    return path.rename(path.with_name(f"{path.name}.{number:0{_PART_DIGITS}d}"))


def _parts(path: Path) -> tuple[Path, ...]:
    """The parts of a log; where there is none, the file that should exist."""
    return list_log_parts(path) or (path,)


def _part_number(part: Path) -> int:
    return int(part.name.rpartition(".")[2])


def _with_bodies(state: WorldState, known: dict[str, ActorBody], path: Path) -> WorldState:
    """A state with the bodies of all its actors: a file holds each once, `known` gathers them.

    Raises JournalError for an actor without one.
    """
    known.update((body.id, body) for body in state.bodies)
    # Of a trace without any bodies none is expected.
    if not known:
        return with_fields(state, bodies=())
    try:
        return with_fields(state, bodies=tuple(known[name] for name in state.actor_ids))
    except KeyError as error:
        raise JournalError(
            f"{escape(path)}: tick {state.tick} has no size of actor {error}; record it again"
        ) from None
