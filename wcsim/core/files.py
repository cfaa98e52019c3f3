"""Writes files whole or not at all; names new files; finds the cache of what can be made again."""

import contextlib
import errno
import fcntl
import glob
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any, Final

from wcsim.core.reading import JsonObject, is_folder, require_no_outward_links
from wcsim.errors import DiskFullError, PolicyError, UnwritableError

KERNELS: Final = "kernels"  # the folder in the user's cache for machine code
_SEAL: Final = "seal"
_WORK: Final = ".tmp"  # ends the name of what is being written
_OLD: Final = ".old"  # ends the name of what is being replaced
_DAMAGED: Final = ".damaged"  # added to the name of what was passed over
# Safetensors writes files that only their owner can read, but runs are for sharing.
_FILE_MODE: Final = 0o644
_FOLDER_MODE: Final = 0o755
_MOST_NAMES: Final = 10_000


@contextmanager
def hold_file_lock(lock: Path) -> Iterator[None]:
    """While open, other processes that open the same lock wait.

    Where no lock can be made, as in a read-only folder, none waits. The last owner removes the
    lock's file; a process that waits for a removed one makes a new one.
    """
    from filelock import FileLock

    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError, NotImplementedError):
            lock.parent.mkdir(parents=True, exist_ok=True)
            held.enter_context(FileLock(lock))
            held.callback(_unlink, lock)
        yield


@contextmanager
def write_file_atomically(path: Path) -> Iterator[Path]:
    """The path to write a file that appears at `path` when the block ends: flushed, then renamed.

    After an error, or where the block writes nothing, an older file is as it was. Several processes
    may write the same file: the last to end wins.

    Raises:
        DiskFullError: There is no room, or the place cannot be written.
    """
    with _work_beside(path) as part:
        yield part
        if part.exists():
            _sync(part, os.O_RDONLY)
            part.replace(path)
            _sync_folder(path.parent)


@contextmanager
def write_folder_atomically(path: Path, *, flush: bool = True) -> Iterator[Path]:
    """A new folder that appears at `path`, and replaces an older one, when the block ends.

    After an error the older one is as it was. What dead processes left of the same folder is
    removed first; an older folder that they had just moved aside goes back.

    Args:
        path: Of the folder.
        flush: Wait until all is on the disk; False for what can be made again.

    Raises:
        DiskFullError: There is no room, or the place cannot be written.
    """
    _clear_stale(path)
    with _work_beside(path) as part:
        part.mkdir()
        yield part
        part.chmod(_FOLDER_MODE)
        for entry in part.rglob("*"):
            entry.chmod(_FOLDER_MODE if entry.is_dir() else _FILE_MODE)
            if flush:
                _sync(entry, os.O_RDONLY)
        if path.exists():
            # A folder cannot replace a full one: the old one is moved until the new one is there.
            old = _beside(path, _OLD)
            path.replace(old)
            try:
                part.replace(path)
            except BaseException:
                old.replace(path)
                raise
            shutil.rmtree(old, ignore_errors=True)
        else:
            part.replace(path)
        _sync_folder(path.parent)


def write_bytes(path: Path, data: bytes, mode: int = _FILE_MODE) -> None:
    """Replace a file in one step, see `write_file_atomically`. Raises DiskFullError."""
    with (
        write_file_atomically(path) as part,
        os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file,
    ):
        file.write(data)


def write_json(path: Path, data: Any) -> None:
    """Replace a JSON file in one step. Raises DiskFullError; ValueError for NaN or infinity."""
    write_bytes(path, (json.dumps(data, indent=2, allow_nan=False) + "\n").encode())


def write_json_with_checksum(path: Path, data: Mapping[str, Any]) -> None:
    """As `write_json`, with a seal: a hash over all of its content."""
    write_json(path, {**data, _SEAL: _seal_of(data)})


def verify_and_remove_checksum(data: JsonObject, where: str, cure: str = "") -> bool:
    """Remove the seal from a file's content; whether there was one, as older versions wrote none.

    Raises:
        PolicyError: It is not what was written; begins with `where`, and ends with the cure.
    """
    seal = data.pop(_SEAL, None)
    if seal is not None and seal != _seal_of(data):
        raise PolicyError(f"{where} is damaged: its content does not match its hash{cure}")
    return seal is not None


def is_unfinished_write(path: Path) -> bool:
    """Whether a process that died has left this of a file or folder that it wrote."""
    return path.name.startswith(".") and path.name.endswith((_WORK, _OLD))


def rename_damaged_path(path: Path) -> Path:
    """Rename what is damaged, so that it stays, but is never read again; returns its new path."""
    names = (path.with_name(f"{path.name}{_DAMAGED}{'' if k == 1 else f'-{k}'}") for k in count(1))
    free = next(name for name in names if not os.path.lexists(name))
    return path.rename(free)


