"""A journal of a long run lies in parts: what ended as planned is put aside, so that the file in use stays short.

`journal` is the part that is being written, `journal.00001`, `journal.00002`, ... are those before it.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

_DIGITS = 5


def part_files(path: Path) -> tuple[Path, ...]:
    """The parts of a journal that are there, the oldest first and the one in use last.

    >>> part_files(Path("nowhere/journal"))
    ()
    """
    aside = re.compile(rf"{re.escape(path.name)}\.[0-9]{{{_DIGITS},}}")
    try:
        before = sorted((part for part in path.parent.iterdir() if aside.fullmatch(part.name)), key=_number)
    except OSError:
        before = []
    return (*before, path) if os.path.lexists(path) else tuple(before)


def put_aside(path: Path) -> Path:
    """Give the part in use the next number; returns its new name. Nobody may have it open for writing."""
    before = [part for part in part_files(path) if part != path]
    number = 1 + (_number(before[-1]) if before else 0)
    aside = path.with_name(f"{path.name}.{number:0{_DIGITS}d}")
    path.rename(aside)
    return aside


def _number(part: Path) -> int:
    return int(part.name.rpartition(".")[2])
