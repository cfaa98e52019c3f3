"""The journal: everything that changed a world, in that order, on disk before anybody is told of it.

With the header, which says what the world is made from, it is enough to make the same world again
(`server/recompute.py`). A killed process loses nothing that `append` has returned from; a machine that loses its power
loses at most the last second or the last 50 ticks.
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
from pathlib import Path
from types import TracebackType
from typing import Self

from wcsim.bridge.records import framed, whole_records
from wcsim.errors import ConfigError, DiskFullError, WcsimError
from wcsim.server.journal_records import Admitted as Admitted
from wcsim.server.journal_records import Dismissed as Dismissed
from wcsim.server.journal_records import Ended as Ended
from wcsim.server.journal_records import EpochBegun as EpochBegun
from wcsim.server.journal_records import JournalHeader as JournalHeader
from wcsim.server.journal_records import JournalRecord as JournalRecord
from wcsim.server.journal_records import Respawned as Respawned
from wcsim.server.journal_records import Ticked as Ticked
from wcsim.server.journal_records import (
    header_bytes,
    header_content,
    header_of,
    is_tick,
    record_bytes,
    record_of,
    told_apart,
)

JOURNAL = "journal"  # its name in a run folder
SYNC_TICKS, SYNC_S = 50, 1.0
MOST_TORN_BYTES = 1 << 16  # of a last record; more than this is no torn record


@dataclass(frozen=True, slots=True, kw_only=True)
class Journal:
    """A whole journal; `torn` when something that is no whole record follows the last one."""

    header: JournalHeader
    records: tuple[JournalRecord, ...]
    torn: bool


class JournalWriter:
    """Appends to a journal; a context manager. Afterwards every record is on disk."""

    def __init__(self, path: Path, header: JournalHeader) -> None:
        """Begin a journal. Raises ConfigError when there is one, or none can be made; DiskFullError."""
        try:
            file = FileIO(path, "xb")
        except OSError as error:
            raise ConfigError(f"{path}: a journal cannot be begun ({error.strerror}); choose a new folder") from None
        self._open(path, file, 0)
        try:
            self._put(header_bytes(header))
            self._sync()
            _sync_folder(path.parent)
        except BaseException:
            file.close()
            path.unlink()
            raise

    @classmethod
    def append_to(cls, path: Path) -> Self:
        """Go on with a journal after its process has died; a torn last record is cut off.

        Raises:
            ConfigError: it cannot be written, or another process is writing it.
            WcsimError: it is no journal, or is damaged before its end.
        """
        scan = _Scan(path)
        try:
            file = FileIO(path, "r+b")
        except OSError as error:
            raise ConfigError(f"{path}: the journal cannot be gone on with ({error.strerror})") from None
        self = cls.__new__(cls)
        try:
            self._open(path, file, 0)
            scan.to_end()
            _require_torn_end_only(path, scan.end)
            file.truncate(scan.end)
            self._end = file.seek(scan.end)
        except BaseException:
            file.close()
            raise
        return self

    def _open(self, path: Path, file: FileIO, end: int) -> None:
        _lock(path, file)
        self._path, self._file, self._end = path, file, end
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
        if self._unsynced >= SYNC_TICKS or time.monotonic() - self._synced_s >= SYNC_S:
            self._sync()

    def close(self) -> None:
        """Bring the last records to the disk and close the file; a second call does nothing."""
        if self._file.closed:
            return
        try:
            self._sync()
        finally:
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _put(self, payload: bytes) -> None:
        """One unbuffered write; on a full disk the part that was written is taken back."""
        if self._file.closed:
            raise WcsimError(f"{self._path}: this journal is closed; open it again to go on with it")
        data = framed(payload)
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
                f"{self._path}: a record could not be written ({reason}); {self._end} bytes are whole: make room"
            )
        self._end += len(data)

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
            raise DiskFullError(f"{self._path}: not brought to the disk ({error.strerror}); check the disk") from None
        self._unsynced, self._synced_s = 0, time.monotonic()


def read_header(path: Path) -> JournalHeader:
    """The header of a journal. Raises WcsimError when it is none."""
    return _Scan(path).header


def iter_journal(path: Path, ticks: bool = True) -> Iterator[JournalRecord]:
    """The records of a journal one by one, up to the last whole one; another process may be writing it.

    Without `ticks` those of ticks are left out, unread: nearly all are, and reading them takes most of the time.
    Raises WcsimError when it is no journal.
    """
    return _Scan(path).records(ticks)


def read_journal(path: Path) -> Journal:
    """A whole journal in memory. Raises WcsimError when it is none."""
    scan = _Scan(path)
    records = tuple(scan.records())
    return Journal(header=scan.header, records=records, torn=scan.end < path.stat().st_size)


def journal_digest(path: Path) -> str:
    """The same as `JournalWriter.digest`, up to the last whole record. Raises WcsimError when it is no journal."""
    scan = _Scan(path)
    for record in scan.records():
        scan.digest.add(record)
    return scan.digest.hex()


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
    """One reading of a journal; `end` is where the last record that was read ends."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with path.open("rb") as file:
                first = next(whole_records(file), None)
        except OSError as error:
            raise WcsimError(f"{path}: cannot be read ({error.strerror}); expected a journal") from None
        if first is None:
            raise WcsimError(f"{path}: is not a journal; expected a file written by wcsim")
        try:
            self.header = header_of(first.payload)
        except WcsimError as error:
            raise WcsimError(f"{path}: is not a journal of this version: {error}") from None
        self.end = first.end
        self.digest = _Digest(self.header)

    def to_end(self) -> None:
        """Find where the last whole record ends, without a look at what the records say."""
        for _ in self._payloads():
            pass

    def records(self, ticks: bool = True) -> Iterator[JournalRecord]:
        """Those after the header. Raises WcsimError for a whole record that no journal holds."""
        for payload in self._payloads():
            if not ticks and is_tick(payload):
                continue
            try:
                record = record_of(payload)
            except WcsimError as error:
                raise WcsimError(f"{self._path}: after {self.end} bytes: {error}") from None
            yield record

    def _payloads(self) -> Iterator[bytes]:
        with self._path.open("rb") as file:
            file.seek(self.end)
            start = self.end
            for item in whole_records(file):
                yield item.payload
                self.end = start + item.end


def _require_torn_end_only(path: Path, end: int) -> None:
    """Refuse to cut off what may be more than a last record that was never acknowledged.

    Zeros are what a file system leaves where it had no time to write.
    """
    with path.open("rb") as file:
        file.seek(end)
        rest = file.read(MOST_TORN_BYTES + 1)
        if not any(rest):
            return
        size = struct.unpack("<I", rest[:4])[0] + 8 if len(rest) >= 8 else len(rest)
    if len(rest) > MOST_TORN_BYTES or size < len(rest):
        raise WcsimError(f"{path}: is damaged after {end} bytes, and more follows; restore it, or begin a new run")


def _lock(path: Path, file: FileIO) -> None:
    """Two writers would write over each other. The kernel takes the lock back when the file is closed."""
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ConfigError(f"{path}: another process is writing this journal; wait for it, or end that run") from None
    except OSError:  # a file system without locks
        return


def _sync_folder(folder: Path) -> None:
    """Make the name of a new file last."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
