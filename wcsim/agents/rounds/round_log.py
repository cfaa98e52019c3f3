"""metrics.csv of a danger network's run: one row a round, written when it is done."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from wcsim.config import parse
from wcsim.config.run_file import TrainedRound
from wcsim.core import files
from wcsim.core.reading import FileKind, escaped, read_text
from wcsim.errors import ConfigError, PolicyError

_COLUMNS: Final = (
    *("round", "steps", "new_steps", "tight_share", "crashes", "updates", "loss"),
    *("wait_s_wall", "learn_s_wall"),
)
_KIND = FileKind(what="the metrics.csv of a run", limit_bytes=1 << 30, error=PolicyError)


def note_round(path: Path, row: Sequence[float]) -> None:
    """Add a row to metrics.csv; rows from its round on belong to work that was lost.

    Raises:
        DiskFullError: There is no room.
        PolicyError: The file is damaged, or of another version.
    """
    old = _rows(path) if path.is_file() else []
    table = (_COLUMNS, *(cells for cells in old if int(cells[0]) < row[0]), map(_cell, row))
    files.write_bytes(path, "".join(f"{','.join(cells)}\n" for cells in table).encode())


def _cell(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def logs_rounds(path: Path) -> bool:
    """Whether a metrics.csv is one of rounds."""
    return read_text(path, _KIND).startswith(",".join(_COLUMNS[:2]) + ",")


def read_rounds(path: Path) -> tuple[TrainedRound, ...]:
    """All rows of it. Raises PolicyError when it is damaged, or of another version."""
    return tuple(_round(row, number, path) for number, row in enumerate(_rows(path)))


def _rows(path: Path) -> list[list[str]]:
    """The rows below the head, which has this version's columns."""
    try:
        rows = list(csv.reader(io.StringIO(read_text(path, _KIND), newline="")))
    except csv.Error:  # a cell of more than 128 kB
        rows = []
    if not rows or tuple(rows[0]) != _COLUMNS:
        got = escaped(", ".join(rows[0])) if rows else "none"
        raise PolicyError(f"{escaped(path)} has columns {got}; expected those of this version: {', '.join(_COLUMNS)}")
    for number, row in enumerate(rows[1:]):
        if len(row) != len(_COLUMNS) or row[0] != str(number):
            raise _damaged(path, number)
    return rows[1:]


def _damaged(path: Path, number: int) -> PolicyError:
    return PolicyError(f"{escaped(path)}: row {number + 1} is damaged; expected {len(_COLUMNS)} numbers of a round")


def _round(row: Sequence[str], number: int, path: Path) -> TrainedRound:
    try:
        return parse(TrainedRound, dict(zip(TrainedRound.model_fields, row, strict=True)), path.name)
    except ConfigError:
        raise _damaged(path, number) from None
