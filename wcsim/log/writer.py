"""Writing a log: a file that grows record by record and is whole after each; what is cut off its end is kept.

A killed process loses nothing that `append` has returned from. Where the log is of a world that must be made again
after a crash (a journal), a machine that loses its power loses at most the last second or the last 50 ticks.
"""

from __future__ import annotations

import fcntl
import os
import time
from io import FileIO
from itertools import count
from pathlib import Path
from typing import Final, Self

from wcsim.core.closing import Closing
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError, DiskFullError, WcsimError
from wcsim.log.framing import MOST_TORN_BYTES, crc_of, framed
from wcsim.log.reader import LogScan
from wcsim.log.records import (
    ActorBody,
    Header,
    LogKind,
    LogRecord,
    WorldState,
    changed,
    header_bytes,
    header_of,
    record_bytes,
    record_of,
)


def _keep_torn(path: Path, data: bytes) -> Path:
    """Write what will be cut off a file into `NAME.torn` beside it, or `NAME.torn-2`, ...; returns which.

    Zeros, which a file system leaves where it had no time to write, are not worth a file: then it is the file itself.

    Raises:
        DiskFullError: It could not be kept; nothing may be cut off then.
    """
    if not any(data):
        return path
    names = (path.with_name(f"{path.name}.torn{'' if k == 1 else f'-{k}'}") for k in count(1))
    kept = next(name for name in names if not os.path.lexists(name))
    try:
        with kept.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        kept.unlink(missing_ok=True)
        raise DiskFullError(
            f"{path}: its incomplete end of {len(data)} bytes could not be saved ({error.strerror}); make room"
        ) from None
    return kept


def told_torn(path: Path, cut_bytes: int) -> str:
    """That something was cut off, in words for a person."""
    return f"{path}: the last {cut_bytes} bytes were an incomplete record and were cut off; see {path.name}.torn beside it"


JOURNAL: Final = "journal"  # its name in a run folder
TRACE: Final = "trace"
MOST_RECORDS: Final = 1_000_000  # of a drive, which is read at once; a day of ten ticks a second
_SYNC_TICKS, _SYNC_S = 50, 1.0


