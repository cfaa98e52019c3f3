"""What is cut off the end of a log is kept beside it."""

from __future__ import annotations

import os
from itertools import count
from pathlib import Path

from wcsim.errors import DiskFullError


def keep_torn(path: Path, data: bytes) -> Path:
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
    return (
        f"{path}: the last {cut_bytes} bytes were an incomplete record and were cut off; see {path.name}.torn beside it"
    )
