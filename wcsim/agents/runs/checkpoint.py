"""Checkpoints of any learner: folders of arrays and plain values, all of it under hashes.

Each is written in one step, and the newest ones stay. Large arrays that are seldom saved are
shared, as a hard link, with the newest checkpoint that has them. A learner resumes from the newest
one that is sound and fits it: one that is damaged in any place is skipped for the one before it.
"""

import contextlib
import errno
import os
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from wcsim.agents.runs.run_folder import RunFolder
from wcsim.core import files, reading
from wcsim.core.reading import JsonObject, escape, is_folder, read_file_size, read_json
from wcsim.errors import PolicyError, WcsimError

STATE: Final = "state.json"
# Checkpoints of a run that stay.
KEEP: Final = 3
_VERSION: Final = 4
# Least number of digits, by what is counted.
_WIDTH: Final = {"step": 8, "round": 3}
_NAME: Final = re.compile(r"(step|round)-(\d{3,18})", re.ASCII)
_END: Final = ".safetensors"
_FILE: Final = re.compile(rf"[a-z_]+{re.escape(_END)}", re.ASCII)

Arrays = dict[str, np.ndarray]
T = TypeVar("T")
Log = Callable[[str], object]
Alive = Callable[[], object]  # called now and then while something takes long
Restore = Callable[[int, JsonObject, dict[str, Arrays]], T]
"""Restores a learner at a step or round from state and arrays; raises where they do not fit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Restored(Generic[T]):
    """A checkpoint that was restored."""

    path: Path
    value: T  # that `Restore` returned
    passed_over: Mapping[Path, str]  # newer checkpoints with the reason, newest first


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shared:
    """A file of arrays that a checkpoint has already."""

    path: Path
    sha256: str  # as it was written; not compared with the file


def format_checkpoint_name(counted: str, number: int) -> str:
    """The name of a step's or round's checkpoint; names do not sort as their numbers do.

    >>> kinds = (("step", 5000), ("step", 100_000_000), ("round", 7))
    >>> tuple(format_checkpoint_name(*kind) for kind in kinds)
    ('step-00005000', 'step-100000000', 'round-007')
    """
    return f"{counted}-{number:0{_WIDTH[counted]}d}"


def list_checkpoints(folder: Path) -> list[Path]:
    """The checkpoints of a run, oldest first: real folders with exactly such a name."""
    # `glob` fails at a name that no system could hold.
    paths = folder.glob("*-*") if is_folder(folder) else ()
    found = [
        path for path in paths if _is_name(path.name) and path.is_dir() and not path.is_symlink()
    ]
    return sorted(found, key=checkpoint_number_from_path)


def checkpoint_number_from_path(path: Path) -> int:
    """The step or round of a checkpoint's folder."""
    return int(path.name.rpartition("-")[2])


def newest_checkpoint_number(folder: Path) -> int:
    """The step or round of a run's newest checkpoint, sound or not; -1 when there is none."""
    return max(map(checkpoint_number_from_path, list_checkpoints(folder)), default=-1)


def write_checkpoint(
    folder: Path,
    name: str,
    state: Mapping[str, Any],
    arrays: Mapping[str, Arrays | _Shared],
    alive: Alive = lambda: None,
) -> Path:
    """Write the checkpoint `folder/name` in one step, and drop all but it and the newest ones.

    Args:
        folder: The folder of a run's checkpoints.
        name: See `format_checkpoint_name`.
        state: Plain values.
        arrays: By the name of their file; see `find_newest_checkpoint_arrays` for those that are
            saved already.
        alive: Called now and then while it is being written.

    Returns:
        The checkpoint's folder.

    Raises:
        DiskFullError: It could not be written; those before are whole.
    """
    with files.write_folder_atomically(folder / name) as target:
        hashes = {}
        sizes = {}
        for part, held in arrays.items():
            file = f"{part}{_END}"
            if isinstance(held, _Shared):
                _link(held.path, target / file)
                hashes[file] = held.sha256
            else:
                try:
                    save_file(
                        {key: np.asarray(value, order="C") for key, value in held.items()},
                        target / file,
                    )
                except SafetensorError as error:  # its error for a full disk
                    raise OSError(errno.ENOSPC, escape(error)) from None
                alive()
                hashes[file] = files.sha256_from_file(target / file)
            sizes[file] = (target / file).stat().st_size
            alive()
        data = {"schema_version": _VERSION, "name": name, **state, "sha256": hashes, "bytes": sizes}
        files.write_json_with_checksum(target / STATE, data)
    _drop_old(folder, folder / name)
    return folder / name


