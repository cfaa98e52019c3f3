"""The folder in which a town is made, beside the one where it will be, and what a killed import left there."""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wcsim.errors import TownError
from wcsim.towns.scenario.manifest import own_work
from wcsim.towns.scenario.town import NOT_TOWNS

_OLD = "-old"


def check_words(name: str, split: str) -> None:
    """Raise TownError unless a town can have this name and this split."""
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", name):
        raise TownError(f"a town cannot be named {name!r}; expected letters, digits, - and _")
    if name in NOT_TOWNS:
        raise TownError(f"a town cannot be named {name!r}: that folder is reserved; choose another name")
    if split not in ("train", "test"):
        raise TownError(f"unknown split {split!r} of town {name}; expected train or test")


def check_place(out: Path, *, overwrite: bool) -> None:
    """Raise TownError when a folder holds something else than a town, or a town that somebody has worked on."""
    if out.exists() and not out.is_dir():
        raise TownError(f"{out} is a file; choose another folder, or remove it")
    if out.is_dir() and any(out.iterdir()) and not (out / "town.toml").is_file():
        raise TownError(f"{out} is not empty and not a town; choose another folder, or empty it")
    work = own_work(out) if (out / "town.toml").is_file() and not overwrite else ()
    if work:
        raise TownError(
            f"{out} contains files that were changed or added later: {', '.join(work[:5])}"
            f"{' and more' * (len(work) > 5)}; choose another name or --out, or use --replace, which discards them"
        )


@contextmanager
def workplace(name: str, out: Path) -> Iterator[Path]:
    """A fresh folder beside `out`, gone at the end unless it was moved; first what killed imports of that name left.

    It is named before it is made: a signal that comes right after its making ends the import, and the folder with it.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    clear_stale(name, out)
    work = out.parent / f".{name}-{os.getpid()}-{secrets.token_hex(8)}"
    try:
        work.mkdir(mode=0o700)
        yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)


def clear_stale(name: str, out: Path) -> None:
    """Remove what dead imports left; a town that one had just moved aside goes back to its place."""
    for place in sorted(out.parent.glob(f".{name}-*")):
        match = re.fullmatch(rf"\.{re.escape(name)}-(\d+)-\w+({_OLD})?", place.name)
        if match is None or not place.is_dir() or _runs(int(match[1])):
            continue
        if match[2] and not out.exists():
            place.rename(out)
        else:
            shutil.rmtree(place, ignore_errors=True)


def move_in_place(work: Path, out: Path) -> None:
    """Put a finished town where it belongs, instead of one that is there."""
    work.chmod(0o755)
    if not out.exists():
        work.rename(out)
        return
    aside = work.with_name(work.name + _OLD)
    out.rename(aside)
    try:
        work.rename(out)
    except BaseException:
        aside.rename(out)
        raise
    shutil.rmtree(aside)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
