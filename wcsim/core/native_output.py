"""Keep a library's known line of chatter away from the user's terminal, and nothing else."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

_STDERR_FD = 2


@contextmanager
def without_line(beginning: bytes) -> Iterator[None]:
    """Within the block, lines of native code on standard error that begin like this are dropped.

    Native code writes past `sys.stderr`, so the file descriptor itself is held back and passed on at the end, also
    after an error. For short blocks: what another thread writes meanwhile appears a moment later.
    """
    try:
        terminal = os.dup(_STDERR_FD)
    except OSError:  # standard error is closed: there is nobody to be spared
        yield
        return
    with tempfile.TemporaryFile() as held:
        if sys.stderr is not None:
            sys.stderr.flush()
        os.dup2(held.fileno(), _STDERR_FD)
        try:
            yield
        finally:
            if sys.stderr is not None:
                sys.stderr.flush()
            os.dup2(terminal, _STDERR_FD)
            os.close(terminal)
            held.seek(0)
            for line in held:
                if not line.startswith(beginning):
                    os.write(_STDERR_FD, line)