class LogWriter(Closing):
    """Appends to a log; a context manager."""

    def __init__(self, path: Path, header: Header) -> None:
        """Begin a log; it appears with its header.

        Raises:
            ConfigError: The file is there already or cannot be made, or the header holds what no reader takes.
            DiskFullError: It could not be written on.
        """
        first = _first_payload(header, path)
        beside = path.with_name(f".{path.name}.new")
        try:
            if os.path.lexists(path):
                raise FileExistsError(17, "File exists")
            path.parent.mkdir(parents=True, exist_ok=True)
            file = FileIO(
                os.open(beside, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644), "r+b"
            )
        except OSError as error:
            reason = error.strerror or error
            raise ConfigError(
                f"{escaped(path)}: cannot be created ({reason}); choose the name of a new file"
            ) from None
        try:
            self._open(path, file, header)
        except BaseException:  # another process begins it
            file.close()
            raise
        try:
            file.truncate(0)
            self._put(first)
            self._sync()
            beside.replace(path)
            if self._lasts:
                _sync_folder(path.parent)
        except BaseException as error:
            file.close()
            beside.unlink(missing_ok=True)
            if isinstance(error, OSError):
                raise DiskFullError(
                    f"{escaped(path)}: cannot be created ({error.strerror}); check the disk"
                ) from None
            raise

    @classmethod
    def append_to(cls, path: Path, expected: LogKind | None = None) -> Self:
        """Go on with a log after its process has died; a torn last record is cut off, and kept beside it.

        Raises:
            ConfigError: It cannot be written, or another process is writing it.
            JournalError: It is no log, of another kind than expected, or is damaged before its end.
            DiskFullError: There is no room to keep what would be cut off.
        """
        scan = LogScan(path, expected)
        try:
            file = FileIO(path, "r+b")
        except OSError as error:
            raise ConfigError(f"{escaped(path)}: cannot be continued ({error.strerror})") from None
        self = cls.__new__(cls)
        try:
            self._open(path, file, scan.header)
            scan.to_end()
            self.cut_bytes = scan.torn_bytes
            if scan.torn_bytes:
                file.seek(scan.end)
                _keep_torn(
                    path, file.read(min(scan.torn_bytes, MOST_TORN_BYTES))
                )  # what is longer is zeros
                file.truncate(scan.end)
            self._end, self._after = file.seek(scan.end), scan.after
        except BaseException:
            file.close()
            raise
        return self

    def _open(self, path: Path, file: FileIO, header: Header) -> None:
        _lock(path, file)
        self._path, self._file, self._end = path, file, 0
        self._after = 0  # CRC of the last record
        self.cut_bytes = 0  # of a torn end
        self._lasts = header.kind == "journal"
        self._checks = header.kind == "drive"  # its numbers are a person's and a policy's
        self._records = 0
        self._unsynced, self._synced_s = 0, time.monotonic()
        self._told: dict[
            str, ActorBody
        ] = {}  # a body is written when it is new or another one than before

    def append(self, record: LogRecord) -> None:
        """Write one record; when this returns, the death of this process does not undo it.

        Raises:
            DiskFullError: It could not be written; the log is what it was before, and can be appended to later.
            WcsimError: The log is closed; or a drive's is full, or a number of its record is out of bounds.
        """
        if isinstance(record, WorldState):
            new = tuple(body for body in record.bodies if self._told.get(body.id) != body)
            self._told.update((body.id, body) for body in new)
            record = changed(record, bodies=new)
        payload = record_bytes(record)
        if self._checks:
            self._require_readable(payload)
        self._put(payload)
        self._unsynced += 1
        self._records += 1
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

    def _require_readable(self, payload: bytes) -> None:
        """Raise WcsimError for what `read_drive` would refuse."""
        if self._records >= MOST_RECORDS:
            raise WcsimError(
                f"{escaped(self._path)}: is full, with {self._records} records; start another one"
            )
        try:
            record_of(payload)
        except WcsimError as error:
            raise WcsimError(
                f"{escaped(self._path)}: a number is not finite or out of its bounds ({error}); expected sticks of "
                "-1 to 1, and a place in the town"
            ) from None

    def _put(self, payload: bytes) -> None:
        """One unbuffered write; on a full disk the part that was written is taken back."""
        if self._file.closed:
            raise WcsimError(
                f"{escaped(self._path)}: this log is closed; open it again to continue it"
            )
        data = framed(payload, self._after)
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
                f"{escaped(self._path)}: a record could not be written ({reason}); the first {self._end} bytes are "
                f"intact: make room"
            )
        self._end += len(data)
        self._after = crc_of(data)

    def _take_back(self) -> None:
        try:
            self._file.truncate(self._end)
            self._file.seek(self._end)
        except OSError:  # nothing may follow half a record
            self._file.close()

    def _sync(self) -> None:
        try:
            if self._lasts:
                os.fdatasync(self._file.fileno())
        except OSError as error:
            raise DiskFullError(
                f"{escaped(self._path)}: could not be flushed to disk ({error.strerror}); check the disk"
            ) from None
        self._unsynced, self._synced_s = 0, time.monotonic()


def _first_payload(header: Header, path: Path) -> bytes:
    """The record of a header. Raises ConfigError for one with which the whole log could not be read again."""
    try:
        payload = header_bytes(header)
        header_of(payload)
    except (WcsimError, ValueError) as error:
        raise ConfigError(
            f"{escaped(path)}: its header is out of bounds ({error}); change seed, tick or steps"
        ) from None
    return payload


def _lock(path: Path, file: FileIO) -> None:
    """Two writers would write over each other. The kernel takes the lock back when the file is closed."""
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ConfigError(
            f"{escaped(path)}: another process is writing this log; wait for it, or stop that run"
        ) from None
    except OSError:  # a file system without locks
        return


def _sync_folder(folder: Path) -> None:
    """Make the name of a new file last."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
