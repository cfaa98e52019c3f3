"""`policy.json`, read without loading torch."""

from __future__ import annotations

import json
from pathlib import Path

from wcsim.config import PolicyFile, parse
from wcsim.errors import ConfigError, PolicyError

POLICY_JSON = "policy.json"
MAX_POLICY_JSON_BYTES = 1 << 20


def read_policy_file(path: Path) -> PolicyFile:
    """Read and check `policy.json` of a policy folder. Raises PolicyError."""
    file = path / POLICY_JSON
    try:
        if file.stat().st_size > MAX_POLICY_JSON_BYTES:
            raise PolicyError(f"{file} is larger than {MAX_POLICY_JSON_BYTES} bytes; expected a small JSON file")
        data = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise PolicyError(
            f"{path} is not a policy folder: {POLICY_JSON} cannot be read ({error.strerror}); "
            "expected a folder as `wcsim train` writes it, for example runs/a/policies/final, or RUN:phase1"
        ) from None
    except (ValueError, RecursionError) as error:
        raise PolicyError(f"{file} is not JSON: {error}") from None
    if not isinstance(data, dict):
        raise PolicyError(f"{file} holds a {type(data).__name__}; expected a JSON object")
    try:
        return parse(PolicyFile, data, str(file))
    except ConfigError as error:
        raise PolicyError(str(error)) from None
