"""What SUMO warns of: a file that is read while SUMO writes it, and that stays small."""

import os
import re
from pathlib import Path

from wcsim.core.reading import escape

ERROR_LOG = "error-log"
"""SUMO's option that names the file: it gets all warnings, also where the console gets none."""
_MOST_BYTES = 4 << 20  # of the file; what comes later is counted, not kept


class WarningLog:
    """The warnings of one simulation; those that differ in names and numbers are of one kind."""

    def __init__(self, path: str) -> None:
        """Begin with none; `path` is the file that SUMO writes, "" where it writes none."""
        self.count = 0
        self.first: dict[str, str] = {}  # of each kind
        self._path, self._done, self._rest = path, 0, b""

    def read(self) -> None:
        """Count what has come since the last time.

        SUMO writes in blocks, and the last of them when it ends.
        """
        try:
            if os.path.getsize(self._path) <= self._done:  # noqa: PTH202 - in every step
                return
            with Path(self._path).open("rb") as file:
                file.seek(self._done)
                data = file.read()
            self._done += len(data)
            # SUMO goes on at the place where it was, so the file stays short and gets a hole.
            if self._done > _MOST_BYTES:
                os.truncate(self._path, _MOST_BYTES)
        # It is not there: there never was one, or it was removed.
        except OSError:
            return
        lines, _, self._rest = (self._rest + data).rpartition(b"\n")
        for message in re.findall("Warning: (.*)", lines.decode(errors="replace")):
            self.count += 1
            if len(self.first) < 20:
                kind = re.sub(r"'[^']*'|-?\d[\d.]*", "", message)
                self.first.setdefault(kind, escape(message[:160]))
