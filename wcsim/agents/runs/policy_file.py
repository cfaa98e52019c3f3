"""`policy.json`, read without loading torch."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from wcsim.config import parse
from wcsim.config.run_file import DangerFile, PolicyFile
from wcsim.core.reading import FileKind, escaped, is_file, read_json
from wcsim.errors import ConfigError, PolicyError

POLICY_JSON, WEIGHTS = "policy.json", "weights.safetensors"
SIGHT_KEYS = ("hfov_deg", "range_m", "near_m", "p_BC_m", "yaw_deg", "pitch_deg", "roll_deg")
"""Of a camera: what makes the same street look different to a network."""
File = TypeVar("File", PolicyFile, DangerFile)
_KIND = FileKind(what="the policy.json of a policy folder", limit_bytes=1 << 20, error=PolicyError)


def read_policy_file(path: Path) -> PolicyFile:
    """Read and check `policy.json` of a network that gives values. Raises PolicyError."""
    return _parsed(PolicyFile, path)


def read_danger_file(path: Path) -> DangerFile:
    """Read and check `policy.json` of a danger network. Raises PolicyError."""
    return _parsed(DangerFile, path)


def is_danger(path: Path) -> bool:
    """Whether a policy folder holds a danger network. Raises PolicyError when it is no policy folder."""
    return _read(path).get("algorithm") == "danger"


def _parsed(model: type[File], path: Path) -> File:
    try:
        return parse(model, _read(path), escaped(path / POLICY_JSON))
    except ConfigError as error:
        raise PolicyError(str(error)) from None


def _read(path: Path) -> dict[str, Any]:
    if not is_file(path / POLICY_JSON):
        raise PolicyError(
            f"{escaped(path)} is not a policy folder: it has no {POLICY_JSON}; "
            "expected a folder as `wcsim train` writes it, for example runs/a/policies/final, or RUN:phase1"
        )
    return read_json(path / POLICY_JSON, _KIND)
