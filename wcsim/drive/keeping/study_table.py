"""The table of a study: a row for each participant and block, which only ever grows; comma-separated values."""

from __future__ import annotations

import contextlib
import csv
import fcntl
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from wcsim.config.study import StudyFile, StudyQuestion
from wcsim.core.reading import FileKind, read_text, shown
from wcsim.errors import ConfigError, DiskFullError

COLUMNS: Final = (
    *("study", "study_sha256", "wcsim", "participant", "order", "part", "block", "assistance", "level"),
    *("policy", "town", "seed", "episode", "recording", "ended", "minutes", "kpi1", "kpi2", "distance_m", "speed_mps"),
    *("arrivals", "given_up", "crashes", "warnings", "interventions", "helps", "overrulings"),
    "policy_failed",
)
"""What every row has; the answers come after them, `answer_` and the question's name each."""

_TABLE = FileKind(what="a study's table", limit_bytes=64 << 20)
_MOST_ROWS: Final = 200_000

Row = Mapping[str, str]


def columns_of(study: StudyFile) -> tuple[str, ...]:
    """The columns of a study's table."""
    return (*COLUMNS, *(answer_column(question) for question in study.questions))


def answer_column(question: StudyQuestion) -> str:
    """The column of a question's answers."""
    return f"answer_{question.name}"


def answers_of(question: StudyQuestion) -> tuple[str, ...]:
    """The answers that a question has, as they stand in the table.

    >>> answers_of(StudyQuestion(name="a", asks="A?", low="no", high="very", steps=3))
    ('1', '2', '3')
    >>> answers_of(StudyQuestion(name="b", asks="B?", kind="yes_no"))
    ('yes', 'no')
    """
    if question.kind == "scale":
        return tuple(str(step) for step in range(1, question.steps + 1))
    return ("yes", "no") if question.kind == "yes_no" else question.choices


def read_rows(path: Path, columns: Sequence[str]) -> tuple[dict[str, str], ...]:
    """All rows of a table; none where there is no file.

    Raises:
        ConfigError: It has other columns, or cannot be read as a table.
    """
    if not os.path.lexists(path):
        return ()
    text = read_text(path, _TABLE)
    if text and not text.endswith("\n"):
        raise ConfigError(f"{shown(path)}: its last line is incomplete; complete it, or remove it")
    try:
        lines = [line for line in csv.reader(io.StringIO(text, newline=""), strict=True) if line]
    except csv.Error:
        lines = []
    if not lines or tuple(lines[0]) != tuple(columns):
        raise ConfigError(
            f"{shown(path)}: its columns are not those of this study; expected the table of the same study file: "
            "name another folder with --out"
        )
    if len(lines) > _MOST_ROWS or any(len(line) != len(columns) for line in lines):
        raise ConfigError(f"{shown(path)}: is not a table with {len(columns)} columns; expected one that wcsim wrote")
    return tuple(dict(zip(columns, line, strict=True)) for line in lines[1:])


def append_row(path: Path, columns: Sequence[str], row: Row) -> None:
    """Write a row at a table's end, with the columns' names where it is a new one; whole, or not at all.

    Raises:
        ConfigError: The file cannot be opened.
        DiskFullError: It could not be written on.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
    except OSError as error:
        raise ConfigError(f"{shown(path)}: cannot be written ({error.strerror}); choose another --out") from None
    try:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)  # another participant's drive may write on it at the same time
        end = os.fstat(handle).st_size
        torn = end > 0 and os.pread(handle, 1, end - 1) != b"\n"  # somebody's editor has saved it without its end
        data = (b"\n" if torn else b"" if end else _line(columns)) + _line([row.get(name, "") for name in columns])
        try:
            written = os.pwrite(handle, data, end)
            reason = "" if written == len(data) else "only a part was written"
        except OSError as error:
            reason = str(error.strerror)
        if reason:
            os.ftruncate(handle, end)
            raise DiskFullError(
                f"{shown(path)}: a row could not be written ({reason}); free some disk space, and press again"
            )
        os.fsync(handle)
    finally:
        os.close(handle)


def _line(words: Sequence[str]) -> bytes:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(words)
    return line.getvalue().encode()
