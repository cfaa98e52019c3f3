"""Whether SUMO wrote the same with wcsim as without it."""

from pathlib import Path
from typing import BinaryIO


def data_of(path: Path) -> BinaryIO:
    """A file, opened after its header comment, which holds the date and the options."""
    file = path.open("rb")
    head = file.read(1 << 16)
    assert b"<!--" in head and b"-->" in head
    file.seek(head.index(b"-->"))
    return file


def same(ours: Path, plain: Path) -> bool:
    """Whether two files hold the same bytes after their headers; a bit at a time, for they may be large."""
    with data_of(ours) as a, data_of(plain) as b:
        while True:
            left, right = a.read(1 << 22), b.read(1 << 22)
            if left != right:
                return False
            if not left:
                return True
