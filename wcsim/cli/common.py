"""What the subcommands share: parsing, JSON files, tables."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro

from wcsim.errors import ConfigError

T = TypeVar("T")
Repeated = Annotated[tuple[str, ...], tyro.conf.UseAppendAction]
"""An option that may be given several times, once for each value."""


def parse(options: type[T], words: list[str], command: str) -> T:
    """Parse a subcommand's options; a mistake prints what was expected and exits with code 2."""
    return tyro.cli(options, args=words, prog=f"wcsim {command}", description=options.__doc__)


def words_of(text: str) -> tuple[str, ...]:
    """The items of a comma-separated option; empty ones are left out.

    >>> words_of("monaco, manhattan")
    ('monaco', 'manhattan')
    """
    return tuple(word.strip() for word in text.split(",") if word.strip())


def write_json(path: Path, data: Any) -> None:
    """Write a result file at once or not at all; NaN and infinity never appear in it."""
    try:
        text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    except ValueError as error:
        raise ConfigError(f"{path}: a result is not a finite number ({error})") from None
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
