"""The cache of built streets: one .npz file for each state of a town, written whole or not at all.

A file that is read by position, so that copies of a process (`os.fork`) do not move each other's place in it.
"""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from wcsim.core.files import alone
from wcsim.towns.cache.folder import cache_folder, write_whole
from wcsim.towns.cache.street_arrays import street_of
from wcsim.towns.ground.tiles import Packed
from wcsim.types import Street


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


def cached_street(key: str, build: Callable[[], Packed]) -> Street:
    """The street kept under `key`, or a new one, which is kept where that is possible."""
    path = cache_folder() / f"street-{key}.npz"
    found = _read(path)
    if found is not None:
        return found
    with alone(path.with_suffix(".lock")):  # worlds that begin together build it once
        found = _read(path)  # somebody else may have built it meanwhile
        if found is not None:
            return found
        packed = build()
        write_whole(path, lambda file: _save(file, packed))
    return _read(path) or street_of(packed)  # from the file, if there is one, so that only what is used is in memory


def _save(path: Path, packed: Packed) -> None:
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **packed)


def _read(path: Path) -> Street | None:
    """A street over an open file, from which its tiles are read later."""
    try:
        if not zipfile.is_zipfile(path):
            return None
        data = np.load(PreadFile(path), allow_pickle=False)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    try:
        return street_of(data)
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
        data.close()
        return None
