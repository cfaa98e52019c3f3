"""The journal: everything that changed a world, in that order, on disk before anybody is told of it.

With the header, which says what the world is made from, it is enough to make the same world again
(`server/journal/replay.py`). A killed process loses nothing that `append` has returned from; a machine that loses its
power loses at most the last second or the last 50 ticks.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from io import FileIO
from itertools import chain
from pathlib import Path
from typing import Self

from wcsim.core.closing import Closing
from wcsim.core.reading import FileKind, opened
from wcsim.errors import ConfigError, DiskFullError, JournalError, WcsimError
from wcsim.server.journal.parts import part_files
from wcsim.server.journal.records import Admitted as Admitted
from wcsim.server.journal.records import Dismissed as Dismissed
from wcsim.server.journal.records import Ended as Ended
from wcsim.server.journal.records import EpochBegun as EpochBegun
from wcsim.server.journal.records import JournalHeader as JournalHeader
from wcsim.server.journal.records import JournalRecord as JournalRecord
from wcsim.server.journal.records import Respawned as Respawned
from wcsim.server.journal.records import Ticked as Ticked
from wcsim.server.journal.records import (
    header_bytes,
    header_content,
    header_of,
    is_chained,
    is_tick,
    record_bytes,
    record_of,
    told_apart,
)
from wcsim.server.journal.torn import keep_torn
from wcsim.users.recording.framing import MOST_TORN_BYTES, crc_of, framed, torn_bytes, whole_records

JOURNAL = "journal"  # its name in a run folder
_SYNC_TICKS, _SYNC_S = 50, 1.0
_KIND = FileKind(what="a journal", limit_bytes=1 << 62, error=JournalError)  # read record by record, however long


@dataclass(frozen=True, slots=True, kw_only=True)
class _Journal:
    """A whole journal; `torn` when something that is no whole record follows the last one."""

    header: JournalHeader
    records: tuple[JournalRecord, ...]
    torn: bool


class JournalWriter(Closing):
    """Appends to a journal; a context manager. Afterwards every record is on disk."""

    def __init__(self, path: Path, header: JournalHeader) -> None:
        """Begin a journal; it appears with its header. Raises ConfigError when that is impossible, DiskFullError."""
        beside = path.with_name(f".{path.name}.new")
        if os.path.lexists(path):
            raise ConfigError(f"{path}: a journal cannot be created (File exists); choose a new folder")
        try:
            file = FileIO(os.open(beside, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644), "r+b")
        except OSError as error:
            raise ConfigError(f"{path}: a journal cannot be created ({error.strerror}); choose a new folder") from None
        try:
            self._open(path, file, 0)
        except BaseException:  # another process begins it
            file.close()
            raise
        try:
            file.truncate(0)
            self._put(header_bytes(header))
            self._sync()
            beside.replace(path)
            _sync_folder(path.parent)
        except BaseException as error:
            file.close()
            beside.unlink(missing_ok=True)
            if isinstance(error, OSError):
                raise DiskFullError(f"{path}: cannot be created ({error.strerror}); check the disk") from None
            raise

    @classmethod
    def append_to(cls, path: Path) -> Self:
        """Go on with a journal after its process has died; a torn last record is cut off, and kept beside it.

        Raises:
            ConfigError: It cannot be written, or another process is writing it.
            JournalError: It is no journal, or is damaged before its end.
            DiskFullError: There is no room to keep what would be cut off.
        """
        scan = _Scan(path)
        try:
            file = FileIO(path, "r+b")
        except OSError as error:
            raise ConfigError(f"{path}: the journal cannot be continued ({error.strerror})") from None
        self = cls.__new__(cls)
        try:
            self._open(path, file, 0)
            scan.to_end()
            self.cut_bytes = scan.torn_bytes
            if scan.torn_bytes:
                file.seek(scan.end)
                keep_torn(path, file.read(min(scan.torn_bytes, MOST_TORN_BYTES)))  # what is longer is zeros
                file.truncate(scan.end)
            self._end, self._after = file.seek(scan.end), scan.after
        except BaseException:
            file.close()
            raise
        return self

    def _open(self, path: Path, file: FileIO, end: int) -> None:
        _lock(path, file)
        self._path, self._file, self._end = path, file, end
        self._after: int | None = 0  # CRC of the last record, None in a journal that is not chained
        self.cut_bytes = 0  # of a torn end
        self._unsynced, self._synced_s = 0, time.monotonic()

    @property
    def digest(self) -> str:
        """A hash (hex) over everything written so far; equal for two equal runs, wherever and whenever they ran.

        It is computed from the file, which takes a while for a long one.
        """
        return journal_digest(self._path)

    def append(self, record: JournalRecord) -> None:
        """Write one record; when this returns, the death of this process does not undo it.

        Raises:
            DiskFullError: it could not be written; the journal is what it was before, and can be appended to later.
        """
        self._put(record_bytes(record))
        self._unsynced += 1
        if self._unsynced >= _SYNC_TICKS or time.monotonic() - self._synced_s >= _SYNC_S:
            self._sync()

    def close(self) -> None:
        """Bring the last records to the disk and close the file; a second call does nothing."""
        if self._file.closed:
            return
        try:
            self._sync()
        finally:
            self._file.close()

    def _put(self, payload: bytes) -> None:
        """One unbuffered write; on a full disk the part that was written is taken back."""
        if self._file.closed:
            raise WcsimError(f"{self._path}: this journal is closed; open it again to continue it")
        data = framed(payload, self._after or 0)
        try:
            written = self._file.write(data) or 0
            if written < len(data):  # the rest says why
                written += self._file.write(data[written:]) or 0
            reason = "" if written == len(data) else "only a part was written"
        except OSError as error:
            reason = str(error.strerror)
        if reason:
            self._take_back()
            raise DiskFullError(
                f"{self._path}: a record could not be written ({reason}); the first {self._end} bytes are "
                f"intact: make room"
            )
        self._end += len(data)
        self._after = None if self._after is None else crc_of(data)

    def _take_back(self) -> None:
        try:
            self._file.truncate(self._end)
            self._file.seek(self._end)
        except OSError:  # nothing may follow half a record
            self._file.close()

    def _sync(self) -> None:
        try:
            os.fdatasync(self._file.fileno())
        except OSError as error:
            raise DiskFullError(
                f"{self._path}: could not be flushed to disk ({error.strerror}); check the disk"
            ) from None
        self._unsynced, self._synced_s = 0, time.monotonic()


def read_header(path: Path) -> JournalHeader:
    """The header of a journal, of its newest part. Raises JournalError when it is none."""
    return _Scan(_parts(path)[-1]).header


def iter_part(path: Path, ticks: bool = True) -> Iterator[JournalRecord]:
    """As `iter_journal`, of one part of a journal alone (`journal/parts.py`)."""
    return _Scan(path).records(ticks)


def iter_journal(path: Path, ticks: bool = True) -> Iterator[JournalRecord]:
    """The records of a journal one by one, of all its parts, up to the last whole one; somebody may be writing it.

    Without `ticks` those of ticks are left out, unread: nearly all are, and reading them takes most of the time.
    Raises JournalError when it is no journal, and at the place of a damage that is no torn end.
    """
    first, *others = _parts(path)
    return chain(_Scan(first).records(ticks), *(iter_part(part, ticks) for part in others))


def _read_journal(path: Path) -> _Journal:
    """A whole journal in memory. Raises JournalError when it is none, or is damaged before its end."""
    scans = [_Scan(part) for part in _parts(path)]
    records = tuple(record for scan in scans for record in scan.records())
    return _Journal(header=scans[0].header, records=records, torn=scans[-1].torn_bytes > 0)


def journal_digest(path: Path) -> str:
    """The same as `JournalWriter.digest`, up to the last whole record. Raises JournalError as `_read_journal`."""
    digest = _Digest(_Scan(_parts(path)[0]).header)
    for record in iter_journal(path):
        digest.add(record)
    return digest.hex()


def _parts(path: Path) -> tuple[Path, ...]:
    """The parts of a journal; where there is none, the file that should be there."""
    return part_files(path) or (path,)


class _Digest:
    """A hash over what two equal runs have in common: all but names, reasons, places and versions."""

    def __init__(self, header: JournalHeader) -> None:
        self._hash = hashlib.blake2b(digest_size=16)
        self._update(header_content(header))

    def add(self, record: JournalRecord) -> None:
        """One more record."""
        self._update(record_bytes(told_apart(record)))

    def _update(self, payload: bytes) -> None:
        self._hash.update(struct.pack("<I", len(payload)) + payload)

    def hex(self) -> str:
        """The hash of all so far."""
        return self._hash.hexdigest()


class _Scan:
    """One reading of a journal; `end` is where the last record that was read ends, `after` its CRC where it counts."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with opened(path, _KIND) as file:
            first = next(whole_records(file), None)
        if first is None:
            raise JournalError(f"{path}: is not a journal; expected a file written by wcsim")
        try:
            self.header = header_of(first.payload)
        except WcsimError as error:
            raise JournalError(f"{path}: is not a journal of this version: {error}") from None
        self.end = first.end
        self.after = first.crc if is_chained(first.payload) else None
        self.torn_bytes = 0  # known in the end

    def to_end(self) -> None:
        """Find where the last whole record ends, without a look at what the records say. Raises JournalError."""
        for _ in self._payloads():
            pass

    def records(self, ticks: bool = True) -> Iterator[JournalRecord]:
        """Those after the header. Raises JournalError for a whole record that no journal holds, and for damage."""
        for payload in self._payloads():
            if not ticks and is_tick(payload):
                continue
            try:
                record = record_of(payload)
            except WcsimError as error:
                raise JournalError(f"{self._path}: after {self.end} bytes: {error}") from None
            yield record

    def _payloads(self) -> Iterator[bytes]:
        with opened(self._path, _KIND) as file:
            torn: int | None = -1
            while torn == -1:
                start = file.seek(self.end)
                for item in whole_records(file, self.after):
                    yield item.payload
                    self.end, self.after = start + item.end, None if self.after is None else item.crc
                torn = torn_bytes(file, self.end, self.after)
        if torn is None:
            raise JournalError(
                f"{self._path}: is damaged at byte {self.end}; restore it from a copy, or start a new run"
            )
        self.torn_bytes = torn


def _lock(path: Path, file: FileIO) -> None:
    """Two writers would write over each other. The kernel takes the lock back when the file is closed."""
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ConfigError(f"{path}: another process is writing this journal; wait for it, or stop that run") from None
    except OSError:  # a file system without locks
        return


def _sync_folder(folder: Path) -> None:
    """Make the name of a new file last."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
