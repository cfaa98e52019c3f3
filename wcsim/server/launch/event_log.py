"""events.jsonl of a run with several processes: what started, died, was started again and recovered, and when."""

from __future__ import annotations

import contextlib
import json
import os
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from wcsim.core.reading import FileKind, parse_json, read_bytes, shown
from wcsim.errors import JournalError

EVENTS = "events.jsonl"
_KIND = FileKind(what="the events of a run", limit_bytes=1 << 30, error=JournalError)


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
            if file.seek(0, os.SEEK_END) and file.seek(-1, os.SEEK_END) >= 0 and file.read(1) != b"\n":
                file.write(b"\n")


def read_events(folder: Path) -> list[dict[str, Any]]:
    """All whole lines of a run's events; empty when there are none.

    A line that is no event, as one that was torn, is the event "damaged" with its text: none is left out.

    Raises:
        JournalError: The file cannot be read.
    """
    path = folder / EVENTS
    if not path.exists():
        return []
    lines = read_bytes(path, _KIND).split(b"\n")[:-1]
    return [_event(line.decode("utf-8", errors="replace")) for line in lines]


def _event(line: str) -> dict[str, Any]:
    try:
        event = parse_json(line, EVENTS, _KIND)
    except JournalError:
        event = {}
    return event if isinstance(event.get("event"), str) else {"event": "damaged", "line": shown(line)}