@contextmanager
def lock_run_folder(path: Path) -> Iterator[None]:
    """Reserve a run folder for this process while open.

    Raises:
        PolicyError: Another one has it, or a link in it leads elsewhere, where nothing shall be
            written or removed.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PolicyError(
                f"{path} is in use by another process; wait until that ends, or choose another "
                "--out"
            ) from None
        except OSError:  # a file system without locks
            pass
        require_no_outward_links(path, PolicyError)
        yield
    finally:
        os.close(descriptor)


def count_folder_bytes(folder: Path) -> int:
    """Bytes of all regular files in a folder; what others remove meanwhile counts as nothing."""
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(OSError):
                status = os.lstat(f"{place}/{name}")
                total += status.st_size if stat.S_ISREG(status.st_mode) else 0
    return total


def find_existing_ancestor(path: Path) -> Path:
    """The path itself, or the nearest folder above it that exists."""
    path = path.absolute()
    while not os.path.lexists(path):
        path = path.parent
    return path


def is_writable_folder(folder: Path) -> bool:
    """Whether a folder can be written to, or made."""
    place = find_existing_ancestor(folder)
    return is_folder(place) and os.access(place, os.W_OK | os.X_OK)


def iter_unused_paths(first: Path) -> Iterator[Path]:
    """The first name, and then FILE-2, FILE-3, ..., as far as they do not exist yet.

    >>> names = iter_unused_paths(Path("no-such-folder/a.drive"))
    >>> [str(next(names)) for _ in range(3)]
    ['no-such-folder/a.drive', 'no-such-folder/a-2.drive', 'no-such-folder/a-3.drive']
    """
    for number in range(1, _MOST_NAMES + 1):
        path = first if number == 1 else first.with_name(f"{first.stem}-{number}{first.suffix}")
        if not os.path.lexists(path):
            yield path


def sha256_from_file(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_from_text(text: str) -> str:
    """SHA-256 of a text in UTF-8, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def find_cache_folder() -> Path:
    """$XDG_CACHE_HOME/wcsim or ~/.cache/wcsim; else, where that cannot be written, a temporary one.

    So a user without a home, as of a service or a container, builds a street once, and not in each
    process.
    """
    base, own = os.environ.get("XDG_CACHE_HOME", ""), find_home_folder()
    usual: Path | None = None
    if base:
        usual = Path(base) / "wcsim"
    elif own is not None:
        usual = own / ".cache" / "wcsim"
    if usual is not None and is_writable_folder(usual):
        return usual
    # The last two cannot be written: nothing is cached.
    return _temporary_cache() or usual or Path(os.devnull) / "wcsim"


def find_home_folder() -> Path | None:
    """The user's home; None for a user without one, such as a number without a name."""
    try:
        return Path.home()
    except RuntimeError:
        return None


def _temporary_cache() -> Path | None:
    """A folder for this user alone, as machine code is read from it; None if it is another's."""
    try:
        folder = Path(tempfile.gettempdir()) / f"wcsim-cache-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if own else None


def _unlink(lock: Path) -> None:
    with contextlib.suppress(OSError):
        lock.unlink()


@contextmanager
def _work_beside(path: Path) -> Iterator[Path]:
    """A path with the name of `path` in a fresh folder beside it, which is removed at the end."""
    # It is named before it is made: a signal right after its making removes it, too.
    work = _beside(path, _WORK)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        work.mkdir(mode=0o700)
        yield work / path.name
    except OSError as error:
        message = f"{path}: could not be written ({error.strerror});"
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
            raise DiskFullError(f"{message} make room, or choose another place") from None
        raise UnwritableError(f"{message} choose another place") from None
    except DiskFullError as error:
        # Of another writer, which knows only the path in the working folder.
        raise type(error)(str(error).replace(str(work / path.name), str(path))) from None
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _beside(path: Path, suffix: str) -> Path:
    """A new name beside a path, of this process; see `_clear_stale`."""
    return path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}{suffix}")


def _clear_stale(path: Path) -> None:
    """Remove what dead processes left of a folder; a missing older folder goes back."""
    for place in sorted(path.parent.glob(f".{glob.escape(path.name)}.*")):
        match = re.fullmatch(rf"\.{re.escape(path.name)}\.(\d+)-\w+({_WORK}|{_OLD})", place.name)
        if match is None or place.is_symlink() or not place.is_dir() or _is_running(int(match[1])):
            continue
        if match[2] == _OLD and not path.exists():
            place.rename(path)
        else:
            shutil.rmtree(place, ignore_errors=True)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def _seal_of(data: Mapping[str, Any]) -> str:
    return sha256_from_text(json.dumps(data, sort_keys=True, allow_nan=False))


def _sync_folder(path: Path) -> None:
    """Flush a folder's list of names to disk."""
    _sync(path, os.O_RDONLY | os.O_DIRECTORY)


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
