"""A file that is read by position, so that copies of a process (`os.fork`) do not move each other's place in it."""

from __future__ import annotations

import io
import os
from pathlib import Path


class PreadFile(io.RawIOBase):
    """An open file for reading; its place is this object's own, where a descriptor's is shared with every copy."""

    def __init__(self, path: Path) -> None:
        """Raises OSError when it cannot be opened."""
        super().__init__()
        self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        self._size = os.fstat(self._fd).st_size
        self._at = 0

    def readable(self) -> bool:
        """It is."""
        return True

    def seekable(self) -> bool:
        """It is."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the place; returns it. Raises ValueError for one before the beginning."""
        at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        if at < 0:
            raise ValueError(f"place {at} in a file; expected 0 or more")
        self._at = at
        return at

    def tell(self) -> int:
        """The place."""
        return self._at

    def readinto(self, buffer: bytearray | memoryview) -> int:  # type: ignore[override]  # typeshed: any writable buffer
        """Read what fits, from the place on; 0 at the end."""
        count = os.preadv(self._fd, [buffer], self._at)
        self._at += count
        return count

    def close(self) -> None:
        """Give the file back; a second call does nothing."""
        if not self.closed:
            os.close(self._fd)
        super().close()
