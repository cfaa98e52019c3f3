"""events.jsonl of a run with several processes: what started, died, was started again and recovered, and when."""

from __future__ import annotations

import contextlib
import json
import os
import time
from datetime import UTC, datetime
from pathlib import Path

EVENTS = "events.jsonl"


class RunLog:
    """Appends one line an event; a killed process loses nothing, and a full disk loses lines alone."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / EVENTS
        self._end_torn_line()
        self._begun_s = time.monotonic()

    def add(self, event: str, **values: str | int | float) -> None:
        """Write a line: the time of day, seconds since this log was opened, the event and its values."""
        line = {
            "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "elapsed_s": round(time.monotonic() - self._begun_s, 3),
            "event": event,
            **values,
        }
        # Who keeps processes alive must not end because a line about them cannot be written.
        with contextlib.suppress(OSError), self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line, allow_nan=False) + "\n")

    def _end_torn_line(self) -> None:
        """What a killed process has left half written stays a line of its own."""
        with contextlib.suppress(OSError), self._path.open("rb+") as file:
            if (
                file.seek(0, os.SEEK_END)
                and file.seek(-1, os.SEEK_END) >= 0
                and file.read(1) != b"\n"
            ):
                file.write(b"\n")
