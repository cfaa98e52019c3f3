"""The policy that comes with wcsim: a folder of package data, looked at as strictly as anybody else's files."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import wcsim
from wcsim.config import parse
from wcsim.config.run_file import ShippedFile
from wcsim.core import files
from wcsim.core.reading import FileKind, escaped, is_file, read_json
from wcsim.errors import ConfigError, PolicyError

SHIPPED: Final = "shipped"
FILES: Final = "files.json"
HELD: Final = ("policy.json", "weights.safetensors", "model.onnx", "meaning.json", "reference.npz", "MODEL_CARD.md")
_KIND: Final = FileKind(what="the files.json of the shipped policy", limit_bytes=1 << 20, error=PolicyError)


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
        told = parse(ShippedFile, read_json(folder / FILES, _KIND), escaped(folder / FILES)).sha256
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
