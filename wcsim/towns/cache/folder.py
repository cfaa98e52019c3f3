"""Where the cache lies, and how a file comes into it. Loads nothing, for whoever only asks."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from wcsim.core.files import home, user_cache
from wcsim.core.reading import shown

MOST_VERDICTS: Final = 4000  # of a kind, then the newer half stays: generated scenes leave one each


def cache_folder() -> Path:
    """Where wcsim keeps what it can make again: see `user_cache`."""
    return user_cache()


def shown_cache() -> str:
    """The cache's folder for a message, with ~ for the home."""
    folder, own = cache_folder(), home()
    return shown(Path("~") / folder.relative_to(own) if own is not None and folder.is_relative_to(own) else folder)


def write_verdict(path: Path) -> None:
    """Keep that something was found sound, as an empty word under its hash; of each kind the newest ones stay."""
    write_whole(path, lambda temporary: temporary.write_text("ok\n", encoding="utf-8"))
    kept = list(path.parent.glob(f"{path.name.partition('-')[0]}-*{path.suffix}"))
    if len(kept) > MOST_VERDICTS:
        with suppress(OSError):
            kept.sort(key=lambda each: each.stat().st_mtime_ns)
            for old in kept[: len(kept) - MOST_VERDICTS // 2]:
                old.unlink(missing_ok=True)


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a cache file under another name and move it into place; a cache that cannot be written is no error."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=path.suffix)
        os.close(handle)
        temporary = Path(name)
        try:
            write(temporary)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError:
        return
