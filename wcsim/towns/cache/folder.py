"""The cache: its folder, how a file is written into it, what is in it, and how it is emptied. Loads nothing heavy."""

from __future__ import annotations

import re
import shutil
import stat
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.core.files import KERNELS, folder_bytes, home, user_cache, write_bytes
from wcsim.core.reading import escaped
from wcsim.errors import DiskFullError

MOST_VERDICTS: Final = 4000  # of a kind, then the newer half stays: generated scenes leave one each
WRITTEN_S = 3600.0  # a file that is being written is not older
_KEY = "[0-9a-f]{32}"
_STREET = re.compile(rf"street-{_KEY}\.npz")
_VERDICT = re.compile(rf"(scenario|net)-{_KEY}\.ok")
_KERNEL = re.compile(r"[\w.-]+\.(nbi|nbc|lock)")  # machine code, with the list of it and the lock for each kernel
# Folders: generated scenes of the driving page, and generated towns of suites; see `bridge/replay/replayed.py` and
# `drive/starting.py`.
_DRIVEN = {"drive-scenes": re.compile(r"[a-z][a-z-]*-\d+-[0-9a-f]{16}|\.\w{8}"), "drive-towns": re.compile(r"made-\d+")}
_LOCK = re.compile(rf"street-{_KEY}\.lock")
_BEGUN = re.compile(rf"\.(street|scenario|net)-{_KEY}\.(npz|ok)\.\d+-\w+\.tmp")  # see `files.whole_file`


def cache_folder() -> Path:
    """Where wcsim keeps what it can make again: see `user_cache`."""
    return user_cache()


def shown_cache() -> str:
    """The cache's folder for a message, with ~ for the home."""
    folder, own = cache_folder(), home()
    return escaped(Path("~") / folder.relative_to(own) if own is not None and folder.is_relative_to(own) else folder)


def write_verdict(path: Path) -> None:
    """Save that a check passed, as a small file under its hash; of each kind the newest ones stay."""
    with suppress(DiskFullError):  # a cache that cannot be written is no error
        write_bytes(path, b"ok\n")
    verdicts = list(path.parent.glob(f"{path.name.partition('-')[0]}-*{path.suffix}"))
    if len(verdicts) > MOST_VERDICTS:
        with suppress(OSError):
            verdicts.sort(key=lambda each: each.stat().st_mtime_ns)
            for old in verdicts[: len(verdicts) - MOST_VERDICTS // 2]:
                old.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class _CacheFacts:
    """What is cached and can be made again; other files in the folder, as the key of one's own runs, do not count."""

    folder: Path
    streets: int
    verdicts: int  # on nets and scenarios that were tried
    kernels: int  # whose machine code is cached here: those of a read-only package
    driven: int  # scenes and towns that were generated for the driving page
    unfinished: int  # begun and left
    size_bytes: int


def cache_facts() -> _CacheFacts:
    """Look through the cache; a folder that is not there or cannot be read is empty."""
    found, driven, begun = _files(), _driven(), _begun()
    return _CacheFacts(
        folder=cache_folder(),
        streets=sum(_STREET.fullmatch(path.name) is not None for path in found),
        verdicts=sum(_VERDICT.fullmatch(path.name) is not None for path in found),
        kernels=sum(path.suffix == ".nbi" for path in found),
        driven=len(driven),
        unfinished=len(begun) + sum(_LOCK.fullmatch(path.name) is not None for path in found),
        size_bytes=sum(found.values()) + sum(map(folder_bytes, (*driven, *begun))),
    )


def clear_cache() -> _CacheFacts:
    """Remove what wcsim keeps there and can make again; returns what is left of it.

    A world that uses a street goes on: its open file lives until it closes it. A file that is being written has
    another name until it is whole, and is left alone, as is every file that wcsim has not named. Who drives in a
    generated scene or town drives on, and has to begin anew for another place in it.
    """
    for folder in (*_driven(), *_begun()):
        shutil.rmtree(folder, ignore_errors=True)
    for path in _files():
        with suppress(OSError):  # of another user, or gone already
            path.unlink()
    return cache_facts()


def _files() -> dict[Path, int]:
    """The regular files that wcsim made, with their sizes."""
    found: dict[Path, int] = {}
    for path, kinds in _places():
        known = any(kind.fullmatch(path.name) for kind in kinds)
        with suppress(OSError):
            status = path.lstat()
            being_written = _LOCK.fullmatch(path.name) and time.time() - status.st_mtime < WRITTEN_S
            if known and stat.S_ISREG(status.st_mode) and not being_written:
                found[path] = status.st_size
    return found


def _begun() -> list[Path]:
    """The folders in which files were written by who died meanwhile."""
    return [path for path in _entries(cache_folder()) if _BEGUN.fullmatch(path.name) and _is_left(path)]


def _driven() -> list[Path]:
    """The folders of scenes and towns that were generated to be driven in."""
    places = [(path, form) for name, form in _DRIVEN.items() for path in _entries(cache_folder() / name)]
    return [path for path, form in places if form.fullmatch(path.name) and _is_left(path)]


def _is_left(folder: Path) -> bool:
    """Whether it is a finished folder; the name of an unfinished one begins with a dot."""
    with suppress(OSError):
        status = folder.lstat()
        made = not folder.name.startswith(".") or time.time() - status.st_mtime > WRITTEN_S
        return made and stat.S_ISDIR(status.st_mode)
    return False


def _entries(folder: Path) -> list[Path]:
    with suppress(OSError):
        return sorted(folder.iterdir())
    return []


def _places() -> Iterator[tuple[Path, tuple[re.Pattern[str], ...]]]:
    """All that lies where files of wcsim may, with the forms that their names have there."""
    folder = cache_folder()
    yield from ((path, (_STREET, _VERDICT, _LOCK)) for path in _entries(folder))
    yield from ((path, (_KERNEL,)) for path in sorted(folder.glob(f"{KERNELS}/*/*")))
