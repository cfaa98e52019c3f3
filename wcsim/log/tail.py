"""The end of a log that somebody else is writing: what has come since one looked last. Nothing is locked."""

from __future__ import annotations

import os
import re
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, Final

from wcsim.core.closing import Closing
from wcsim.core.reading import opened
from wcsim.errors import JournalError
from wcsim.log.reader import LOG_FILE, LogScan, part_files
from wcsim.log.records import Header, Input

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
        found = self._records(most)  # what came before its part was put aside, but after the first look
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
        self._file = self._held.enter_context(opened(parts[-1], LOG_FILE))
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
