"""Writing files whole or not at all, names for new ones, and where those lie that can be made again."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from filelock import FileLock

from wcsim.core.reading import escaped, require_no_links
from wcsim.errors import ConfigError, DiskFullError, PolicyError

KERNELS = "kernels"  # the folder in the user's cache for machine code
_SEAL = "seal"
_DAMAGED = ".damaged"  # added to the name of what was passed over
WORK_PREFIX = "wcsim-work-"  # of folders of workers, in which a killed one leaves all that is temporary
_FILE_MODE = 0o644  # safetensors writes files that only their owner can read; runs are for sharing
_MOST_NAMES = 10_000
_FOLDER_MODE = 0o755  # without the right to enter it, nobody reads what lies in a folder


@contextmanager
def alone(lock: Path) -> Iterator[None]:
    """While open, whoever else opens the same lock waits; where none can be had, as in a read-only folder, nobody.

    The lock's file goes with its last owner; who waits for a file that has gone takes a new one.
    """
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError, NotImplementedError):
            lock.parent.mkdir(parents=True, exist_ok=True)
            held.enter_context(FileLock(lock))
            held.callback(_gone, lock)
        yield


def _gone(lock: Path) -> None:
    with contextlib.suppress(OSError):
        lock.unlink()


def write_bytes(path: Path, data: bytes, mode: int = _FILE_MODE) -> None:
    """Replace a file in one step: written beside it, flushed to disk, renamed. Raises DiskFullError; it stays then."""
    beside = path.with_name(f".{path.name}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.unlink(missing_ok=True)
        with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise _not_written(path, error) from None


def write_json(path: Path, data: Any) -> None:
    """Replace a JSON file in one step. Raises ValueError when a number is not finite, DiskFullError."""
    write_bytes(path, (json.dumps(data, indent=2, allow_nan=False) + "\n").encode())


def write_sealed_json(path: Path, data: Mapping[str, Any]) -> None:
    """As `write_json`, with a seal: a hash over all that the file says."""
    write_json(path, {**data, _SEAL: _seal_of(data)})


def take_seal(data: dict[str, Any], where: str, cure: str = "") -> bool:
    """Take the seal out of what a file said; whether there was one, as those of older versions have none.

    Raises:
        PolicyError: It is not what was written; begins with `where`, and ends with the cure.
    """
    seal = data.pop(_SEAL, None)
    if seal is not None and seal != _seal_of(data):
        raise PolicyError(f"{where} is damaged: its content does not match its hash{cure}")
    return seal is not None


def _seal_of(data: Mapping[str, Any]) -> str:
    return sha256_text(json.dumps(data, sort_keys=True, allow_nan=False))


def write_folder(path: Path, fill: Callable[[Path], None]) -> None:
    """Make a folder with all that `fill` writes in it, or nothing; an older one is replaced. Raises DiskFullError."""
    beside = path.with_name(f".{path.name}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(beside, ignore_errors=True)
        beside.mkdir()
        fill(beside)
        for entry in beside.rglob("*"):
            entry.chmod(_FOLDER_MODE if entry.is_dir() else _FILE_MODE)
            _sync(entry, os.O_RDONLY)
        _sync_folder(beside)
        _put_in_place(beside, path)
    except BaseException as error:
        shutil.rmtree(beside, ignore_errors=True)
        if isinstance(error, OSError):
            raise _not_written(path, error) from None
        raise


def is_begun(path: Path) -> bool:
    """Whether this is what a process that died on the way has left of a file or folder that it wrote."""
    return path.name.startswith(".") and path.name.endswith((".tmp", ".old"))


def set_aside(path: Path) -> Path:
    """Rename what is damaged, so that it is kept, and never meant again; returns its new place."""
    names = (path.with_name(f"{path.name}{_DAMAGED}{'' if k == 1 else f'-{k}'}") for k in count(1))
    free = next(name for name in names if not os.path.lexists(name))
    return path.rename(free)


def _put_in_place(beside: Path, path: Path) -> None:
    if path.exists():
        # A folder cannot replace a full one: the old one steps aside and goes when the new one is in place.
        old = path.with_name(f".{path.name}.old")
        shutil.rmtree(old, ignore_errors=True)
        path.replace(old)
        try:
            beside.replace(path)
        except BaseException:
            old.replace(path)
            raise
        shutil.rmtree(old, ignore_errors=True)
    else:
        beside.replace(path)
    _sync_folder(path.parent)


def _sync_folder(path: Path) -> None:
    """Flush a folder's list of names to disk."""
    _sync(path, os.O_RDONLY | os.O_DIRECTORY)


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _not_written(path: Path, error: OSError) -> DiskFullError:
    return DiskFullError(f"{path}: could not be written ({error.strerror}); make room, or choose another place")


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep a run folder to this process while open.

    Raises:
        PolicyError: Another one has it, or a link in it leads elsewhere, where nothing shall be written or removed.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PolicyError(
                f"{path} is in use by another process; wait until that ends, or choose another --out"
            ) from None
        except OSError:  # a file system without locks
            pass
        require_no_links(path, PolicyError)
        yield
    finally:
        os.close(descriptor)


