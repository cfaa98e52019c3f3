"""The guard of an exported policy, as its `meaning.json` says it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from wcsim.agents.export.guard import GuardRule
from wcsim.config import parse
from wcsim.config.run_file import GuardFile
from wcsim.core.reading import FileKind, escaped, is_file, read_json
from wcsim.errors import ConfigError, PolicyError

MEANING: Final = "meaning.json"
_KIND: Final = FileKind(what="the meaning.json of an exported policy", limit_bytes=4 << 20, error=PolicyError)


def guard_of(folder: Path) -> GuardRule | None:
    """The guard of an ONNX folder; None where it has none. Raises PolicyError when it cannot be read."""
    if not is_file(folder / MEANING):
        return None
    said = read_json(folder / MEANING, _KIND).get("guard")
    if not isinstance(said, dict):
        return None
    try:
        return GuardRule(**parse(GuardFile, said, escaped(folder / MEANING)).model_dump())
    except ConfigError as error:
        raise PolicyError(str(error)) from None
