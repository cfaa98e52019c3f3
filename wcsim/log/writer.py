"""Writes a log: a file that grows record by record and is whole after each.

A killed process loses nothing that `append` has returned from. A journal is of a world that must be
made again after a crash: a machine that loses its power loses at most its last second or its last
50 ticks. A truncated end is cut off, and saved beside the log, before the log is continued.
"""

import fcntl
import os
import time
from io import FileIO
from itertools import count
from pathlib import Path
from typing import Final, Self

from wcsim.core.closing import ClosingContextBase
from wcsim.core.reading import escape
from wcsim.errors import ConfigError, DiskFullError, WcsimError
from wcsim.log import records
from wcsim.log.framing import MOST_TRUNCATED_BYTES, crc_from_record, frame_payload
from wcsim.log.reader import LogScan

JOURNAL: Final = "journal"  # its name in a run folder
TRACE: Final = "trace"
MOST_RECORDS: Final = 1_000_000  # of a drive, which is read at once; a day of ten ticks a second
_SYNC_TICKS: Final = 50
_SYNC_S: Final = 1.0


class LogWriter(ClosingContextBase):
    """Appends to a log; a context manager."""

    def __init__(self, path: Path, header: records.Header) -> None:
        """Start a log; its file appears with its header.

        Raises:
            ConfigError: The file exists or cannot be made, or no reader would take the header.
            DiskFullError: It could not be written.
        """
        # 1. Check the header: with one out of bounds nothing of the log could be read again.
        try:
            first = records.header_to_bytes(header)
            records.header_from_bytes(first)
        except (WcsimError, ValueError) as error:
            raise ConfigError(
                f"{escape(path)}: its header is out of bounds ({error}); change seed, tick or steps"
            ) from None
        # 2. Make a file beside it.
        beside = path.with_name(f".{path.name}.new")
        try:
            if os.path.lexists(path):
                raise FileExistsError(17, "File exists")
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
            file = FileIO(os.open(beside, flags, 0o644), "r+b")
        except OSError as error:
            reason = error.strerror or error
            raise ConfigError(
                f"{escape(path)}: cannot be created ({reason}); choose the name of a new file"
            ) from None
        # 3. Lock it. Where that fails another process starts this log: the file stays.
        try:
            self._open(path, file, header)
        except BaseException:
            file.close()
            raise
        # 4. Write the header, then give the file its name.
        try:
            file.truncate(0)
            self._write(first)
            self._sync()
            beside.replace(path)
            # The name of a new file lasts once its folder is on the disk.
            if self._is_journal:
                folder = os.open(path.parent, os.O_RDONLY)
                try:
                    os.fsync(folder)
                finally:
                    os.close(folder)
        except BaseException as error:
            file.close()
            beside.unlink(missing_ok=True)
            if isinstance(error, OSError):
                raise DiskFullError(
                    f"{escape(path)}: cannot be created ({error.strerror}); check the disk"
                ) from None
            raise

    @classmethod
    def append_to(cls, path: Path, expected: records.LogKind | None = None) -> Self:
        """Continue a log after its process has died; a truncated last record is cut off and saved.

        `cut_bytes` is how many bytes were cut off.

        Raises:
            ConfigError: It cannot be written, or another process is writing it.
            JournalError: It is no log, of another kind than expected, or damaged before its end.
            DiskFullError: There is no room to save what would be cut off.
        """
        scan = LogScan(path, expected)
        try:
            file = FileIO(path, "r+b")
        except OSError as error:
            raise ConfigError(f"{escape(path)}: cannot be continued ({error.strerror})") from None
        self = cls.__new__(cls)
        try:
            self._open(path, file, scan.header)
            scan.skip_to_end()
            self.cut_bytes = scan.truncated_bytes
            if scan.truncated_bytes:
                file.seek(scan.end)
                # What is longer is zeros, which are not saved.
                _save_truncated(path, file.read(min(scan.truncated_bytes, MOST_TRUNCATED_BYTES)))
                file.truncate(scan.end)
            self._end = file.seek(scan.end)
            self._after = scan.after
        except BaseException:
            file.close()
            raise
        return self

    def _open(self, path: Path, file: FileIO, header: records.Header) -> None:
        # Two writers would overwrite each other. The kernel releases the lock with the file.
        try:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(
                f"{escape(path)}: another process is writing this log; wait for it, or stop that "
                "run"
            ) from None
        except OSError:  # a file system without locks
            pass
        self._path = path
        self._file = file
        self._end = 0
        self._after = 0  # CRC of the last record
        self.cut_bytes = 0  # of a truncated end
        self._is_journal = header.kind == "journal"
        self._is_drive = header.kind == "drive"
        self._records = 0
        self._unsynced = 0
        self._synced_s = time.monotonic()
        self._bodies: dict[str, records.ActorBody] = {}  # as last written, by actor

    def append(self, record: records.LogRecord) -> None:
        """Write one record; when this returns, the death of this process does not undo it.

        Raises:
            DiskFullError: It could not be written; the log is as before, and can be appended to.
            WcsimError: The log is closed; or a drive's is full, or a number is out of bounds.
        """
        # A body is written when it is new or differs from the one before.
        if isinstance(record, records.WorldState):
            new = tuple(body for body in record.bodies if self._bodies.get(body.id) != body)
            self._bodies.update((body.id, body) for body in new)
            record = records.with_fields(record, bodies=new)
        payload = records.record_to_bytes(record)
        # The numbers of a drive are of a person and a policy, so they may be anything.
        if self._is_drive:
            self._require_readable(payload)
        self._write(payload)
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
                f"{escape(self._path)}: is full, with {self._records} records; start another one"
            )
        try:
            records.record_from_bytes(payload)
        except WcsimError as error:
            raise WcsimError(
                f"{escape(self._path)}: a number is not finite or out of its bounds ({error}); "
                "expected sticks of -1 to 1, and a place in the town"
            ) from None

    def _write(self, payload: bytes) -> None:
        """Write a record, unbuffered; on a full disk the part that was written is taken back."""
        if self._file.closed:
            raise WcsimError(
                f"{escape(self._path)}: this log is closed; open it again to continue it"
            )
        data = frame_payload(payload, self._after)
        try:
            written = self._file.write(data) or 0
            # A second write raises the reason for which the first stopped.
            if written < len(data):
                written += self._file.write(data[written:]) or 0
            reason = "" if written == len(data) else "only a part was written"
        except OSError as error:
            reason = str(error.strerror)
        if reason:
            try:
                self._file.truncate(self._end)
                self._file.seek(self._end)
            except OSError:
                # Nothing may follow half a record.
                self._file.close()
            raise DiskFullError(
                f"{escape(self._path)}: a record could not be written ({reason}); the first "
                f"{self._end} bytes are intact: make room"
            )
        self._end += len(data)
        self._after = crc_from_record(data)

    def _sync(self) -> None:
        try:
            if self._is_journal:
                os.fdatasync(self._file.fileno())
        except OSError as error:
            raise DiskFullError(
                f"{escape(self._path)}: could not be flushed to disk ({error.strerror}); check "
                "the disk"
            ) from None
        self._unsynced = 0
        self._synced_s = time.monotonic()


def format_truncation_warning(path: Path, cut_bytes: int) -> str:
    """That the end of a log was cut off, for its user."""
    return (
        f"{path}: the last {cut_bytes} bytes were an incomplete record and were cut off; see "
        f"{path.name}.torn beside it"
    )


def _save_truncated(path: Path, data: bytes) -> None:
    """Write what will be cut off a log to `NAME.torn` beside it, or `NAME.torn-2`, ...

    Zeros, which a file system leaves where it had no time to write, are not worth a file.

    Raises:
        DiskFullError: It could not be saved; nothing may be cut off then.
    """
    if not any(data):
        return
    names = (path.with_name(f"{path.name}.torn{'' if k == 1 else f'-{k}'}") for k in count(1))
    saved = next(name for name in names if not os.path.lexists(name))
    try:
        with saved.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        saved.unlink(missing_ok=True)
        raise DiskFullError(
            f"{path}: its incomplete end of {len(data)} bytes could not be saved "
            f"({error.strerror}); make room"
        ) from None
