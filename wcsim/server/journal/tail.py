"""The end of a journal that somebody else is writing: what has come since one looked last. Nothing is locked."""

from __future__ import annotations

import os
import re
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, Final

from wcsim.core.closing import Closing
from wcsim.core.reading import FileKind, opened
from wcsim.errors import JournalError, WcsimError
from wcsim.server.journal.parts import part_files
from wcsim.server.journal.records import JournalHeader, JournalRecord, header_of, is_chained, record_of
from wcsim.users.recording.framing import torn_bytes, whole_records

_KIND: Final = FileKind(what="a journal", limit_bytes=1 << 62, error=JournalError)
_LOCKS: Final = Path("/proc/locks")


class JournalTail(Closing):
    """Reads a journal from the beginning of its newest part on, and goes over into the part that follows it.

    Args:
        path: Of the journal; it need not be there yet.
    """

    def __init__(self, path: Path) -> None:
        self.header: JournalHeader | None = None  # once there is a journal
        self._path, self._held = path, ExitStack()
        self._file: BinaryIO | None = None
        self._end, self._after = 0, None  # type: int, int | None

    def read(self, most: int = 1000) -> list[JournalRecord]:
        """The records that have come, oldest first, so many at the most; none where nothing has come.

        Raises:
            JournalError: It is no journal, or damaged.
        """
        if self._file is None and not self._open():
            return []
        found = self._records(most)
        if found or not self._is_over():
            return found
        found = self._records(most)  # what came before its part was put aside, but after the first look
        if found:
            return found
        self.close()
        return self._records(most) if self._open() else []

    def close(self) -> None:
        """Close the file; reading goes on with the newest part."""
        self._held.close()
        self._file = None

    def is_written(self) -> bool | None:
        """Whether a process has the journal open for writing; None where that cannot be known.

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
        file = self._held.enter_context(opened(parts[-1], _KIND))
        first = next(whole_records(file), None)
        if first is None:
            self._held.close()
            if parts[-1].stat().st_size > 0:
                raise JournalError(f"{parts[-1]}: is not a journal; expected a file written by wcsim")
            return False
        try:
            self.header = header_of(first.payload)
        except WcsimError as error:
            raise JournalError(f"{parts[-1]}: is not a journal of this version: {error}") from None
        self._file, self._end = file, first.end
        self._after = first.crc if is_chained(first.payload) else None
        return True

    def _records(self, most: int) -> list[JournalRecord]:
        file, found = self._file, list[JournalRecord]()
        if file is None:
            return found
        start = file.seek(self._end)
        for item in whole_records(file, self._after):
            try:
                found.append(record_of(item.payload))
            except WcsimError as error:
                raise JournalError(f"{self._path}: after {self._end} bytes: {error}") from None
            self._end, self._after = start + item.end, None if self._after is None else item.crc
            if len(found) >= most:
                break
        if not found and torn_bytes(file, self._end, self._after) is None:
            raise JournalError(f"{self._path}: is damaged at byte {self._end}; restore it from a copy")
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
