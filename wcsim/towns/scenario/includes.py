"""Files that a scenario's files include: SUMO reads each as if its elements stood where it is named."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from wcsim.core.reading import shown
from wcsim.errors import TownError
from wcsim.towns.scenario.border import require_file
from wcsim.towns.sumo.xml_io import read_bytes, scan

MAX_DEPTH = 16  # of files that include each other


def with_included(files: Iterable[Path], border: Path | None) -> tuple[Path, ...]:
    """Additional or route files, each followed by all that it includes; what is met again is left out.

    Args:
        files: As a scenario names them, plain or gzip-compressed.
        border: The folder outside of which nothing is opened; None for none.

    Raises:
        TownError: An included file is not there, is no XML, includes itself, or lies outside of the border.
    """
    found: dict[Path, Path] = {}  # by where it really lies, for a file has many names
    for path in files:
        _follow(path, border, (), found)
    return tuple(found.values())


def _follow(path: Path, border: Path | None, above: tuple[Path, ...], found: dict[Path, Path]) -> None:
    real = Path(os.path.realpath(path))
    if real in above or len(above) >= MAX_DEPTH:
        chain = " -> ".join(item.name for item in (*above, real))
        raise TownError(f"{shown(path)}: its files include each other ({chain}); remove one <include>")
    if real in found:
        return
    found[real] = path
    for name in _included(path):
        there = path.parent / name
        require_file(there, border, path)
        _follow(there, border, (*above, real), found)


def _included(path: Path) -> list[str]:
    """The names that a file includes; most files have none, and are not parsed for that."""
    data, names = read_bytes(path), list[str]()
    if b"include" not in data:
        return names

    def visit(tag: str, attributes: list[str]) -> None:
        if tag.rpartition(":")[2] == "include":
            names.append(dict(zip(attributes[::2], attributes[1::2], strict=True)).get("href", ""))

    scan(data, shown(path), visit)
    return [name for name in names if name]
