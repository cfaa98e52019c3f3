"""The files of an exported policy's folder, and whether a folder may become one."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import wcsim
from wcsim.agents.export.guard import MEANING
from wcsim.agents.policies.onnx_policy import ABOUT_FILE
from wcsim.agents.policy_api import MODEL_FILE
from wcsim.core.reading import escaped, is_file, is_folder
from wcsim.errors import ConfigError, PolicyError

REFERENCE, LOOP = "reference.npz", "exported_policy.py"
WRITTEN: Final = (MODEL_FILE, ABOUT_FILE, MEANING, REFERENCE, LOOP)
_MOST_NAMED: Final = 3


def require_export_place(option: str, folder: Path) -> None:
    """Refuse a folder that holds what no export wrote, for an export takes its whole place. Raises ConfigError."""
    expected = (*WRITTEN, "__pycache__")  # Python's, once the loop was imported
    others = sorted(path.name for path in folder.iterdir() if path.name not in expected) if is_folder(folder) else []
    if others:
        named = ", ".join(escaped(name, 80) for name in others[:_MOST_NAMED]) + " and more" * (
            len(others) > _MOST_NAMED
        )
        raise ConfigError(
            f"{option} {escaped(folder)} holds {named}, which is not from an export; expected a new folder, or an "
            "earlier export, which is replaced: choose another one"
        )


def loop_place() -> Path:
    """The loop in NumPy that drives an exported policy: in a wheel within the package, in a checkout beside it.

    Raises PolicyError when it is in neither.
    """
    package = Path(wcsim.__file__).parent
    for place in (package, package.parent):
        if is_file(place / "examples" / LOOP):
            return place / "examples" / LOOP
    raise PolicyError(
        f"wcsim has no examples/{LOOP}; expected one in {escaped(package)} or beside it: install it again"
    )
