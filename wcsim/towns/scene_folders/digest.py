"""What tells a scene from another one of its name."""

from __future__ import annotations

import hashlib
from pathlib import Path


def scene_digest(folder: Path) -> str:
    """SHA-256 (hex) over the names and bytes of a scene's files."""
    said = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        data = path.read_bytes()
        said.update(f"{path.name} {len(data)}\n".encode() + data)
    return said.hexdigest()
