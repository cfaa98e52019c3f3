"""What native code says past Python: a known line of chatter, kept away, and what the loader does not find."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

_STDERR_FD = 2
_NOT_FOUND: Final = re.compile(r"\b(lib[\w.+-]+?\.so[.\d]*): cannot open shared object file")
SYSTEM_PACKAGES: Final = "libgl1 libxext6 libxrender1 libatomic1"
"""Of Debian and Ubuntu: what SUMO's wheels leave to the system, and a machine without a screen may not have."""


def missing_library(said: str) -> str:
    """What to do where the loader says that a library of the system is not there; "" where it says nothing of the kind.

    >>> missing_library("ImportError: libXrender.so.1: cannot open shared object file: No such file or directory")[:35]
    'the library libXrender.so.1 is miss'
    >>> missing_library("cannot open shared object file")
    ''
    """
    found = _NOT_FOUND.search(said)
    if found is None:
        return ""
    return (
        f"the library {found[1]} is missing; SUMO needs some libraries of the system. On Debian or Ubuntu: "
        f"sudo apt install {SYSTEM_PACKAGES}"
    )


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
