"""Where a worker works: a folder named by its process, which goes with the piece, or with the next on the machine."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from wcsim.core.files import WORK_PREFIX

_NAMED: Final = re.compile(rf"{WORK_PREFIX}(\d+)-(\d+)-(\d+)-")  # namespace of its number, number, birth


@contextmanager
def work_folder() -> Iterator[Path]:
    """A folder that is there while this is open; those of processes that were killed go first. Raises OSError.

    Meanwhile it is this process's place for temporary files, so that what a killed worker leaves is found again.
    """
    _sweep()
    own = f"{WORK_PREFIX}{_namespace()}-{os.getpid()}-{_born(os.getpid())}-"
    with tempfile.TemporaryDirectory(prefix=own, ignore_cleanup_errors=True) as folder:
        before, tempfile.tempdir = tempfile.tempdir, folder
        try:
            yield Path(folder)
        finally:
            tempfile.tempdir = before


def find_in_work(name: str) -> Path | None:
    """A file of that name in the folder of whoever works on this machine now, or did when it was killed."""
    return next(Path(tempfile.gettempdir()).glob(f"{WORK_PREFIX}*/{name}"), None)


def _sweep() -> None:
    """Remove what processes have left that are gone."""
    for folder in Path(tempfile.gettempdir()).glob(f"{WORK_PREFIX}*"):
        named = _NAMED.match(folder.name)
        if named is not None and int(named[1]) == _namespace() and named[3] != _born(int(named[2])):
            shutil.rmtree(folder, ignore_errors=True)


def _namespace() -> int:
    """In which numbers of processes mean what they do here: containers may share a folder; 0 where it is unknown."""
    with suppress(OSError):
        return Path("/proc/self/ns/pid").stat().st_ino
    return 0


def _born(pid: int) -> str:
    """When a process began, in ticks of the machine's clock, so that its number is no other's; "0" for none."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[19]
    return "0"