def folder_bytes(folder: Path) -> int:
    """Bytes of all regular files in a folder; what others remove meanwhile, folders too, is nothing."""
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(OSError):
                status = os.lstat(f"{place}/{name}")
                total += status.st_size if stat.S_ISREG(status.st_mode) else 0
    return total


def check_new_file(path: Path, option: str) -> Path:
    """The same path. Raises ConfigError when something is there already, or nothing can be written there."""
    if os.path.lexists(path):
        raise ConfigError(f"{option} {escaped(path)} exists; expected the name of a new file")
    folder = next(each for each in path.absolute().parents if each.exists())
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise ConfigError(
            f"{option} {escaped(path)}: {escaped(folder)} cannot be written to; choose another place with {option}"
        )
    return path


def numbered_names(first: Path) -> Iterator[Path]:
    """The first name, and then FILE-2, FILE-3, ... of which nothing is there yet.

    >>> names = numbered_names(Path("no-such-folder/a.drive"))
    >>> [str(next(names)) for _ in range(3)]
    ['no-such-folder/a.drive', 'no-such-folder/a-2.drive', 'no-such-folder/a-3.drive']
    """
    for number in range(1, _MOST_NAMES + 1):
        path = first if number == 1 else first.with_name(f"{first.stem}-{number}{first.suffix}")
        if not os.path.lexists(path):
            yield path


def sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_text(text: str) -> str:
    """SHA-256 of a text in UTF-8, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def user_cache() -> Path:
    """$XDG_CACHE_HOME/wcsim or ~/.cache/wcsim; where that cannot be written, this user's own temporary folder.

    So a user without a home, as services and containers have them, builds a street once, and not in each process.
    """
    wanted = _wanted()
    if wanted is not None and _can_be_written(wanted):
        return wanted
    return _temporary() or wanted or Path(os.devnull) / "wcsim"  # the last two only say that nothing can be kept


def home() -> Path | None:
    """The user's home, None for a user who has none, as for a number that the machine has no name for."""
    try:
        return Path.home()
    except RuntimeError:
        return None


def _wanted() -> Path | None:
    base, own = os.environ.get("XDG_CACHE_HOME", ""), home()
    if base:
        return Path(base) / "wcsim"
    return None if own is None else own / ".cache" / "wcsim"


def _can_be_written(folder: Path) -> bool:
    """Whether it can, or can be made."""
    place = folder.absolute()
    while not os.path.lexists(place) and place != place.parent:
        place = place.parent
    return place.is_dir() and os.access(place, os.W_OK | os.X_OK)


def _temporary() -> Path | None:
    """A folder for this user alone; None where somebody else was there first, for machine code is read from it."""
    try:
        place = Path(tempfile.gettempdir())
        place = place.parent if place.name.startswith(WORK_PREFIX) else place  # it outlives a worker's piece
        folder = place / f"wcsim-cache-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if own else None
