"""What is wrong around a command and no fault of wcsim's: folders, streams, bytes in arguments, variables."""

from __future__ import annotations

import errno
import io
import os
import shutil
import sys
import traceback
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from wcsim.cli.shared.exit_codes import Exit
from wcsim.core.reading import escaped, holds_half_letters
from wcsim.errors import ConfigError

_PATHS: Final = frozenset(
    {
        *(errno.ENOENT, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EISDIR),
        *(errno.EEXIST, errno.ENAMETOOLONG, errno.ELOOP, errno.ENXIO, errno.ENODEV, errno.ESTALE),
    }
)
_NOTHING: Final = Path(os.devnull)
_LEAST_COLUMNS: Final = 40
_PACKAGE: Final = Path(__file__).parents[2]


def require_streams() -> None:
    """Put the empty device in the place of a stream that is closed, else the next file that is opened would be it.

    A terminal of a few columns counts as one of 40: in less the help is laid out for minutes.

    Raises:
        ConfigError: Standard output is closed.
    """
    if shutil.get_terminal_size().columns < _LEAST_COLUMNS:
        os.environ["COLUMNS"] = str(_LEAST_COLUMNS)
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(_NOTHING, os.O_RDWR)  # the lowest number that is free
    sys.stdin = sys.stdin or _NOTHING.open(encoding="utf-8")
    sys.stderr = sys.stderr or _NOTHING.open("w", encoding="utf-8")
    if sys.stdout is None:
        sys.stdout = _NOTHING.open("w", encoding="utf-8")
        raise ConfigError("standard output is closed; if you do not need it, add: > /dev/null")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal may know few letters


def require_letters(words: Iterable[str]) -> None:
    """Raise ConfigError for an argument that holds bytes which are no letters: no record of ours could name it."""
    for word in words:
        if holds_half_letters(word):
            raise ConfigError(f"argument '{escaped(word)}' is not valid UTF-8; rename that file, or set LANG=C.UTF-8")


def told_cause(error: Exception) -> tuple[str, Exit]:
    """What to do about an error whose cause is around the command, and how that ends; "" for a fault of ours."""
    from wcsim.server.protocol.limits import told_limit  # as seldom wanted as this is

    limit = told_limit(error)
    if limit:
        return limit, Exit.FAILED
    last = traceback.extract_tb(error.__traceback__)[-1:]
    variables = [name for name in os.environ if name.startswith("NUMBA_")]
    if isinstance(error, ValueError) and variables and any("numba" in Path(frame.filename).parts for frame in last):
        return (
            f"numba refuses its settings ({escaped(error)}); try again after: unset {' '.join(variables)}",
            Exit.REFUSED,
        )
    told = _told_path(error) if isinstance(error, OSError) and error.errno in _PATHS else ""
    ours = any(frame.name == "_execute_child" for frame in last)  # of subprocess: a program that we want
    return (told, Exit.REFUSED) if told and not ours else ("", Exit.FAILED)


def _told_path(error: OSError) -> str:
    """What to do about a path that cannot be used; "" for one of the package."""
    try:
        Path.cwd()
    except OSError:
        return "the working folder does not exist any more; change to another one: cd"
    path = error.filename2 or error.filename
    if not isinstance(path, str | bytes) or _PACKAGE in Path(os.fsdecode(path)).parents:
        return ""
    told = f"{escaped(os.fsdecode(path))}: {error.strerror}"
    return f"{told}; choose another path, or make this one usable"
