"""One process compiles, the others wait for its copy: a lock beside the copies on disk of one kernel."""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path
from typing import Final

LONGEST_S: Final = 60.0  # a kernel takes seconds; whoever holds the lock longer was stopped, and is not waited for
_POLL_S: Final = 0.02


class CompileLock:
    """Held while a kernel is compiled. A process that dies lets go of it; where no file can be made, nobody waits.

    Of kernels that call each other the caller's is taken first and none calls its caller, so two never wait for
    each other.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None

    def take(self, longest_s: float = LONGEST_S) -> bool:
        """Wait for the lock; False when it is not held after that: then everybody compiles for himself."""
        self.give()
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError:
            return False
        end_s = time.monotonic() + longest_s
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() < end_s:
                    time.sleep(_POLL_S)
                    continue
            except OSError:  # a file system without locks
                pass
            else:
                self._descriptor = descriptor
                return True
            os.close(descriptor)
            return False

    def give(self) -> None:
        """Let go of it; nothing happens when it is not held."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
