"""The cache: its folder, what is in it, and how it is emptied; nothing heavy is loaded here."""

import re
import shutil
import stat
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.core.files import (
    KERNELS,
    count_folder_bytes,
    find_cache_folder,
    find_home_folder,
    write_bytes,
)
from wcsim.core.reading import escape
from wcsim.errors import DiskFullError

MOST_VERDICTS: Final = 4000  # of a kind, then the newer half stays: generated scenes leave one each
WRITTEN_S = 3600.0  # a file that is being written is not older
_KEY = "[0-9a-f]{32}"
# What wcsim writes there, by its place: files and folders. Generated scenes of the driving page and
# generated towns of suites are driven in, see `bridge/replay/replayed.py` and `drive/starting.py`.
# For what is unfinished see `files.write_file_atomically`.
_KINDS = {
    "streets": re.compile(rf"street-{_KEY}\.npz"),
    "verdicts": re.compile(rf"(scenario|net|state|plain)-{_KEY}\.ok"),
    "rows": re.compile(rf"rows-{_KEY}\.json"),
    "states": re.compile(rf"warm-{_KEY}\.xml\.gz"),
    "kernels": re.compile(rf"{KERNELS}/[^/]+/[\w.-]+\.nbi"),
    "code": re.compile(rf"{KERNELS}/[^/]+/[\w.-]+\.(nbc|lock)"),  # of the kernels
    "driven": re.compile(
        r"drive-scenes/([a-z][a-z-]*-\d+-[0-9a-f]{16}|\.\w{8})|drive-towns/made-\d+"
    ),
    "unfinished": re.compile(
        rf"street-{_KEY}\.lock|\.(street|scenario|net|state|plain|warm|rows)-{_KEY}\.(npz|ok|xml\.gz|json)\.\d+-\w+\.tmp"
    ),
}


def cache_folder() -> Path:
    """Where wcsim keeps what it can make again: see `find_cache_folder`."""
    return find_cache_folder()


def shown_cache() -> str:
    """The cache's folder for a message, with ~ for the home."""
    folder, own = cache_folder(), find_home_folder()
    is_own = own is not None and folder.is_relative_to(own)
    return escape(Path("~") / folder.relative_to(own) if own is not None and is_own else folder)


def write_verdict(path: Path, text: bytes = b"ok\n") -> None:
    """Save what a check found, as a small file under its hash; of a kind the newest ones stay."""
    # A cache that cannot be written is no error.
    with suppress(DiskFullError):
        write_bytes(path, text)
    remove_older_half(path, MOST_VERDICTS)


def remove_older_half(path: Path, most: int) -> None:
    """Remove the older half of the files of this one's kind where there are more than `most`."""
    files = list(path.parent.glob(f"{path.name.partition('-')[0]}-*{path.suffix}"))
    if len(files) > most:
        with suppress(OSError):
            files.sort(key=lambda each: each.stat().st_mtime_ns)
            for old in files[: len(files) - most // 2]:
                old.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class _CacheFacts:
    """What is cached and can be made again, without other files, such as the key of own runs."""

    folder: Path
    streets: int
    verdicts: int  # on nets and scenarios that were tried, and on files that name no other
    rows: int  # of the user alone in blocks of lists, for other tests of them
    states: int  # of warmed traffic
    kernels: int  # whose machine code is cached here: those of a read-only package
    driven: int  # scenes and towns that were generated for the driving page
    unfinished: int  # begun and left
    size_bytes: int


def cache_facts() -> _CacheFacts:
    """Look through the cache; a folder that is not there or cannot be read is empty."""
    found = _made()
    number = Counter(kind for kind, _ in found.values())
    return _CacheFacts(
        folder=cache_folder(),
        streets=number["streets"],
        verdicts=number["verdicts"],
        rows=number["rows"],
        states=number["states"],
        kernels=number["kernels"],
        driven=number["driven"],
        unfinished=number["unfinished"],
        size_bytes=sum(size_bytes for _, size_bytes in found.values()),
    )


def clear_cache() -> _CacheFacts:
    """Remove what wcsim keeps there and can make again; returns what is left of it.

    A world that uses a street goes on: its open file lives until it closes it. A file that is being
    written has another name until it is whole, and is left alone, as is every file that wcsim has
    not named. A driver in a generated scene or town drives on, and has to begin anew for another
    place in it.
    """
    for path in _made():
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        # It may be another user's, or removed already.
        with suppress(OSError):
            path.unlink()
    return cache_facts()


def _made() -> dict[Path, tuple[str, int]]:
    """The files and folders that wcsim made, with their kind and size; none that is in writing."""
    folder, found = cache_folder(), dict[Path, tuple[str, int]]()
    depths = ("*", "*/*", f"{KERNELS}/*/*")
    for path in sorted(path for depth in depths for path in folder.glob(depth)):
        name = path.relative_to(folder).as_posix()
        kind = next((kind for kind, form in _KINDS.items() if form.fullmatch(name)), None)
        is_hidden = path.name.startswith(".")
        with suppress(OSError):
            status = path.lstat()
            is_folder = stat.S_ISDIR(status.st_mode)
            is_expected = (
                is_folder if kind == "driven" or is_hidden else stat.S_ISREG(status.st_mode)
            )
            is_unfinished = kind == "unfinished" or is_hidden
            is_written = is_unfinished and time.time() - status.st_mtime < WRITTEN_S
            if kind and is_expected and not is_written:
                found[path] = kind, count_folder_bytes(path) if is_folder else status.st_size
    return found
