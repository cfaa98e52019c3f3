"""events.jsonl of a run with several processes: their starts, deaths, restarts and recoveries."""

import contextlib
import json
import os
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

EVENTS: Final = "events.jsonl"


class EventLogWriter:
    """Appends a line an event. A killed process loses none, and a full disk loses lines alone."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / EVENTS
        self._start_s = time.monotonic()
        # What a killed process has left half written stays a line of its own.
        with contextlib.suppress(OSError), self._path.open("rb+") as file:
            if (
                file.seek(0, os.SEEK_END)
                and file.seek(-1, os.SEEK_END) >= 0
                and file.read(1) != b"\n"
            ):
                file.write(b"\n")

    def add(self, event: str, **values: str | int | float) -> None:
        """Write a line: time of day, seconds since the log was opened, the event and its values."""
        line = {
            "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "elapsed_s": round(time.monotonic() - self._start_s, 3),
            "event": event,
            **values,
        }
        # The launcher must not end because a line about a process cannot be written.
        with contextlib.suppress(OSError), self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line, allow_nan=False) + "\n")
