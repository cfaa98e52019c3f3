"""`policy.json`, read without loading torch."""

from __future__ import annotations

from pathlib import Path

from wcsim.config import parse
from wcsim.config.run_file import PolicyFile
from wcsim.core.reading import FileKind, is_file, read_json, shown
from wcsim.errors import ConfigError, PolicyError

POLICY_JSON = "policy.json"
_KIND = FileKind(what="the policy.json of a policy folder", limit_bytes=1 << 20, error=PolicyError)


def read_policy_file(path: Path) -> PolicyFile:
    """Read and check `policy.json` of a policy folder. Raises PolicyError."""
    file = path / POLICY_JSON
    if not is_file(file):
        raise PolicyError(
            f"{shown(path)} is not a policy folder: it has no {POLICY_JSON}; "
            "expected a folder as `wcsim train` writes it, for example runs/a/policies/final, or RUN:phase1"
        )
    try:
        return parse(PolicyFile, read_json(file, _KIND), shown(file))
    except ConfigError as error:
        raise PolicyError(str(error)) from None