def _restore_newest(folder: Path, restore: Restore[T]) -> _Restored[T]:
    """Bring a learner to the newest checkpoint of a run that is sound and fits it.

    Raises:
        PolicyError: There is none.
    """
    passed: dict[Path, str] = {}
    for path in reversed(list_checkpoints(folder)):
        try:
            state = _read_state(path)
            hashes, sizes = state.pop("sha256"), state.pop("bytes")
            if sizes.keys() != hashes.keys():
                raise PolicyError(f"{STATE} is damaged")
            for file, sha256 in hashes.items():
                size = read_file_size(path / file, reading.ARRAYS)
                # Its size first: a file that is larger than it was written may take hours to read.
                if sizes[file] != size or files.sha256_from_file(path / file) != sha256:
                    raise PolicyError(f"{file} is damaged")
            arrays = {file.removesuffix(_END): load_file(path / file) for file in hashes}
            value = restore(checkpoint_number_from_path(path), state, arrays)
        except Exception as error:  # whatever is wrong with it, the one before may be sound
            kind = "" if isinstance(error, WcsimError) else f"{type(error).__name__}: "
            passed[path] = escape(f"{kind}{error}", 300)
            continue
        return _Restored(path=path, value=value, passed_over=passed)
    faults = "; ".join(f"{path.name}: {reason}" for path, reason in passed.items()) or "none found"
    raise PolicyError(
        f"{folder} holds no intact checkpoint that fits ({faults}); restore one, or start a new run"
    )


def restore_newest_checkpoint(run: RunFolder, restore: Restore[T], log: Log) -> _Restored[T] | None:
    """Restore a run's newest sound checkpoint, and log skipped ones; None for a run without any.

    Skipped ones are set aside: they belong to work that is done again, with another result.

    Raises:
        PolicyError: There are checkpoints, and none is sound and fits.
    """
    if not list_checkpoints(run.checkpoints):
        return None
    found = _restore_newest(run.checkpoints, restore)
    for path, reason in found.passed_over.items():
        aside = files.rename_damaged_path(path)
        log(
            f"{path}: skipped ({reason}); continuing from {found.path.name}, renamed to "
            f"{aside.name}"
        )
        run.event("passed_over", checkpoint=aside.name, reason=reason)
    return found


def find_newest_checkpoint_arrays(folder: Path, part: str) -> _Shared | None:
    """The arrays of that name in the newest checkpoint that has them; None where there is none."""
    for path in reversed(list_checkpoints(folder)):
        with contextlib.suppress(PolicyError, KeyError):
            return _Shared(
                path=path / f"{part}{_END}",
                sha256=str(_read_state(path)["sha256"][f"{part}{_END}"]),
            )
    return None


def _is_name(name: str) -> bool:
    match = _NAME.fullmatch(name)
    return match is not None and name == format_checkpoint_name(match[1], int(match[2]))


def _read_state(path: Path) -> JsonObject:
    """The state of a checkpoint. Raises PolicyError when it is damaged."""
    state = read_json(path / STATE, reading.STATE)
    version = state.get("schema_version")
    if version != _VERSION:
        raise PolicyError(
            f"{STATE} is of version {escape(version)}, expected {_VERSION}: finish the run with "
            "the wcsim that began it, or start a new one"
        )
    sealed = files.verify_and_remove_checksum(state, STATE)
    name, hashes = state.get("name"), state.get("sha256")
    if (
        not sealed
        or name != path.name
        or not isinstance(hashes, dict)
        or not all(map(_FILE.fullmatch, hashes))
    ):
        raise PolicyError(
            f"{STATE} is of {escape(name)}, with the keys {escape(sorted(state))}; it is damaged"
        )
    return {key: value for key, value in state.items() if key not in ("schema_version", "name")}


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # a file system without hard links
        shutil.copyfile(source, target)


def _drop_old(folder: Path, newest: Path) -> None:
    """Remove old and half-written checkpoints; `newest`, the last ones and a spare one stay."""
    older = list_checkpoints(folder)
    staying = {newest, *older[-KEEP:]}
    # One with other arrays stays, too: one damaged file must not take all checkpoints.
    shared = set.intersection(*map(_inodes, staying))
    if shared:
        staying.update([path for path in older if not _inodes(path) & shared][-1:])
    unfinished = [
        path
        for path in folder.iterdir()
        if files.is_unfinished_write(path)
        and _is_name(path.name[1:].partition(".")[0])
        and path.is_dir()
        and not path.is_symlink()
    ]
    for path in (*older, *unfinished):
        if path not in staying:
            shutil.rmtree(path, ignore_errors=True)


def _inodes(checkpoint: Path) -> set[int]:
    """The inodes of a checkpoint's files of arrays: linked files have the same."""
    return {path.stat().st_ino for path in checkpoint.glob(f"*{_END}") if path.is_file()}
