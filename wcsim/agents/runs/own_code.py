"""Whose own classes a run names: code in somebody else's run folder must not run here because the folder says so.

A run that is made here gets a mark with a key that only this user's machine has. Where the mark fits, `wcsim resume`
loads the classes that the run was made with; elsewhere they have to be named again on the command line.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
from collections.abc import Collection, Sequence
from pathlib import Path

from wcsim.core.reading import KEY, escaped, read_bytes
from wcsim.errors import FileError, PolicyError
from wcsim.towns.cache.folder import cache_folder

KEY_FILE = "own-runs.key"


def own_classes(hook: str, rewards: Sequence[str], networks: Collection[str]) -> tuple[str, ...]:
    """Those that are `module:Class`, sorted."""
    return tuple(sorted({name for name in (hook, *rewards, *networks) if ":" in name}))


def mark_of(classes: Sequence[str]) -> str:
    """A mark that only this user's machine makes of these names; "" without any, or where no key can be kept."""
    key = _key(make=True) if classes else b""
    return _mark(key, classes) if key else ""


def require_own(path: Path, classes: Sequence[str], mark: str, named: Collection[str]) -> None:
    """Refuse a run with own classes that was made elsewhere, unless each was named on this command line.

    Raises:
        PolicyError: It was not; the message says which, and how to name it.
    """
    unnamed = [name for name in classes if name not in named]
    if not unnamed or (mark and hmac.compare_digest(mark, _mark(_key(make=False), classes))):
        return
    names = ", ".join(escaped(name, 80) for name in unnamed)
    raise PolicyError(
        f"{path} was made elsewhere with custom classes ({names}); resuming runs their code: name each if you "
        f"trust it, as --trust {escaped(unnamed[0], 80)}"
    )


def _mark(key: bytes, classes: Sequence[str]) -> str:
    return hmac.new(key, json.dumps(list(classes)).encode(), hashlib.sha256).hexdigest()


def _key(make: bool) -> bytes:
    """The key of this user's machine, b"" where there is none."""
    path = cache_folder() / KEY_FILE
    try:
        if make and not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(number, "wb") as file:
                file.write(secrets.token_bytes(KEY.limit_bytes))
        key = read_bytes(path, KEY)
    except (OSError, FileError):
        return b""
    return key if len(key) == KEY.limit_bytes else b""
