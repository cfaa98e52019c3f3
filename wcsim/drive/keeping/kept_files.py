"""Names for the files of a drive: one world is one file, and another world is the next file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from wcsim.core.reading import shown
from wcsim.errors import ConfigError

_MOST: Final = 10_000


def require_new(path: Path, option: str) -> Path:
    """The same path. Raises ConfigError when something is there already, or nothing can be written there."""
    if os.path.lexists(path):
        raise ConfigError(f"{option} {shown(path)} exists; expected the name of a new file")
    folder = next(each for each in path.absolute().parents if each.exists())
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise ConfigError(
            f"{option} {shown(path)}: {shown(folder)} cannot be written to; choose another place with {option}"
        )
    return path


def file_names(first: Path) -> Iterator[Path]:
    """The first name, and then FILE-2, FILE-3, ... of which nothing is there yet.

    >>> names = file_names(Path("no-such-folder/a.drive"))
    >>> [str(next(names)) for _ in range(3)]
    ['no-such-folder/a.drive', 'no-such-folder/a-2.drive', 'no-such-folder/a-3.drive']
    """
    for number in range(1, _MOST + 1):
        path = first if number == 1 else first.with_name(f"{first.stem}-{number}{first.suffix}")
        if not os.path.lexists(path):
            yield path
