"""The folder of a running world: its socket, its shared memory, the orders of its processes; gone when they are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wcsim.server.transport.shm_folder import RingFolder, remove_stale_rings


@contextmanager
def workplace() -> Iterator[Path]:
    """A new folder that only its user can enter, while open; those of owners that were killed go first."""
    remove_stale_rings()
    folder = RingFolder()
    try:
        yield folder.path
    finally:
        folder.close()


def endpoint_in(folder: Path) -> str:
    """Where the world of a workplace is reached."""
    return f"ipc://{folder / 'world'}"
