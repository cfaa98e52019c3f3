"""Policy folders, read without loading torch: `policy.json` of any, and the one that comes with wcsim."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, TypeVar

import wcsim
from wcsim.config import parse
from wcsim.config.run_file import DangerFile, PolicyFile, ShippedFile
from wcsim.core import files
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


SHIPPED: Final = "shipped"
FILES: Final = "files.json"
HELD: Final = ("policy.json", "weights.safetensors", "model.onnx", "meaning.json", "reference.npz", "MODEL_CARD.md")
_HASHES_KIND: Final = FileKind(what="the files.json of the shipped policy", limit_bytes=1 << 20, error=PolicyError)


def shipped_place() -> Path:
    """Where it lies in this wcsim, whether it is there or not."""
    return Path(wcsim.__file__).parent / "agents" / SHIPPED


def shipped_folder(place: Path | None = None) -> Path:
    """The folder of the shipped policy, its files compared with their hashes.

    Args:
        place: Another folder than the one that comes with wcsim.

    Raises:
        PolicyError: None came with this wcsim, or a file differs from what was shipped.
    """
    folder = shipped_place() if place is None else place
    if not is_file(folder / FILES):
        raise PolicyError(
            f"this wcsim comes without a policy: {escaped(folder)} has no {FILES}; expected one made by "
            "tools/ship_policy.py RUN: name a run of your own"
        )
    try:
        told = parse(ShippedFile, read_json(folder / FILES, _HASHES_KIND), escaped(folder / FILES)).sha256
    except ConfigError as error:
        raise PolicyError(str(error)) from None
    missing = [name for name in HELD if name not in told or not is_file(folder / name)]
    other = [name for name in HELD if name not in missing and files.sha256(folder / name) != told[name]]
    if missing or other:
        raise PolicyError(
            f"{escaped(folder)} differs from what was shipped: {', '.join(missing + other)} "
            f"{'missing' if missing else 'damaged or replaced'}; install wcsim again"
        )
    return folder


def write_hashes(folder: Path) -> None:
    """Say in `files.json` what each file of a shipped policy is. Raises DiskFullError."""
    files.write_json(folder / FILES, {"sha256": {name: files.sha256(folder / name) for name in HELD}})
